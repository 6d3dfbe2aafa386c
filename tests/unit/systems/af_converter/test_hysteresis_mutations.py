"""Plausible mistakes in the noise of the windows must fail a test of the intervals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from bias_coverage import fit_ramp, scores
from bias_simulation import ramp

_FITS = 25


@pytest.fixture(scope="module")
def ramps() -> list:
    return [ramp(6000 + seed, "gyro") for seed in range(_FITS)]


def spread(found: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square of the scores and share inside 95 %, over all seven parameters."""
    table = np.array(found)
    return np.sqrt(np.mean(table**2, axis=0)), np.mean(np.abs(table) < 1.96, axis=0)


def test_with_the_right_noise_the_scores_are_normal(ramps: list) -> None:
    rms, _ = spread([scores(one, fit_ramp(one)) for one in ramps])
    print(f"right: rms scores {rms.round(2)}")
    assert np.all((rms > 0.65) & (rms < 1.4))


@pytest.mark.validates(
    "joint fit without the random walk is noticed",
    against="coverage of 95 % intervals over 25 simulated ramps",
)
def test_omitting_the_random_walk_is_caught(record_property: Callable[[str, object], None], ramps: list) -> None:
    rms, covered = spread([scores(one, fit_ramp(one, walk_A_rth=0.0)) for one in ramps])
    print(f"no walk: rms scores {rms.round(1)}, covered {covered}")
    record_property("obtained", f"covered {100 * covered.min():.0f} to {100 * covered.max():.0f} %")
    assert np.all(rms > 5.0)
    assert np.all(covered < 0.5)


@pytest.mark.validates(
    "joint fit with windows taken for independent is noticed",
    against="size of the errors over 25 simulated ramps",
)
def test_treating_windows_as_white_is_caught(record_property: Callable[[str, object], None], ramps: list) -> None:
    """Ignoring the correlation of -1/2 states intervals that are two to three times too wide."""
    rms, covered = spread([scores(one, fit_ramp(one, contiguous=False)) for one in ramps])
    print(f"white: rms scores {rms.round(2)}, covered {covered}")
    record_property("obtained", f"errors {rms.min():.2f} to {rms.max():.2f} of what is stated")
    assert np.all(rms < 0.75)
    assert np.all(rms[4:] < 0.5)
    assert np.all(covered > 0.98)
