"""Numbers: printed, found in replies, named by a sequence with their limits, and records that are joined."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from decimal import ROUND_HALF_EVEN, Decimal, getcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from imu_material import Rig

from bench.analysis import (
    Analysis,
    Material,
    Reading,
    build_results,
    cell,
    header,
    joined,
    number,
    significant,
    stated_limits,
    unit_text,
    value_and_uncertainty,
    with_uncertainty,
)
from bench.analysis.analysis import analyse, with_expected
from bench.analysis.values import number_of
from bench.model.declaration import Limit
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.model.systems import analyses
from bench.record import RecordRow
from bench.systems.gnc.rows import sampled_rows

DAY_S = 86_400.0
PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
LINES = [
    {"reads": "measure_voltage", "unit": "V", "range": 10.0, "relative": 20e-6, "floor": 40e-6, "age_s": 90 * DAY_S},
    {"reads": "measure_voltage", "unit": "V", "range": 10.0, "relative": 35e-6, "floor": 50e-6},
    {"reads": "measure_voltage", "unit": "V", "range": 100.0, "relative": 45e-6, "floor": 600e-6},
]


def material(volts: list[float | None], *, expected: dict[str, Any], age_days: float = 30.0, lines: Any = LINES,
             arguments: dict[str, Any] | None = None) -> Material:  # fmt: skip
    entry = {"quantity": "rail", "unit": "V", "conditions": {"level_V": 5.0}, **expected}
    conditions = {"level_V": 5.0, "quantity": "rail"}
    readings = [
        Reading(10.0 + k, k, "meter", "measure_voltage", volt, conditions, arguments or {})
        for k, volt in enumerate(volts)
    ]
    return Material(
        rows=(),
        campaign={"analysis": "readings", "uut": {"model": "SC", "serial": "1"}, "expected": [entry]},
        standards={"meter": {"calibrated": "2000-01-01", "specifications": lines}},
        readings=readings,
        utc_offset_s=946_684_800.0 + age_days * DAY_S,  # 2000-01-01, and so much later
    )


def results(source: Material, rule: str = "non_binary") -> list[dict[str, Any]]:
    analysis = with_expected(Analysis("readings", "m", {"model": "SC", "serial": "1"}, []), source)
    document = build_results("s", analysis, {}, PROVENANCE, {"rule": rule})
    return document["estimates"]


def test_mean_scatter_and_specification() -> None:
    """By hand: s / sqrt(n), and half of 20 ppm of 5 V plus 40 uV; the means of five readings do not shrink it."""
    volts = [5.0001, 4.9999, 5.0002, 4.9998, 5.0000]
    (found,) = results(material(list(volts), expected={"low": 4.9, "high": 5.1}))
    std_a, std_b = np.std(volts, ddof=1) / math.sqrt(5), (20e-6 * 5.0 + 40e-6) / 2.0
    assert found["value"] == pytest.approx(5.0, abs=1e-12)
    assert found["std_uncertainty"] == pytest.approx(math.hypot(std_a, std_b), rel=1e-9)
    assert found["dof"] == pytest.approx(4.0 * (1.0 + (std_b / std_a) ** 2) ** 2, rel=1e-9)  # Welch-Satterthwaite
    assert (found["limit"], found["limits"], found["verdict"]) == (None, {"low": 4.9, "high": 5.1}, "pass")
    assert found["quality"] == "sound"


@pytest.mark.parametrize(
    ("volt", "age_days", "arguments", "expanded_V"),
    [
        (5.0, 30.0, {}, 20e-6 * 5.0 + 40e-6),
        (5.0, 91.0, {}, 35e-6 * 5.0 + 50e-6),  # older than 90 days: the line of one year
        (12.0, 30.0, {}, 45e-6 * 12.0 + 600e-6),  # the lowest range that holds it
        (5.0, 30.0, {"range": 100.0}, 45e-6 * 5.0 + 600e-6),  # the range that was set
    ],
)
def test_specification_by_range_and_age(
    volt: float, age_days: float, arguments: dict[str, Any], expanded_V: float
) -> None:
    (found,) = results(material([volt] * 3, expected={}, age_days=age_days, arguments=arguments))
    assert found["std_uncertainty"] == pytest.approx(expanded_V / 2.0, rel=1e-9)


@pytest.mark.parametrize(("volt", "lines"), [(5.0, []), (200.0, LINES)])
def test_without_a_specification_nothing_is_stated(volt: float, lines: Any) -> None:
    """The interval would lack the error of the instrument: no U, no verdict, and the reason says why."""
    (found,) = results(material([volt] * 5, expected={"low": 4.9, "high": 5.1}, lines=lines))
    assert (found["quality"], found["verdict"], found["expanded_uncertainty"]) == ("doubtful", "indeterminate", None)
    (reason,) = found["reasons"]
    assert reason["code"] == "no_specification"
    assert "no specification of meter.measure_voltage" in reason["sentence"]
    assert "30 days after its calibration" in reason["sentence"]


def test_a_drift_and_an_odd_reading_cast_doubt_where_they_move_the_mean() -> None:
    noise = 1e-6 * np.random.default_rng(1).normal(size=20)
    assert results(material(list(5.0 + noise), expected={}))[0]["quality"] == "sound"
    rising = results(material(list(5.0 + 1e-3 * np.arange(20.0) + noise), expected={}))[0]
    assert [reason["code"] for reason in rising["reasons"]] == ["drifts"]
    spike = 5.0 + noise
    spike[7] += 0.01
    (odd,) = results(material(list(spike), expected={}))
    assert [reason["code"] for reason in odd["reasons"]] == ["odd_reading"]
    spike[7] = 5.0 + 3e-5  # as odd, and nothing against the specification
    assert results(material(list(spike), expected={}))[0]["quality"] == "sound"


def test_span_and_one_sided_limits() -> None:
    mean, span = results(material([5.0, 5.001, 5.0005], expected={"high": 5.1, "span": 2e-3}))
    assert (mean["limits"], mean["verdict"]) == ({"low": None, "high": 5.1}, "pass")
    assert (span["quantity"], span["verdict"]) == ("rail_span", "pass")
    assert span["value"] == pytest.approx(1e-3)
    assert results(material([5.0, 5.003], expected={"span": 2e-3}))[1]["verdict"] == "fail"


def test_what_was_not_read_is_missing_and_a_step_done_again_counts_once() -> None:
    analysis = with_expected(
        Analysis("readings", "m", {"model": "SC", "serial": "1"}, []), material([None, None], expected={"low": 4.9})
    )
    assert analysis.missing == ["rail at level 5 V was not read"]
    (found,) = results(material([5.0, None, 5.0], expected={}))
    assert (found["n"], found["dropped"]) == (2, 1)
    source = material([5.0, 5.1], expected={})
    again = [*source.readings, Reading(99.0, 0, "meter", "measure_voltage", 5.2, source.readings[0].conditions)]
    (found,) = results(Material(source.rows, source.campaign, source.standards, readings=again, utc_offset_s=1e9))
    assert (found["n"], found["value"]) == (2, pytest.approx(5.15))


getcontext().prec = 60  # doubles as they are, rounded once


@pytest.mark.parametrize(
    ("value", "expanded", "text"),
    [
        (412.312, 19.94, "412 ± 20"),
        (-0.0312, 0.00061, "−0.03120 ± 0.00061"),
        (100.0, 0.996, "100.0 ± 1.0"),
        (-0.0002, 0.012, "0.000 ± 0.012"),
        (412.312, None, "412.312"),
        (572803.0, 453627.0, "(5.7 ± 4.5)·10⁵"),
        (9e-8, 1e-7, "(0.9 ± 1.0)·10⁻⁷"),
        (18.4, 1e-15, "18.4"),
        (math.nan, 1.0, "–"),
        (1.0000000123, 1.6e-9, "1.0000000123 ± 0.0000000016"),
    ],
)
def test_value_and_uncertainty_end_at_the_same_digit(value: float, expanded: float | None, text: str) -> None:
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


@pytest.mark.parametrize(
    ("shown", "thing", "text"),
    [
        *((number, nothing, "–") for nothing in (None, math.nan, math.inf)),
        (number, 15048000, "15\u202f048\u202f000"),
        (number, -3.5e-9, "−3.5·10⁻⁹"),
        (header, "std_uncertainty_ppm", "std uncertainty / ppm"),
        (header, "temperature_degC", "temperature / °C"),
        (header, "channel", "channel"),
        (cell, True, "yes"),
        (cell, [1, 2.5], "1, 2.5"),
        (cell, {"range_A": 0.22, "gain": 1e-6}, "range / A 0.22, gain 1·10⁻⁶"),
        (unit_text, "ppm/degC^2", "ppm/°C²"),
        (unit_text, "ug", "µg"),
        (unit_text, "by 120 ugauss, 22 us.", "by 120 µgauss, 22 µs."),
        (unit_text, "it tells us nothing", "it tells us nothing"),
        (unit_text, "9.8 m/s2", "9.8 m/s²"),
        (unit_text, "1e-3 deg/h^0.5", "10⁻³ deg/√h"),
        (unit_text, "deg/sqrt(h)", "deg/√h"),
        (unit_text, "sha256 1e4f", "sha256 1e4f"),
        (significant, 9.96e-8, "1.0·10⁻⁷"),
        (significant, 5.21e-8, "5.2·10⁻⁸"),
        (significant, 0.0007, "0.00070"),
        (significant, 0.0, "0"),
    ],
)
def test_numbers_units_and_headers_are_printed_as_the_field_writes_them(
    shown: Callable[[Any], str], thing: Any, text: str
) -> None:
    assert shown(thing) == text


def test_a_value_in_a_column_of_its_own_has_the_digits_of_its_uncertainty() -> None:
    assert value_and_uncertainty(-5.99994e-5, 0.14) == ("0.00", "0.14")
    assert value_and_uncertainty(59.8, 0.0) == ("59.8", "0")


DECLARED = {"azimuth_error": Limit("deg", above_zero=True), "temperature_low": Limit("degC")}


def stated(value: float, unit: str, name: str = "azimuth_error") -> dict[str, float]:
    limits = {"limits": {name: {"value": value, "unit": unit}}}
    return stated_limits(limits, DECLARED, "B-FOG-001", "nobody knows it")


def test_limits_are_in_the_base_unit_and_an_error_is_above_zero() -> None:
    assert stated(30.0, "arcmin") == {"azimuth_error": 0.5}
    assert stated_limits({}, DECLARED, "B-FOG-001", "nobody knows it") == {}
    assert stated(-40.0, "degC", "temperature_low") == {"temperature_low": -40.0}
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(FitError, match=r"B-FOG-001: .*limit 'azimuth_error'"):
            stated(value, "deg")


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


@pytest.mark.parametrize("name", analyses())
def test_a_method_that_an_analysis_does_not_have(name: str) -> None:
    with pytest.raises(FitError, match="B-FIT-004: unknown method 'no_such'") as caught:
        analyse(Material((), {"analysis": name}, {}), "no_such")
    assert caught.value.next_step == f"use one of: {', '.join(analyses()[name].analysis.methods)}"


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


def parts(gap: int = 0) -> list[RecordRow]:
    """One second before a turn and two behind it; ``gap``: samples between them."""
    rig = Rig(610)
    rig.rest(1.0, (0.0, 0.0, 0.0), item="rotation")
    rig.counter += gap - 1000  # records of this rig lie 1,000 samples apart
    rig.rest(2.0, (0.0, 0.0, 30.0), item="rotation", continues=1)
    first, second = rig.rows
    return [
        replace(first, lost=2, bad=1, duplicate=4, suspect=3, quality=Quality.GOOD),
        replace(second, lost=5, bad=7, duplicate=6, suspect=9, quality=Quality.LOST),
    ]


def test_two_parts_are_one() -> None:
    first, second = parts()
    (one,) = joined([first, second])
    assert (one.window.number, one.window.first_counter, one.window.frames) == (1, 0, 600)
    assert (one.window.t_start_ns, one.window.t_end_ns) == (first.window.t_start_ns, second.window.t_end_ns)
    assert one.window.conditions == first.window.conditions
    assert (one.frames, one.lost, one.bad, one.duplicate, one.suspect) == (600, 7, 8, 10, 12)
    assert one.quality == Quality.LOST
    assert np.array_equal(one.samples.counter, np.arange(600))
    assert np.array_equal(one.samples.columns["gyro"][200:], second.samples.columns["gyro"])  # type: ignore[union-attr]
    assert np.array_equal(one.samples.t_ns[:200], first.samples.t_ns)  # type: ignore[union-attr]


def test_parts_with_samples_between_them_stay_apart_and_the_second_is_not_used() -> None:
    found = joined(parts(gap=1))
    assert len(found) == 2
    rig = Rig(610)
    rig.rows = list(found)
    used, empty = sampled_rows(rig.material("imu_calibration"), ("rotation",))
    assert [one.number for one in used] == [1]
    assert empty == ["record 2 (rotation): it does not follow the record that it continues"]


def test_what_merely_follows_is_a_record_of_its_own() -> None:
    first, second = parts()
    conditions = {name: value for name, value in second.window.conditions.items() if name != "continues"}
    alone = replace(second, window=replace(second.window, conditions=conditions))
    assert len(joined([first, alone])) == 2
