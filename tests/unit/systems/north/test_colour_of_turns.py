"""Noise of a waveform: turn by turn, of one set and of all together; harmonics that noise alone claims."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fog_material import Gyro, NorthRig, campaign
from scipy import stats

from bench.systems.north.estimators.likelihood import LikelihoodNorth, likelihood_north
from bench.systems.north.report import FALSE_CLAIM, harmonic_table, north_notes
from bench.systems.north.sets import north_sets, waveform_of
from bench.systems.north.solution import LIKELIHOOD, Solution, accuracies
from bench.systems.north.solve import HARMONICS, site_of, solved

SEED, HARMONICS_SEED = 41, 51
SAID = "The turns of all waveforms do not scatter as white noise would"


@pytest.fixture(scope="module")
def rig() -> NorthRig:
    return campaign(NorthRig(SEED, Gyro(noise_V=0.2)), (0.0, 90.0), 2)


@pytest.fixture(scope="module")
def fits(rig: NorthRig) -> list[LikelihoodNorth]:
    waveforms = [waveform_of(north_set) for north_set in north_sets(rig.material())]
    return [likelihood_north(each.u_V, each.theta_deg) for each in waveforms if each is not None]


def of_fits(rig: NorthRig, fits: list[LikelihoodNorth]) -> Solution:
    material = rig.material()
    return solved(north_sets(material), site_of(material.campaign), fits, 0.0)


def notes(solution: Solution) -> str:
    return "\n".join(north_notes(solution, LIKELIHOOD, accuracies(solution, 0.5)))


@pytest.mark.parametrize("ratio", [0.6, 1.6])
def test_what_all_turns_say_is_the_noise_of_all_sets(rig: NorthRig, fits: list[LikelihoodNorth], ratio: float) -> None:
    """One set that was widened by itself is not widened twice."""
    white_deg2 = np.array([float(fit.std_deg) ** 2 for fit in fits])
    said = [replace(fit, whiteness=np.array(ratio), widened=np.array(False)) for fit in fits]
    said[1] = replace(said[1], std_deg=said[1].std_deg * np.sqrt(ratio), widened=np.array(True))
    solution = of_fits(rig, said)
    found = solution.by_method[LIKELIHOOD]
    assert found.noise_deg == pytest.approx(np.sqrt(ratio * white_deg2.mean()))
    assert found.dof == pytest.approx(sum(int(fit.turns) - 1 for fit in fits))
    assert f"{SAID} ({np.sqrt(ratio):.2f} times" in notes(solution)
    seconds = accuracies(solution, 0.5)[1]
    relative = np.sqrt(2.0 / found.dof)  # of the turns, not of the samples; the amplitude is known far better
    assert seconds.time_std_s / seconds.time_s == pytest.approx(relative, rel=0.01)


def test_turns_of_white_noise_change_nothing(rig: NorthRig, fits: list[LikelihoodNorth]) -> None:
    solution = of_fits(rig, fits)
    assert not any(fit.widened for fit in fits)
    assert solution.by_method[LIKELIHOOD].noise_deg == pytest.approx(
        np.sqrt(np.mean([float(fit.std_deg) ** 2 for fit in fits]))
    )
    assert SAID not in notes(solution)


def test_a_set_is_widened_at_the_significance_asked_for() -> None:
    theta = np.arange(600) * 3.6
    u = np.sin(np.deg2rad(theta)) + 0.3 * np.random.default_rng(SEED).normal(size=(200, theta.size))
    found = likelihood_north(u, theta, significance=0.2)
    due = stats.f.sf(found.whiteness, 5, 597) < 0.2
    np.testing.assert_array_equal(found.widened, due)
    assert 20 < due.sum() < 60
    np.testing.assert_allclose(found.white_std_deg[due], (found.std_deg / np.sqrt(found.whiteness))[due])
    np.testing.assert_array_equal(found.white_std_deg[~due], found.std_deg[~due])


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
    found = claimed(reports, HARMONICS_SEED)
    print(
        f"seed {HARMONICS_SEED}: {found} of {reports} tables of noise claim a harmonic, {100 * FALSE_CLAIM:g} % are due"
    )
    assert least <= found <= most
