"""The interval of a counted proportion, against scipy's own search for it and against its defining sums."""

from __future__ import annotations

import pytest
from scipy import stats

from bench.maths.proportion import clopper_pearson


@pytest.mark.parametrize("trials", [1, 2, 7, 20, 200])
def test_as_scipy_finds_it(trials: int) -> None:
    for successes in sorted({0, 1, trials // 2, trials - 1, trials}):
        for probability in (0.90, 0.95):
            due = stats.binomtest(successes, trials).proportion_ci(probability, "exact")
            assert clopper_pearson(successes, trials, probability) == pytest.approx((due.low, due.high), abs=1e-9)


def test_beyond_each_limit_the_count_has_the_remaining_probability() -> None:
    low, high = clopper_pearson(193, 200)
    assert stats.binom.sf(192, 200, low) == pytest.approx(0.025, abs=1e-9)
    assert stats.binom.cdf(193, 200, high) == pytest.approx(0.025, abs=1e-9)


def test_nothing_and_everything() -> None:
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    assert clopper_pearson(200, 200)[1] == 1.0
    assert clopper_pearson(200, 200)[0] == pytest.approx(0.025 ** (1 / 200))
    with pytest.raises(ValueError, match="no proportion"):
        clopper_pearson(3, 2)
