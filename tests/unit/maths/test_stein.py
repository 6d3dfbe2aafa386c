"""How many readings a mean needs by the scatter of a first stage, against scipy and against the definition."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from scipy import stats

from bench.maths.stein import needed, widening


@pytest.mark.validates("widening of a 95 % interval by few degrees of freedom", against="scipy.stats.t")
@pytest.mark.parametrize("dof", [9, 10, 14, 29, 99, 999])
def test_the_widening_is_that_of_students_t(dof: int) -> None:
    assert widening(dof) == pytest.approx(stats.t.ppf(0.975, dof) / stats.norm.ppf(0.975), rel=1e-5)


@pytest.mark.parametrize("target", [0.05, 0.2, 1.0])
def test_it_is_the_least_number_whose_interval_is_no_wider(target: float) -> None:
    """The interval of n readings is t s / sqrt(n), with the t and the s of the first ten, whatever n is."""
    first = np.random.default_rng(4).normal(3.0, 0.7, 10).tolist()
    count = needed(first, target)
    half_width = stats.t.ppf(0.975, 9) * statistics.stdev(first)
    allowed = stats.norm.ppf(0.975) * target
    assert half_width / math.sqrt(count) <= allowed * (1 + 1e-5)
    assert count == 10 or half_width / math.sqrt(count - 1) > allowed * (1 - 1e-5)


def test_readings_without_scatter_need_no_more() -> None:
    assert needed([1.0] * 12, 1e-9) == 12
