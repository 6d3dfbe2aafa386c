"""What serially correlated readings are worth: against the known process, and by the coverage of its intervals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import signal

from bench.maths.budget import independent_count
from bench.maths.verdict import coverage_factor

N, CAMPAIGNS = 2000, 300


@pytest.mark.validates("mean of correlated readings", against="autoregressive processes of first order")
def test_autoregressive_processes(record_property: Callable[[str, object], None]) -> None:
    """n (1 - a) / (1 + a) of n readings count; 95 % intervals of the mean hold the truth, which is zero."""
    shares, inside = [], []
    for correlation in (0.0, 0.5, 0.9):
        counts, covered = _campaigns(correlation)
        shares.append(counts * (1.0 + correlation) / (1.0 - correlation) / N)
        inside.append(covered)
    record_property("obtained", f"{100.0 * min(inside):.1f} % to {100.0 * max(inside):.1f} % covered")
    assert shares == pytest.approx([1.0, 1.0, 1.0], abs=0.06)
    assert 0.92 <= min(inside) <= max(inside) <= 0.98


def _campaigns(correlation: float) -> tuple[float, float]:
    """Return the mean count of independent readings, and the share of intervals that hold the truth."""
    rng = np.random.default_rng(int(100 * correlation))
    counts, inside = [], 0
    for _ in range(CAMPAIGNS):
        readings = signal.lfilter([1.0], [1.0, -correlation], rng.normal(size=N + 500))[500:]
        counts.append(independent_count(readings))
        std = readings.std(ddof=1) * np.sqrt((N - 1) / N / (counts[-1] - 1.0))
        inside += abs(readings.mean()) <= coverage_factor(counts[-1] - 1.0) * std
    return float(np.mean(counts)), inside / CAMPAIGNS


def test_readings_that_alternate_are_worth_no_more_than_they_are() -> None:
    assert independent_count(np.array([1.0, -1.0] * 20)) == 40.0


def test_readings_that_only_rise_are_worth_few() -> None:
    assert 2.0 <= independent_count(np.arange(1000.0)) < 4.0


def test_what_does_not_vary_has_no_correlation() -> None:
    assert independent_count(np.full(7, 3.2)) == 7.0
    assert independent_count(np.array([1.0])) == 1.0
