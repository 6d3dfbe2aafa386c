"""Units and numbers in D-SI: against units written by hand, a list of its identifiers, and decimal arithmetic."""

from __future__ import annotations

import re
from decimal import Decimal

import pytest
from dcc_facts import DSI_PREFIXES, DSI_UNITS, PATTERNS
from hypothesis import given
from hypothesis import strategies as st

from bench.model.errors import InputError
from bench.report.dcc.dsi import condition_unit, estimate_unit, si_number, si_unit

WRITTEN_OUT = {
    "A": (r"\ampere", 0),
    "nA": (r"\nano\ampere", 0),
    "ppm": (r"\one", -6),
    "ppb": (r"\one", -9),
    "%": (r"\one", -2),
    "1": (r"\one", 0),
    "ppm/degC": (r"\kelvin\tothe{-1}", -6),
    "ppm/degC3": (r"\kelvin\tothe{-3}", -6),
    "A/degC2": (r"\ampere\kelvin\tothe{-2}", 0),
    "A*s^0.5": (r"\ampere\second\tothe{0.5}", 0),
    "A/h^0.5": (r"\ampere\hour\tothe{-0.5}", 0),
    "ppm^0.5": (r"\one", -3),
    "A/%": (r"\ampere", 2),
    "min": (r"\minute", 0),
    "mV": (r"\milli\volt", 0),
    "degC": (r"\kelvin", 0),
    "deg/s": (r"\degree\second\tothe{-1}", 0),
    "arcsec": (r"\arcsecond", 0),
    "arcmin": (r"\arcminute", 0),
    "deg/h^0.5": (r"\degree\hour\tothe{-0.5}", 0),
    "V/Hz": (r"\volt\hertz\tothe{-1}", 0),
}


@pytest.mark.parametrize("unit", WRITTEN_OUT)
def test_units_as_they_are_written_out_by_hand(unit: str) -> None:
    found = si_unit(unit)
    assert (found.token, found.power) == WRITTEN_OUT[unit]


@pytest.mark.parametrize("unit", WRITTEN_OUT)
def test_every_identifier_is_one_of_dsi(unit: str) -> None:
    words = re.sub(r"\\tothe\{-?\d+(\.\d+)?\}", "", si_unit(unit).token).split("\\")[1:]
    assert words
    assert set(words) <= DSI_UNITS | DSI_PREFIXES
    assert words[-1] in DSI_UNITS


@pytest.mark.parametrize("unit", ["", "g", "furlong", "A//s", "/A", "A s", "ppb^0.5", "mmin", "kdegC", "A*", "m"])
def test_a_unit_that_dsi_lacks_is_refused(unit: str) -> None:
    with pytest.raises(InputError, match="D-SI") as caught:
        si_unit(unit)
    assert caught.value.code == "B-DCC-007"
    assert repr(unit) in str(caught.value)


def test_a_temperature_is_in_celsius_and_a_difference_in_kelvin() -> None:
    assert estimate_unit("unit_temperature", "degC").token == r"\degreecelsius"
    assert estimate_unit("play_half_width", "degC").token == r"\kelvin"
    assert condition_unit("reference_temperature_degC").token == r"\degreecelsius"  # type: ignore[union-attr]
    assert condition_unit("width_degC").token == r"\kelvin"  # type: ignore[union-attr]


def test_conditions_carry_their_unit_in_their_name_or_none() -> None:
    assert condition_unit("channel").token == r"\one"  # type: ignore[union-attr]
    assert condition_unit("averaging_h").token == r"\hour"  # type: ignore[union-attr]
    assert condition_unit("hours").token == r"\hour"  # type: ignore[union-attr]
    assert condition_unit("level_A").token == r"\ampere"  # type: ignore[union-attr]
    assert condition_unit("kind") is None
    assert condition_unit("some_thing") is None


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from([-9, -6, -2, 0, 2]))
def test_a_number_is_moved_exactly_and_fits_the_pattern_of_dsi(value: float, power: int) -> None:
    text = si_number(value, power)
    assert Decimal(text) == Decimal(repr(value)).scaleb(power)
    assert re.fullmatch(PATTERNS["decimal"], text)


@given(st.integers(min_value=-(10**18), max_value=10**18))
def test_whole_numbers_stay_whole(value: int) -> None:
    assert si_number(value) == str(value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_what_is_not_finite_is_no_number(value: float) -> None:
    with pytest.raises(ValueError, match="not a number"):
        si_number(value)
