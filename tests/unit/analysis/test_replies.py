"""The number in a reply, the value of its last digit, and replies that must be a text."""

from __future__ import annotations

import pytest

from bench.analysis.values import number_of


@pytest.mark.parametrize(
    ("reply", "pattern", "unit", "number"),
    [
        ("+4.99870000E+00", None, "V", (4.9987, 1e-8)),
        ("CH1: 23.4 C", r"([-+.\d]+) C", "degC", (23.4, 0.1)),
        ("T=-7", r"-?\d+", "degC", (-7.0, 1.0)),
        ("12.50 mA", None, "mA", (0.0125, 1e-5)),
        ("1.20E3", None, "Hz", (1200.0, 10.0)),
        ("no number", None, "V", None),
        ("V=abc", r"V=(\w+)", "V", None),
        ("OVER", r"V=(\d+)", "V", None),
        ("5 V", r"(", "V", None),
        ("5 V", None, "of nothing", None),
    ],
)
def test_a_number(reply: str, pattern: str | None, unit: str, number: tuple[float, float] | None) -> None:
    found = number_of(reply, {"pattern": pattern, "unit": unit})
    assert found == (None if number is None else pytest.approx(number, rel=1e-12))


@pytest.mark.parametrize(
    ("reply", "pattern", "due"),
    [
        (" READY\r\n", None, 1.0),
        ("NOT READY", None, 0.0),
        ("id 7, rev B", r"rev (\w)", 1.0),
        ("id 7", r"rev (\w)", 0.0),
    ],
)
def test_a_text(reply: str, pattern: str | None, due: float) -> None:
    equals = "READY" if pattern is None else "B"
    assert number_of(reply, {"pattern": pattern, "unit": None, "equals": equals}) == (due, 0.0)
