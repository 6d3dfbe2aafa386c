"""Drift and odd readings against published critical values and another implementation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from bench.maths.tests import odd_one, trend

# Grubbs, Technometrics 11 (1969), table 1: two-sided 5 %, (x - mean) / s.
GRUBBS_5 = {5: 1.715, 8: 2.126, 10: 2.290, 15: 2.549, 20: 2.709}


@pytest.mark.validates("odd reading among n", against="Grubbs, Technometrics 11 (1969), table 1, 5 %")
@pytest.mark.parametrize(("n", "critical"), GRUBBS_5.items())
def test_grubbs(n: int, critical: float) -> None:
    """A reading exactly at the critical value of the table is odd with 5 %."""
    others = stats.norm.ppf((np.arange(n - 1) + 0.5) / (n - 1))
    low, high = 1.0, 50.0
    for _ in range(100):
        middle = (low + high) / 2.0
        readings = np.append(others, middle)
        size = (middle - readings.mean()) / readings.std(ddof=1)
        low, high = (middle, high) if size < critical else (low, middle)
    found = odd_one(np.append(others, low))
    assert found is not None
    assert found.probability == pytest.approx(0.05, rel=0.01)


def test_trend_is_the_slope_of_a_line() -> None:
    t_s = np.array([0.0, 1.0, 2.5, 3.0, 6.0, 7.0])
    readings = 5.0 + 0.002 * t_s + np.array([1.0, -2.0, 0.5, 1.5, -1.0, 0.2]) * 1e-3
    known, found = stats.linregress(t_s, readings), trend(t_s, readings)
    assert found is not None
    assert found.probability == pytest.approx(known.pvalue, rel=1e-9)
    assert found.size == pytest.approx(7.0 * known.slope, rel=1e-9)


def test_too_few_or_all_alike_say_nothing() -> None:
    three, alike = np.array([1.0, 2.0, 3.0]), np.full(8, 5.0)
    assert trend(three, three) is None
    assert odd_one(three) is None
    assert trend(np.arange(8.0), alike) is None
    assert odd_one(alike) is None


def test_one_among_readings_that_are_all_alike_is_odd() -> None:
    found = odd_one(np.array([5.0, 5.0, 5.0, 5.0, 5.1]))
    assert found is not None
    assert found.probability == 0.0
    assert found.size == pytest.approx(-0.02)
