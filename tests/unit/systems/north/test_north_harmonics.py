"""Harmonics that noise alone claims: one table in a hundred.

Figures: pytest -m "" -s -n 0 tests/unit/systems/north/test_north_harmonics.py
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bench.systems.north.estimators.likelihood import likelihood_north
from bench.systems.north.report import FALSE_CLAIM, harmonic_table
from bench.systems.north.solve import HARMONICS

SEED = 51


def claimed(reports: int, seed: int, waveforms: int = 4, samples: int = 400) -> int:
    """Reports that claim a harmonic; a signal of 1 V in white noise of 0.3 V and nothing else."""
    claims, theta_deg = 0, 360.0 * 20 * (np.arange(samples) + 0.5) / samples
    for report in range(reports):
        rng = np.random.default_rng([seed, report])
        u = np.sin(np.deg2rad(theta_deg + 25.0)) + 0.3 * rng.standard_normal((waveforms, samples))
        raw = [likelihood_north(one, theta_deg, harmonics=HARMONICS) for one in u]
        (table,) = harmonic_table(SimpleNamespace(raw=raw))  # type: ignore[arg-type]
        claims += any(not str(row[1]).startswith("below") for row in table.rows)
    return claims


@pytest.mark.parametrize(
    ("reports", "least", "most"), [(300, 0, 10), pytest.param(6000, 38, 88, marks=pytest.mark.sweep)]
)  # fmt: skip
def test_noise_alone_claims_a_harmonic_once_in_a_hundred_tables(reports: int, least: int, most: int) -> None:
    found = claimed(reports, SEED)
    print(f"seed {SEED}: {found} of {reports} tables of noise claim a harmonic, {100 * FALSE_CLAIM:g} % are due")
    assert least <= found <= most
