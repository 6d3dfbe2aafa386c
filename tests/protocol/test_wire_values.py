"""Numbers sent with every digit, replies refused unless they are finite numbers."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.model.ports import Parameter
from instruments.values import (
    OverloadReadingError,
    check_argument,
    exponent_form,
    plain_form,
    read_integer,
    read_number,
    read_text,
)

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (12345678.0, "1.2345678E+07"),
        (0.01, "1.0E-02"),
        (3e-5, "3.0E-05"),
        (0.0, "0.0E+00"),
        (-0.0, "0.0E+00"),
        (-2.5, "-2.5E+00"),
        (100.0, "1.0E+02"),
        (1e-300, "1.0E-300"),
    ],
)
def test_exponent_form(value: float, text: str) -> None:
    assert exponent_form(value) == text


@given(FINITE)
def test_what_is_written_loses_nothing(value: float) -> None:
    assert float(exponent_form(value)) == value
    text = plain_form(value)
    assert float(text) == value
    assert "e" not in text.lower()


@pytest.mark.parametrize(("value", "text"), [(-10.0, "-10"), (0.5, "0.5"), (100.0, "100"), (0.0, "0"), (-0.0, "0")])
def test_plain_form(value: float, text: str) -> None:
    assert plain_form(value) == text


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_non_finite_is_never_written(value: float) -> None:
    for form in (exponent_form, plain_form):
        with pytest.raises(ValueError, match="not finite"):
            form(value)


@pytest.mark.parametrize("reply", ["ERROR", "", "1.2.3", "nan", "inf", "-Infinity", "1_000", "0x10", "1,2", "1E400"])
def test_garbage_is_no_number(reply: str) -> None:
    with pytest.raises(ValueError, match="number is due"):
        read_number(reply)


@pytest.mark.parametrize("reply", ["9.9E37", "-9.90000000E+37", "9.91E37", "1E+38", "-1e38"])
def test_overload_sentinels(reply: str) -> None:
    with pytest.raises(OverloadReadingError):
        read_number(reply)


def test_numbers() -> None:
    assert read_number("+1.00000000E+07") == 1e7
    assert read_integer("+4097") == 4097
    assert read_text("x") == "x"
    with pytest.raises(ValueError, match="integer"):
        read_integer("1.5")
    with pytest.raises(ValueError, match="empty"):
        read_text("")


@pytest.mark.parametrize("value", [True, "1", None, math.nan, math.inf, 2.3, -0.1, [1]])
def test_quantity_arguments_are_rejected_not_clipped(value: object) -> None:
    with pytest.raises(ValueError, match="current"):
        check_argument(Parameter("current", "A", 0.0, 2.2), value)


@pytest.mark.parametrize("value", [True, 11, "1", 1.5, math.nan, None])
def test_choices(value: object) -> None:
    parameter = Parameter("channel", choices=tuple(range(1, 11)))
    with pytest.raises(ValueError, match="channel"):
        check_argument(parameter, value)
    assert repr(check_argument(parameter, 10.0)) == "10"


def test_limits_are_inside() -> None:
    parameter = Parameter("current", "A", 0.0, 2.2)
    assert check_argument(parameter, 2.2) == 2.2
    assert check_argument(parameter, 0) == 0.0
    with pytest.raises(ValueError, match=r"2\.2000000000000006 A is above 2\.2"):
        check_argument(parameter, math.nextafter(2.2, 3))
