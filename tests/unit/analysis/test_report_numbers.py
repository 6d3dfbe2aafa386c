"""How numbers are printed in a report."""

from __future__ import annotations

import math

import pytest

from bench.analysis import cell, decimals_for, header, number, unit_text, with_uncertainty


@pytest.mark.parametrize(
    ("value", "expanded", "text"),
    [
        (412.312, 19.94, "412 ± 20"),
        (412.312, 9.94, "412.3 ± 9.9"),
        (-0.0312, 0.00061, "−0.03120 ± 0.00061"),
        (-1234567.8, 230.0, "−1\u202f234\u202f568 ± 230"),
        (100.0, 0.996, "100.0 ± 1.0"),
        (-0.0002, 0.012, "0.000 ± 0.012"),
        (412.312, None, "412.312"),
        (412.312, math.nan, "412.312"),
        (1.5, 0.0, "1.5"),
    ],
)
def test_value_and_uncertainty_end_at_the_same_digit(value: float, expanded: float | None, text: str) -> None:
    assert with_uncertainty(value, expanded) == text


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
        (-3.5e-9, "−3.5e−09"),
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
    assert cell({"range_A": 0.22, "gain": 1e-6}) == "range / A 0.22, gain 1e−06"
    assert unit_text("ppm/degC^2") == "ppm/°C²"
