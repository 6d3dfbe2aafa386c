"""The unit's clock against the bench clock, from stamps made here by plain arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from bench.systems.gnc.estimators.unit_clock import UNKNOWN_STD, UnitClock, unit_clock

SEED = 17
INTERVAL_s = 0.005


def record(begin_s: float, length_s: float, error: float, rng: np.random.Generator, switched_on_s: float = 0.0):
    """Ticks of a clock that is ``error`` fast, and receive times: chunks of about 1 s, a delay of up to 20 ms."""
    true_s = begin_s + INTERVAL_s * np.arange(round(length_s / INTERVAL_s))
    tick_us = np.rint((true_s - switched_on_s) * (1.0 + error) * 1e6).astype(np.int64) % (1 << 32)
    chunk = np.ceil(true_s - begin_s + 1e-9)
    late_s = rng.uniform(0.0005, 0.02, int(chunk.max()) + 1)
    return tick_us, begin_s + chunk + late_s[chunk.astype(int)]


def session(error: float, rng: np.random.Generator, first_s: float = 400.0) -> list[tuple[np.ndarray, np.ndarray]]:
    return [record(first_s + 90.0 * k, 60.0, error, rng) for k in range(20)]


def test_the_error_lies_within_its_interval() -> None:
    rng = np.random.default_rng(SEED)
    errors = rng.normal(0.0, 20e-6, 60)
    found = [unit_clock(session(error, rng), INTERVAL_s) for error in errors]
    z = np.array([(one.error - error) / one.std for one, error in zip(found, errors, strict=True)])
    assert max(one.std for one in found) < 10e-6
    assert np.abs(z).max() < 2.5
    assert np.mean([one.error - error for one, error in zip(found, errors, strict=True)]) == pytest.approx(0, abs=2e-6)


def test_stamps_that_wrap_between_records_are_one_stretch() -> None:
    rng = np.random.default_rng(SEED)
    found = unit_clock(session(30e-6, rng, first_s=3_700.0), INTERVAL_s)  # 2^32 us are 4,295 s
    assert found.span_s > 1_700.0
    assert found.error == pytest.approx(30e-6, abs=3 * found.std)


def test_a_unit_that_was_switched_off_begins_anew() -> None:
    rng = np.random.default_rng(SEED)
    before = [record(100.0 + 90.0 * k, 60.0, 25e-6, rng) for k in range(4)]
    after = [record(2_000.0 + 90.0 * k, 60.0, 25e-6, rng, switched_on_s=1_900.0) for k in range(12)]
    found = unit_clock([*before, *after], INTERVAL_s)
    assert 900.0 < found.span_s < 1_100.0
    assert found.error == pytest.approx(25e-6, abs=3 * found.std)


def test_too_short_to_know_is_no_correction() -> None:
    rng = np.random.default_rng(SEED)
    found = unit_clock([record(10.0, 20.0, 40e-6, rng)], INTERVAL_s)
    assert found == UnitClock(0.0, UNKNOWN_STD, 0.0)
