"""What a sequence expects of its values: the forms of a limit, names and conditions, fits, and every refusal."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from plan_sample import ROOT

from bench.model.errors import InputErrors
from bench.plan import Plan, check_plan, compile_sequence

LAB = ROOT / "examples/own_checks"
HEAD = "sequence: sample\nstation: unit_bench_sim\nanalysis: readings\nuut: {model: SC-1, serial: S1}\n"
READ = "meter.measure_voltage:"


def plan_of(tmp_path: Path, body: str, head: str = HEAD) -> Plan:
    shutil.copytree(LAB / "stations", tmp_path / "stations", dirs_exist_ok=True)
    path = tmp_path / "sequences/sample.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(head + body)
    return compile_sequence(path)


def steps(*lines: str) -> str:
    return "steps:\n" + "".join(f"  - {line}\n" for line in lines) + "  - settle: 60 s\n"


def reading(expect: str) -> str:
    return steps(f"rail_meter.measure_voltage:\n    expect: {expect}")


def expected(plan: Plan) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = plan.campaign["expected"]
    return entries


def refused(tmp_path: Path, body: str, head: str = HEAD) -> tuple[str, str]:
    try:
        mistakes = check_plan(plan_of(tmp_path, body, head))
    except InputErrors as error:
        mistakes = list(error.errors)
    (mistake,) = mistakes
    return mistake.code, mistake.message


@pytest.mark.parametrize(
    ("limits", "low_V", "high_V"),
    [
        ("within: [4.9 V, 5100 mV]", 4.9, 5.1),
        ("max: 150 mV", None, 0.15),
        ("min: 1 V", 1.0, None),
        ("min: 1 V, max: 2 V", 1.0, 2.0),
        ("equals: 5 V, tolerance: 2 %", 4.9, 5.1),
        ("equals: -5 V, tolerance: 0.1 V", -5.1, -4.9),
    ],
)
def test_forms_of_a_limit(tmp_path: Path, limits: str, low_V: float | None, high_V: float | None) -> None:
    (entry,) = expected(plan_of(tmp_path, reading(f"{{name: rail, {limits}}}")))
    assert (entry["quantity"], entry["unit"], entry["conditions"]) == ("rail", "V", {})
    due = {name: pytest.approx(end) for name, end in (("low", low_V), ("high", high_V)) if end is not None}
    assert {name: entry[name] for name in ("low", "high") if name in entry} == due


@pytest.mark.parametrize(
    ("equals", "tolerance", "low", "high"),
    [
        ("0.5 1", "0.1 %", 0.4995, 0.5005),
        ("0.5 1", "0.001 1", 0.499, 0.501),
        ("50 %", "2 %", 0.48, 0.52),
        ("-0.5 1", "100 ppm", -0.50005, -0.49995),
    ],
)
def test_a_tolerance_in_percent_is_a_share_unless_the_value_is_in_percent(
    tmp_path: Path, equals: str, tolerance: str, low: float, high: float
) -> None:
    limits = f"{{c1: {{equals: {equals}, tolerance: {tolerance}}}}}"
    body = f"fits: [{{name: line, of: rail, against: input, expect: {limits}}}]\n"
    two = [f"{role}_{READ}\n    expect: {{name: {role}}}" for role in ("rail", "input")]
    (fit,) = plan_of(tmp_path, body + steps(*two)).campaign["fits"]
    assert fit["expected"]["c1"] == {"low": pytest.approx(low), "high": pytest.approx(high)}


def test_loops_are_conditions_and_may_give_the_limits(tmp_path: Path) -> None:
    body = (
        "tables: {levels: [1 V, 2 V]}\nsteps:\n  - for: level\n    in: levels\n    do:\n"
        '      - rail_meter.measure_voltage:\n        expect: {name: rail, equals: "{level}", tolerance: 1 %}\n'
        "  - settle: 60 s\n"
    )
    first, second = expected(plan_of(tmp_path, body))
    assert [entry["conditions"] for entry in (first, second)] == [{"level_V": 1.0}, {"level_V": 2.0}]
    assert (second["low"], second["high"]) == pytest.approx((1.98, 2.02))


def test_a_reading_without_a_name_is_named_after_its_instrument(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, steps("rail_meter.measure_voltage"))
    assert check_plan(plan) == []
    assert [entry["quantity"] for entry in expected(plan)] == ["rail_meter_voltage"]
    assert plan.steps[0].conditions == {"quantity": "rail_meter_voltage"}


def test_other_sequences_know_nothing_of_it(tmp_path: Path) -> None:
    head = HEAD.replace("analysis: readings\n", "")
    plan = plan_of(tmp_path, steps("rail_meter.measure_voltage"), head)
    assert "expected" not in plan.campaign
    assert plan.steps[0].conditions == {}


def test_a_prompt_takes_every_unit_and_is_a_value(tmp_path: Path) -> None:
    value = "{unit: mm, low: 0.0795 m, high: 8.05 cm, quantity: length, uncertainty: 50 um}"
    assert refused(tmp_path, f"steps:\n  - prompt: {{text: x, value: {value}}}\n")[0] == "B-PLAN-120"  # no micrometre
    plan = plan_of(tmp_path, f"steps:\n  - prompt: {{text: x, value: {value.replace('50 um', '0.05 mm')}}}\n")
    assert [plan.steps[0].told()[end] for end in ("low", "high")] == pytest.approx([0.0795, 0.0805])
    (entry,) = expected(plan)
    assert entry["unit"] == "m"
    assert [entry[name] for name in ("low", "high", "uncertainty")] == pytest.approx([0.0795, 0.0805, 5e-5])


@pytest.mark.parametrize(
    ("expect", "code", "words"),
    [
        ("{name: rail, within: [4.9 A, 5.1 A]}", "B-PLAN-120", "4.9 A is in A; the value it is held against is in V"),
        ("{name: rail, within: [5.1 V, 4.9 V]}", "B-PLAN-120", "no value is inside its limits"),
        ("{name: rail, scatter: 0 mV}", "B-PLAN-120", "a scatter of 0 mV is not above zero"),
        ("{name: rail, scatter: -0.2 mV}", "B-PLAN-120", "a scatter of -0.2 mV is not above zero"),
        ("{name: rail, max: 150 mv}", "B-PLAN-120", "did you mean '150 mV'?"),
        ("{name: rail, max: 10 %}", "B-PLAN-120", "10 % is in 1"),
        ("{name: rail, max: 5}", "B-YAML-012", "is not a quantity with its unit"),
        ("{name: rail, equals: 5 V}", "B-YAML-012", "belong together"),
        ("{name: rail, max: 5 V, equals: 5 V, tolerance: 1 V}", "B-YAML-012", "one of: within"),
        ("{name: rail, within: [4.9 V]}", "B-YAML-012", ""),
    ],
)
def test_limits_that_cannot_be(tmp_path: Path, expect: str, code: str, words: str) -> None:
    with pytest.raises(InputErrors) as caught:
        plan_of(tmp_path, reading(expect))
    assert words in str(caught.value)
    if code.startswith("B-PLAN"):
        assert {error.code for error in caught.value.errors} == {code}


def test_a_wait_has_nothing_to_expect(tmp_path: Path) -> None:
    """The key is known, so the error does not suggest it again."""
    with pytest.raises(InputErrors) as caught:
        plan_of(tmp_path, steps("settle: 5 s\n    expect: {name: rail, max: 5 V}"))
    assert "unknown key 'expect'. Next: it is a key of another part" in str(caught.value)


def test_an_action_without_a_value_has_nothing_to_expect(tmp_path: Path) -> None:
    code, message = refused(tmp_path, steps("supply.output_off:\n    expect: {name: rail, max: 5 V}"))
    assert (code, "gives no number" in message) == ("B-PLAN-120", True)


def test_one_name_is_of_one_reading(tmp_path: Path) -> None:
    lines = [f"{role}.measure_voltage:\n    expect: {{name: rail}}" for role in ("rail_meter", "input_meter")]
    code, message = refused(tmp_path, steps(*lines))
    assert (code, "one name is of one reading" in message) == ("B-PLAN-121", True)
    twice = [f"rail_meter.measure_voltage:\n    expect: {{name: rail, max: {most} V}}" for most in (5, 6)]
    code, message = refused(tmp_path, steps(*twice))
    assert (code, "expected elsewhere" in message) == ("B-PLAN-121", True)


def test_nothing_is_expected_where_nothing_judges(tmp_path: Path) -> None:
    head = HEAD.replace("analysis: readings\n", "")
    assert refused(tmp_path, reading("{name: rail, max: 5 V}"), head)[0] == "B-PLAN-122"
    fits = "fits: [{name: line, of: rail, against: time}]\n"
    head = head.replace("uut", "analysis: none\nuut")
    assert refused(tmp_path, fits + steps("rail_meter.measure_voltage"), head)[0] == "B-PLAN-122"


@pytest.mark.parametrize(
    "fit", ["of: rial, against: time", "of: rail, against: levle", "of: rail, against: time, per: [x]"]
)
def test_a_fit_of_what_is_not_read(tmp_path: Path, fit: str) -> None:
    body = f"fits: [{{name: line, {fit}}}]\n" + reading("{name: rail}")
    code, message = refused(tmp_path, body)
    assert (code, "no value and no condition" in message) == ("B-PLAN-123", True)


def test_a_fit_has_the_units_of_its_quantities(tmp_path: Path) -> None:
    body = "fits: [{name: drift, of: rail, against: time, degree: 2, expect: {c1: {max: 1e-6 V/s}}}]\n"
    (fit,) = plan_of(tmp_path, body + reading("{name: rail}")).campaign["fits"]
    assert fit["units"] == {"c0": "V", "c1": "V/s", "c2": "V/s2", "nonlinearity": "V"}
    assert fit["expected"] == {"c1": {"high": 1e-6}}
    assert refused(tmp_path, body.replace("V/s}", "V}") + reading("{name: rail}"))[0] == "B-PLAN-120"


NTC = "fits: [{name: ntc, of: 1/air, against: log(ohm), powers: [0, 1, 3], MORE}]\n"
NTC_READ = steps(
    "ohmmeter.measure_resistance: {range: 100 kohm, cycles: 10}\n    expect: {name: ohm}",
    "chamber.measure_air:\n    expect: {name: air}",
)


def test_a_fit_of_functions(tmp_path: Path) -> None:
    more = "expect: {c3: {max: 1e-7 1/K}, nonlinearity: {max: 50 mohm}}, "
    more += "read_back: [{name: r25, at: 10 kohm, min: 24 degC}]"
    body = NTC.replace("MORE", more.replace("50 mohm", "0.05 degC")) + NTC_READ
    (fit,) = plan_of(tmp_path, body).campaign["fits"]
    assert fit["units"] == {"c0": "1/K", "c1": "1/K", "c3": "1/K", "nonlinearity": "degC"}
    assert (fit["function"], fit["against"]) == ("reciprocal", {"quantity": "ohm", "unit": "ohm", "function": "log"})
    assert fit["expected"] == {"c3": {"high": 1e-7}, "nonlinearity": {"high": 0.05}}
    assert fit["read_back"] == [{"quantity": "r25", "at": 1e4, "unit": "degC", "low": 24.0}]
    code, message = refused(tmp_path, NTC.replace("MORE", more) + NTC_READ)
    assert (code, "0.05 ohm" in message or "50 mohm is in ohm" in message) == ("B-PLAN-120", True)


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("of: 1/air", "of: log(air)", "B-PLAN-123", "has no logarithm"),
        ("against: log(ohm)", "against: log(omh)", "B-PLAN-123", "called 'omh'"),
        ("against: log(ohm)", "against: log(time)", "B-PLAN-123", "called 'time'"),
        ("MORE", "read_back: [{name: air, at: 10 kohm}]", "B-PLAN-121", "is read"),
        ("MORE", "read_back: [{name: r25, at: 25 degC}]", "B-PLAN-120", "25 degC is in degC"),
        ("MORE", "degree: 3", "B-YAML-012", "not both"),
        ("[0, 1, 3]", "[0, 3, 1]", "B-YAML-012", "do not rise"),
        ("[0, 1, 3]", "[0, 1, 9]", "B-YAML-012", "9"),
        ("MORE", "expect: {c2: {max: 1 1/K}}", "B-YAML-012", "has no result 'c2'"),
        ("of: 1/air", "of: sqrt(air)", "B-YAML-012", "sqrt(air)"),
    ],
)
def test_functions_that_cannot_be_fitted(tmp_path: Path, old: str, new: str, code: str, words: str) -> None:
    body = NTC.replace(old, new).replace(", MORE", "") + NTC_READ
    if code.startswith("B-PLAN"):
        found, message = refused(tmp_path, body)
        assert (found, words in message) == (code, True)
    else:
        with pytest.raises(InputErrors) as caught:
            plan_of(tmp_path, body)
        assert words in str(caught.value)


def test_an_analysis_of_values_needs_one(tmp_path: Path) -> None:
    assert refused(tmp_path, "steps:\n  - settle: 60 s\n")[0] == "B-PLAN-078"
