"""How numbers are printed in a report."""

from __future__ import annotations

import math
import re
from decimal import ROUND_HALF_EVEN, Decimal, getcontext

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from bench.analysis import (
    cell,
    decimals_for,
    header,
    number,
    significant,
    unit_text,
    value_and_uncertainty,
    with_uncertainty,
)

getcontext().prec = 60  # doubles as they are, rounded once


@pytest.mark.parametrize(
    ("value", "expanded", "text"),
    [
        (412.312, 19.94, "412 ± 20"),
        (412.312, 9.94, "412.3 ± 9.9"),
        (-0.0312, 0.00061, "−0.03120 ± 0.00061"),
        (-1234567.8, 230.0, "−1\u202f234\u202f570 ± 230"),
        (100.0, 0.996, "100.0 ± 1.0"),
        (-0.0002, 0.012, "0.000 ± 0.012"),
        (412.312, None, "412.312"),
        (412.312, math.nan, "412.312"),
        (1.5, 0.0, "1.5"),
    ],
)
def test_value_and_uncertainty_end_at_the_same_digit(value: float, expanded: float | None, text: str) -> None:
    assert with_uncertainty(value, expanded) == text


@pytest.mark.parametrize(
    ("value", "expanded", "text"),
    [
        (-19.1, 165001.0, "(0.0 ± 1.7)·10⁵"),
        (572803.0, 453627.0, "(5.7 ± 4.5)·10⁵"),
        (9e-8, 1e-7, "(0.9 ± 1.0)·10⁻⁷"),
        (0.0, 3e-15, "(0.0 ± 3.0)·10⁻¹⁵"),
        (18.4, 1e-15, "18.4"),
        (math.nan, 1.0, "–"),
        (1.0000000123, 1.6e-9, "1.0000000123 ± 0.0000000016"),
    ],
)
def test_a_power_of_ten_stands_for_zeros(value: float, expanded: float, text: str) -> None:
    assert with_uncertainty(value, expanded) == text


@given(
    st.floats(-1e9, 1e9, allow_nan=False).filter(lambda value: value == 0.0 or abs(value) > 1e-12),
    st.floats(1e-15, 1e9),
)
def test_digits_follow_the_uncertainty(value: float, expanded: float) -> None:
    """Two significant digits of U, the value to the same place, nothing minus zero; by exact decimal arithmetic."""
    assume(expanded > 1e-13 * abs(value))
    text = with_uncertainty(value, expanded).replace("\u202f", "").replace("−", "-")
    match = re.fullmatch(r"\(?([^()·]+)\)?(?:·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?", text)
    assert match
    printed, of_ten = match.groups()
    power = int((of_ten or "0").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))
    shown = [Decimal(part).scaleb(power) for part in printed.split(" ± ")]
    place = _place_of_two_digits(Decimal(expanded))
    assert shown == [_rounded(Decimal(value), place), _rounded(Decimal(expanded), place)]
    assert not printed.startswith("-") or shown[0] != 0


def _place_of_two_digits(expanded: Decimal) -> Decimal:
    """The unit of the second significant digit, after rounding."""
    place = Decimal(1).scaleb(expanded.adjusted() - 1)
    return place if expanded.quantize(place, ROUND_HALF_EVEN) < 100 * place else 10 * place


def _rounded(number: Decimal, place: Decimal) -> Decimal:
    return (number / place).quantize(Decimal(1), ROUND_HALF_EVEN) * place


def test_two_digits_of_uncertainty_over_eight_decades() -> None:
    for power in range(-7, 2):
        shown = number(1.4 * 10.0**power, decimals_for(1.4 * 10.0**power))
        assert float(shown) == pytest.approx(1.4 * 10.0**power, rel=1e-12)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (math.nan, "–"),
        (math.inf, "–"),
        (15048000, "15\u202f048\u202f000"),
        (-3.5e-9, "−3.5·10⁻⁹"),
    ],
)
def test_number(value: object, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("std_uncertainty_ppm", "std uncertainty / ppm"),
        ("temperature_degC", "temperature / °C"),
        ("ramp_degC_min", "ramp / °C/min"),
        ("channel", "channel"),
        ("frames_lost", "frames lost"),
        ("s", "s"),
    ],
)
def test_header_puts_the_unit_last(key: str, text: str) -> None:
    assert header(key) == text


def test_cells_of_documents() -> None:
    assert cell(True) == "yes"
    assert cell([1, 2.5]) == "1, 2.5"
    assert cell({"range_A": 0.22, "gain": 1e-6}) == "range / A 0.22, gain 1·10⁻⁶"
    assert unit_text("ppm/degC^2") == "ppm/°C²"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("ug", "µg"),
        ("by 120 ugauss, 22 us.", "by 120 µgauss, 22 µs."),
        ("it tells us nothing", "it tells us nothing"),
        ("10 Mohm", "10 MΩ"),
        ("9.8 m/s2", "9.8 m/s²"),
        ("1e-3 deg/h^0.5", "10⁻³ deg/√h"),
        ("deg/sqrt(h)", "deg/√h"),
        ("3.6e-05", "3.6·10⁻⁵"),
        ("sha256 1e4f", "sha256 1e4f"),
    ],
)
def test_units_and_powers_are_printed_as_the_field_writes_them(text: str, shown: str) -> None:
    assert unit_text(text) == shown


@pytest.mark.parametrize(
    ("uncertainty", "text"),
    [(1e-7, "1.0·10⁻⁷"), (9.96e-8, "1.0·10⁻⁷"), (5.21e-8, "5.2·10⁻⁸"), (0.0007, "0.00070"), (0.0, "0")],
)
def test_an_uncertainty_alone_has_two_digits(uncertainty: float, text: str) -> None:
    assert significant(uncertainty) == text


def test_a_value_in_a_column_of_its_own_has_the_digits_of_its_uncertainty() -> None:
    assert value_and_uncertainty(-5.99994e-5, 0.14) == ("0.00", "0.14")
    assert value_and_uncertainty(59.8, 0.0) == ("59.8", "0")
