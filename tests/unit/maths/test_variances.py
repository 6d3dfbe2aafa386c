"""Functions of estimated variances against chi-square draws, and the exact interval of one variance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from bench.maths.variances import of_variances

Array = NDArray[np.float64]
SEED = 11


def behind_a_floor(share: float) -> Callable[[Array], Array]:
    """A variance over what it leaves of a limit, of which it takes this share."""

    def of(variance: Array) -> Array:
        left = 1.0 - share * variance
        return np.where(left > 0.0, variance / np.where(left > 0.0, left, 1.0), np.inf)

    return of


@pytest.mark.parametrize("dof", [4.0, 14.0, 49.0, 18_791.0])
def test_one_variance(dof: float) -> None:
    """The standard deviation by its formula; the interval by the distribution function of the chi-square."""
    std, half = of_variances(lambda variance: 3.0 * variance, dof)
    assert std == pytest.approx(3.0 * np.sqrt(2.0 / dof), rel=0.01)
    ends = (dof / (1.0 + half / 3.0), dof / (1.0 - half / 3.0) if half < 3.0 else np.inf)
    assert stats.chi2.cdf(ends[1], dof) - stats.chi2.cdf(ends[0], dof) == pytest.approx(0.95, abs=1.5e-3)
    if dof < 50.0:
        by_student = stats.t.ppf(0.975, dof) * std  # what was stated
        ends = (dof / (1.0 + by_student / 3.0), dof / max(1.0 - by_student / 3.0, 1e-9))
        assert stats.chi2.cdf(ends[1], dof) - stats.chi2.cdf(ends[0], dof) < 0.94


@pytest.mark.parametrize(("share", "dof"), [(0.16, 49.0), (0.32, 49.0), (0.16, 17.0)])
def test_intervals_behind_a_floor_hold_in_95_per_cent(share: float, dof: float) -> None:
    rng, count, function = np.random.default_rng(SEED), 1000, behind_a_floor(share)
    estimates = rng.chisquare(dof, count) / dof
    halves = [of_variances(lambda factor, own=own: function(own * factor), dof)[1] for own in estimates]
    held = int(np.sum(np.abs(function(estimates) - function(np.ones(1))) <= halves))
    print(f"seed {SEED}, share {share}, dof {dof:g}: {held} of {count}")
    low, high = stats.binom.interval(0.999, count, 0.95)
    assert low <= held <= high
    std, _ = of_variances(function, dof)
    assert std == pytest.approx(np.std(function(rng.chisquare(dof, 400_000) / dof)), rel=0.02)


def test_two_variances() -> None:
    rng = np.random.default_rng(SEED)
    first, second = (rng.chisquare(dof, 400_000) / dof for dof in (20.0, 8.0))
    std, half = of_variances(lambda one, other: 2.0 * one + other, 20.0, 8.0)
    assert std == pytest.approx(np.std(2.0 * first + second), rel=0.01)
    assert half == pytest.approx(np.quantile(np.abs(2.0 / first + 1.0 / second - 3.0), 0.95), rel=0.01)
    assert of_variances(lambda one, other: 2.0 * one + other, np.inf, 8.0) == pytest.approx(
        of_variances(lambda other: 2.0 + other, 8.0)
    )


def test_without_a_value_nothing_is_known() -> None:
    assert of_variances(behind_a_floor(1.5), 20.0) == (np.inf, np.inf)  # no value
    assert of_variances(behind_a_floor(0.5), 20.0) == (np.inf, np.inf)  # half of a percent of estimates have none
    assert of_variances(lambda known: known, np.inf) == (0.0, 0.0)
