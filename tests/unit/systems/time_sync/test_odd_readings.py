"""One bad reading among many is found; a kink, a step, a gap and honest noise are none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.port_clocks import odd_readings

Array = NDArray[np.float64]
N = 3000
COUNTER = np.arange(N)


def smooth(seed: int = 1) -> Array:
    at = np.arange(N) / 50.0
    clean = np.stack([100.0 * at, np.sin(at), np.where(at > 30.0, 7.0 * (at - 30.0), 0.0)], axis=1)
    return np.asarray(clean + 1e-3 * np.random.default_rng(seed).standard_normal(clean.shape))


@pytest.mark.parametrize("size", [0.2, 10.0, 1e6])
@pytest.mark.parametrize("at", [2, 700, N - 3])
def test_one_bad_reading_is_found(size: float, at: int) -> None:
    values = smooth()
    values[at, 1] += size
    assert odd_readings(values, COUNTER).tolist() == [at]


def test_three_of_three_thousand_are_found_and_not_a_fourth() -> None:
    values = smooth()
    values[[100, 900, 1700, 2500], 0] += [40.0, 30.0, 20.0, 10.0]
    assert odd_readings(values, COUNTER).tolist() == [100, 900, 1700]


def test_no_reading_of_a_kink_or_a_step_is_bad() -> None:
    for seed in range(200):
        assert odd_readings(smooth(seed), COUNTER).size == 0
    values = smooth()
    values[1000:, 0] += 5.0
    assert odd_readings(values, COUNTER).size == 0


def test_what_lies_beside_a_gap_is_not_judged() -> None:
    values, counter = smooth(), COUNTER.copy()
    values[1001] += 50.0
    counter[1000:] += 5
    assert odd_readings(values, counter).size == 0


def test_few_readings_are_not_judged() -> None:
    assert odd_readings(smooth()[:40], COUNTER[:40]).size == 0
