"""Limits on one side, on two that are not alike, and on both alike, by the rules of ILAC-G8 and JCGM 106."""

from __future__ import annotations

import math

import pytest
from scipy import stats

from bench.maths.verdict import bounds, decide, verdict

LIMITS_V = (4.9, 5.1)


@pytest.mark.parametrize(
    ("value_V", "expected"),
    [(4.86, "fail"), (4.88, "conditional_fail"), (4.92, "conditional_pass"), (4.94, "pass"), (5.06, "pass"),
     (5.08, "conditional_pass"), (5.12, "conditional_fail"), (5.14, "fail")],
)  # fmt: skip
def test_guard_band_on_both_sides(value_V: float, expected: str) -> None:
    assert verdict(value_V, 0.03, LIMITS_V) == expected


@pytest.mark.parametrize("rule", ["simple", "guard_band", "non_binary"])
def test_one_limit_leaves_the_other_side_open(rule: str) -> None:
    below, above = (-math.inf, 0.15), (2.0, math.inf)
    assert verdict(-1e9, 0.01, below, rule) == "pass"
    assert verdict(0.2, 0.01, below, rule) == "fail"
    assert verdict(1e9, 0.01, above, rule) == "pass"
    assert verdict(1.9, 0.01, above, rule) == "fail"


@pytest.mark.validates("conformance probability of one- and two-sided limits", against="scipy.stats, norm and t")
@pytest.mark.parametrize("limits", [LIMITS_V, (-math.inf, 5.1), (4.9, math.inf)])
@pytest.mark.parametrize("dof", [math.inf, 7.0])
def test_conformance_probability(limits: tuple[float, float], dof: float) -> None:
    value_V, std_V = 5.07, 0.02
    known = stats.norm if math.isinf(dof) else stats.t(dof)
    due = known.cdf((limits[1] - value_V) / std_V) - known.cdf((limits[0] - value_V) / std_V)
    assert decide(value_V, std_V, limits, "simple", dof).conformance_probability == pytest.approx(due, rel=1e-12)


def test_a_number_stands_for_both_sides() -> None:
    assert bounds(3.0) == (-3.0, 3.0)
    for value in (-3.5, -2.5, 0.0, 2.5, 3.5):
        assert verdict(value, 0.2, 3.0) == verdict(value, 0.2, (-3.0, 3.0))


@pytest.mark.parametrize("rule", ["simple", "guard_band", "non_binary"])
def test_what_is_no_number_fails(rule: str) -> None:
    assert verdict(math.nan, 0.1, (-math.inf, 5.0), rule) == "fail"
    assert verdict(math.inf, 0.1, (4.9, math.inf), rule) == "fail"
