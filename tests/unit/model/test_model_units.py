"""Quantities: exact decimal conversion, and a clear refusal of everything else."""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction
from typing import Annotated

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from bench.model.units import format_quantity, likely, parse_quantity, quantity, read_quantity, with_prefix


@pytest.mark.parametrize(
    ("size", "unit", "factor", "shown"),
    [
        (0.9994, "V", 1e3, "mV"),
        (3e-5, "A", 1e6, "uA"),
        (0.0134, "s", 1e3, "ms"),
        (1.6e9, "s", 1.0, "s"),
        (0.0, "V", 1.0, "V"),
        (63.5, "deg", 1.0, "deg"),
    ],
)
def test_a_prefix_leaves_one_to_three_digits(size: float, unit: str, factor: float, shown: str) -> None:
    found, printed = with_prefix(size, unit)
    assert (found, printed) == (pytest.approx(factor), shown)


@pytest.mark.parametrize(
    ("text", "dimension", "expected"),
    [
        ("30 uA", "A", 3e-5),
        ("30 µA", "A", 3e-5),
        ("30 μA", "A", 3e-5),
        ("100uA", "A", 1e-4),
        ("0.1 nA", "A", 1e-10),
        ("-15 V", "V", -15.0),
        ("1.25 uC", "C", 1.25e-6),
        ("10 MHz", "Hz", 1e7),
        ("256 kHz", "Hz", 256e3),
        ("1 Mohm", "ohm", 1e6),
        ("38 h", "s", 136800.0),
        ("150 min", "s", 9000.0),
        ("0.5 degC/min", "degC/min", 0.5),
        ("-10 degC", "degC", -10.0),
        ("20 ppm", "1", 2e-5),
        ("0.1 %", "1", 1e-3),
        ("83 deg/s", "deg/s", 83.0),
        ("20.2 g", "g", 20.2),
        ("8 ppm/degC", "1/degC", 8e-6),
        ("2 nA/degC", "A/degC", 2e-9),
        ("1e-3 A", "A", 1e-3),
        (" +.5 mA ", "A", 5e-4),
    ],
)
def test_the_nearest_float_of_the_written_decimal(text: str, dimension: str, expected: float) -> None:
    assert parse_quantity(text, dimension) == expected
    assert read_quantity(text) == (expected, dimension)


@pytest.mark.parametrize(
    ("symbols", "plain", "dimension"),
    [
        ("23 °C", "23 degC", "degC"),
        ("23°C", "23 degC", "degC"),
        ("23 \N{DEGREE CELSIUS}", "23 degC", "degC"),
        ("0.5 °C/min", "0.5 degC/min", "degC/min"),
        ("2 ppm/°C²", "2 ppm/degC2", "1/degC2"),
        ("50 \N{GREEK CAPITAL LETTER OMEGA}", "50 ohm", "ohm"),
        ("50 \N{OHM SIGN}", "50 ohm", "ohm"),
        ("4.7 kΩ", "4.7 kohm", "ohm"),
        ("1 MΩ", "1 Mohm", "ohm"),
        ("3 \N{MICRO SIGN}V", "3 uV", "V"),
        ("3 \N{GREEK SMALL LETTER MU}V", "3 uV", "V"),
        ("20 µg", "20 ug", "g"),
        ("20 µΩ", "20 uohm", "ohm"),
        ("45°", "45 deg", "deg"),
        ("3 °/h", "3 deg/h", "deg/s"),
        ("9.81 m/s²", "9.81 m/s2", "m/s2"),
    ],
)
def test_symbols_of_the_si_are_units(symbols: str, plain: str, dimension: str) -> None:
    assert parse_quantity(symbols, dimension) == parse_quantity(plain, dimension)
    assert read_quantity(symbols) == read_quantity(plain) == (parse_quantity(plain, dimension), dimension)


@pytest.mark.parametrize(
    ("text", "dimension", "meant"),
    [
        ("10 ma", "A", "10 mA"),
        ("10 MA", "V", ""),
        ("5 Ohm", "ohm", "5 ohm"),
        ("5 KOhm", "ohm", "5 kohm"),
        ("5 MOHMS", "ohm", ""),
        ("18 v", "V", "18 V"),
        ("10 khz", "Hz", "10 kHz"),
        ("10 S", "s", "10 s"),
        ("10 Hours", "s", "10 h"),
        ("-10 C", "degC", "-10 degC"),
        ("-10 degc", "degC", "-10 degC"),
        ("-10 °c", "degC", "-10 degC"),
        ("3 dps", "deg/s", "3 deg/s"),
        ("3 m/s^2", "m/s2", "3 m/s2"),
        ("10 apples", "A", ""),
        ("10 V", "A", ""),
        ("10", "A", ""),
        ("mA", "A", ""),
    ],
)
def test_the_unit_that_was_meant(text: str, dimension: str, meant: str) -> None:
    said = f"; did you mean {meant!r}?" if meant else ""
    assert likely(text, dimension) == said
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - its words follow
        parse_quantity(text, dimension)
    assert ("did you mean" in str(refused.value)) == bool(meant)
    assert str(refused.value).endswith(said)


def test_of_any_dimension_and_never_itself() -> None:
    assert likely("10 Deg/h") == "; did you mean '10 deg/h'?"
    assert (likely("10 deg/h"), likely("-1 mA", "A"), likely(10, "A"), likely("10 parsec")) == ("", "", "", "")


@pytest.mark.parametrize(
    "text", [10, 10.0, True, None, "10", "10 ", "mA", "", "1 2 A", "ten A", "1e5", "nan A", "inf A"]
)
def test_no_number_or_no_unit_is_refused(text: object) -> None:
    with pytest.raises(ValueError, match=r"quantity|unit"):
        parse_quantity(text, "A")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("10 V", "a quantity in A is due"),
        ("10 ma", "unknown unit 'ma'"),
        ("1e999 A", "not finite"),
        ("10 K", "unknown unit"),
    ],
)
def test_wrong_unit_names_what_is_due(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        parse_quantity(text, "A")


@given(
    st.decimals(-1000, 1000, allow_nan=False, allow_infinity=False, places=6), st.sampled_from(["", "m", "u", "n", "k"])
)
def test_prefixes_against_exact_fractions(number: Decimal, prefix: str) -> None:
    factor = {
        "": Fraction(1),
        "m": Fraction(1, 10**3),
        "u": Fraction(1, 10**6),
        "n": Fraction(1, 10**9),
        "k": Fraction(10**3),
    }
    assert parse_quantity(f"{number:f} {prefix}A", "A") == float(Fraction(number) * factor[prefix])


def test_limits_are_part_of_the_annotation() -> None:
    adapter: TypeAdapter[float] = TypeAdapter(Annotated[float, *quantity("A", 0.0, 0.22)])
    assert adapter.validate_python("220 mA") == 0.22
    for text, says in (("221 mA", "above the limit 0.22 A"), ("-1 nA", "below the limit 0 A")):
        with pytest.raises(ValidationError, match=says):
            adapter.validate_python(text)


def test_read_quantity_leaves_other_text_alone() -> None:
    for text in ("lowest_that_holds", "1-6", "+", "5", "{level}", "10 apples"):
        assert read_quantity(text) is None


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(3e-5, "A", "30 uA"), (0.22, "A", "220 mA"), (1e7, "Hz", "10 MHz"), (0.0, "A", "0 A"), (20.0, "degC", "20 degC"),
     (-1.5e-9, "A", "-1.5 nA"), (1e-15, "A", "1e-15 A"), (math.inf, "A", "inf A")],
)  # fmt: skip
def test_printing(value: float, unit: str, text: str) -> None:
    assert format_quantity(value, unit) == text


@given(st.floats(1e-11, 1e9))
def test_printing_with_all_digits_reads_back(value: float) -> None:
    assert parse_quantity(format_quantity(value, "A", 17), "A") == pytest.approx(value, rel=3e-16)
