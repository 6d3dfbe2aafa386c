"""Limits of a sequence as an analysis reads them, one- and two-sided, and the methods it knows."""

import pytest

from bench.analysis import check_method, stated_limits
from bench.model.declaration import Limit
from bench.model.errors import FitError

DECLARED = {"azimuth_error": Limit("deg", above_zero=True), "temperature_low": Limit("degC")}


def stated(value: float, unit: str, name: str = "azimuth_error") -> dict[str, float]:
    limits = {"limits": {name: {"value": value, "unit": unit}}}
    return stated_limits(limits, DECLARED, "B-FOG-001", "nobody knows it")


def test_limits_are_in_the_base_unit_and_those_not_stated_are_left_out() -> None:
    assert stated(30.0, "arcmin") == {"azimuth_error": 0.5}
    assert stated_limits({}, DECLARED, "B-FOG-001", "nobody knows it") == {}


def test_an_end_of_a_range_has_either_sign_and_an_error_is_above_zero() -> None:
    assert stated(-40.0, "degC", "temperature_low") == {"temperature_low": -40.0}
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(FitError, match="limit 'azimuth_error'") as caught:
            stated(value, "deg")
        assert caught.value.code == "B-FOG-001"


@pytest.mark.parametrize(
    ("name", "unit", "says", "next_step"),
    [
        ("azimuth_eror", "deg", "nobody knows it", "did you mean 'azimuth_error'?"),
        ("width", "m", "nobody knows it", "use one of: azimuth_error, temperature_low, with a unit of its dimension"),
        ("azimuth_error", "m", "m", "use one of: azimuth_error, temperature_low, with a unit of its dimension"),
    ],
)
def test_an_unusable_limit_says_what_to_do(name: str, unit: str, says: str, next_step: str) -> None:
    with pytest.raises(FitError, match=says) as caught:
        stated(1.0, unit, name)
    assert (caught.value.next_step, caught.value.where) == (next_step, "manifest: campaign.limits")


def test_a_method_that_an_analysis_does_not_have() -> None:
    check_method("gls", ("gls", "ols"))
    with pytest.raises(FitError, match="unknown method 'wls'") as caught:
        check_method("wls", ("gls", "ols"))
    assert (caught.value.code, caught.value.next_step) == ("B-FIT-004", "use one of: gls, ols")
