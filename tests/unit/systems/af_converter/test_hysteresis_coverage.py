"""Coverage of the joint fit over 500 simulated ramps; a short form is in test_fit_hysteresis.py."""

from __future__ import annotations

import numpy as np
import pytest
from bias_coverage import fit_ramp, scores
from bias_simulation import draw, ramp


@pytest.mark.sweep
@pytest.mark.parametrize(("kind", "hysteresis"), [("gyro", True), ("accelerometer", True), ("gyro", False)])
def test_coverage_over_500_fits(kind: str, hysteresis: bool) -> None:
    """95 % intervals cover 95 +- 3 %; without hysteresis the half-width has none, and the others 95 +- 4 %."""
    found = []
    for seed in range(500):
        unit = draw(np.random.default_rng([7, seed]), kind, hysteresis=hysteresis)
        one = ramp(1000 + seed, unit=unit)
        found.append(scores(one, fit_ramp(one)))
    covered = np.mean(np.abs(np.array(found)) < 1.96, axis=0)[: 7 if hysteresis else 6]
    print(f"{kind}, hysteresis {hysteresis}: covered {covered}")
    assert np.all(np.abs(covered - 0.95) <= (0.03 if hysteresis else 0.04))
