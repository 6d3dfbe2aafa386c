"""What an analysis, a named value and 'until' ask of the records is asked before the run."""

import math
import shutil
from pathlib import Path
from typing import Any

import plan_sample
import pytest
from plan_sample import ROOT, reworded
from rehearsal import compiled
from units_campaign import stopping_plan, stopping_text

from bench.model.errors import InputErrors
from bench.model.installed import named
from bench.model.stopping import STAGE, UNTIL
from bench.model.systems import analyses
from bench.plan import Plan, PlannedRecord, check_plan, compile_sequence, decisions_of, load_station, summarise

REGISTER_LINE = (
    "        - {range: 10 mA, relative: 20 ppm, floor: 50 nA, specification: relative, age: 8760 h, "
    "certificate_U: 10 ppm, common_with: SIM-0007}\n"
)


def shipped_mistakes(folder: Path, shipped: str, *changes: tuple[str, str]) -> list[tuple[str, str]]:
    """Codes and messages that the check finds in a shipped sequence with changes."""
    path = folder / f"{shipped}.yaml"
    path.write_text(reworded((ROOT / "sequences" / f"{shipped}.yaml").read_text(), *changes))
    return [(one.code, one.message) for one in plan_sample.mistakes(path)]


@pytest.mark.parametrize("name", analyses())
def test_what_is_declared_is_what_the_analysis_has(name: str) -> None:
    assert analyses()[name][0].methods == named(analyses()[name][0].module).METHODS


SYNC = "time_sync_linear"
NONE = "analysis: none"


@pytest.mark.parametrize(
    ("shipped", "old", "new", "code", "says"),
    [
        ("bias_ramp_short", "analysis: bias_ramp", "analysis: bias_rmp", "B-PLAN-077", "did you mean 'bias_ramp'"),
        ("bias_ramp_short", "analysis: bias_ramp", "analysis: temperature_ramp", "B-PLAN-077", "imported logs"),
        ("bias_ramp_short", "branch: up", "brnch: up", "B-PLAN-078", "condition branch"),
        ("bias_ramp_short", "branch: up", "branch: upwards", "B-PLAN-078", "no branch 'upwards'"),
        ("bias_ramp_short", "route: open, branch: up", "branch: up", "B-PLAN-078", "condition route"),
        ("bias_ramp_short", "analysis: bias_ramp", "analysis: scale_factor", "B-PLAN-078", "channel, temperature_degC"),
        ("scale_factor_short", '            current: "{current}"\n', "", "B-PLAN-078", "condition current_A"),
        (
            "dmm_method",
            "- dmm.measure_current",
            "- verify: calibrator.operating",
            "B-PLAN-078",
            "readings of the meter",
        ),
        (SYNC, "frame: {imu: imu_200, egi: egi_50}", "frame: {imu: imu_200}", "B-PLAN-078", "link 'egi' beside"),
        (SYNC, "imu: imu_200, egi: egi_50", "egi: egi_50, imu: imu_200", "B-PLAN-078", "link 'egi' beside"),
        (SYNC, "stamps_difference: 5 ms", "stamps_difference: -5 ms", "B-PLAN-093", "-5 ms is not above zero"),
        (SYNC, "analysis: time_sync", NONE, "B-PLAN-093", "nothing judges the limit"),
        ("scale_factor_short", "uut:", "uut:\n  limits: {supply_voltage: 5 V}", "B-PLAN-093", "'scale_factor' has no"),
        ("scale_factor_short", "analysis: scale_factor", f"{NONE}\ndecision: {{rule: simple}}", "B-PLAN-098", "rule"),
    ],
)
def test_what_no_analysis_can_use_is_told(
    tmp_path: Path, shipped: str, old: str, new: str, code: str, says: str
) -> None:
    found = shipped_mistakes(tmp_path, shipped, (old, new))
    assert any(one == code and says in message for one, message in found), found


def test_a_range_of_the_meter_needs_an_uncertainty_and_must_hold_the_level(tmp_path: Path) -> None:
    station = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
    assert REGISTER_LINE in station
    (tmp_path / "af_bench_sim.yaml").write_text(station.replace(REGISTER_LINE, ""))
    bench = load_station(tmp_path / "af_bench_sim.yaml")
    (found,) = check_plan(compile_sequence(ROOT / "sequences" / "dmm_method.yaml", bench))
    assert found.code == "B-PLAN-066"
    assert "dmm: the plan uses 10 mA" in found.message
    point = "      - point: {current: 10 mA, polarity: +, meter: 10 mA, repeat: 1}"
    found = shipped_mistakes(tmp_path, "dmm_method", (point, point.replace("meter: 10 mA", "meter: 1 mA")))
    assert {code for code, _ in found} == {"B-PLAN-079"}
    assert all("0.001 A range and cannot read the 0.01 A of calibrator" in message for _, message in found)


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


def at_levels(text: str) -> str:
    """The same steps at four levels, so that a fit has points."""
    loop = "steps:\n  - for: level\n    in: [1, 2, 3, 4]\n    do:\n"
    return loop + text.removeprefix("steps:\n").replace("  - ", "      - ").replace("    expect", "        expect")


def expected(plan: Plan) -> list[dict[str, Any]]:
    return plan.campaign["expected"]


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
def test_a_tolerance_in_percent_is_a_share(
    tmp_path: Path, equals: str, tolerance: str, low: float, high: float
) -> None:
    limits = f"{{c1: {{equals: {equals}, tolerance: {tolerance}}}}}"
    body = f"fits: [{{name: line, of: rail, against: input, expect: {limits}}}]\n"
    two = [f"{role}_{READ}\n    expect: {{name: {role}}}" for role in ("rail", "input")]
    (fit,) = plan_of(tmp_path, body + at_levels(steps(*two))).campaign["fits"]
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


def test_a_reading_is_named_after_its_instrument_where_an_analysis_reads_it(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, steps("rail_meter.measure_voltage"))
    assert check_plan(plan) == []
    assert [entry["quantity"] for entry in expected(plan)] == ["rail_meter_voltage"]
    assert plan.steps[0].conditions == {"quantity": "rail_meter_voltage"}
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


VOLTS = "rail_meter.measure_voltage:\n    expect: "
LINE = "fits: [{name: line, of: FIT}]\n"
OTHER = "input_meter.measure_voltage:\n    expect: {name: rail}"


@pytest.mark.parametrize(
    ("body", "code", "words"),
    [
        (reading("{name: rail, max: 4.9 A}"), "B-PLAN-120", "4.9 A is in A; the value it is held against is in V"),
        (reading("{name: rail, within: [5.1 V, 4.9 V]}"), "B-PLAN-120", "no value is inside its limits"),
        (reading("{name: rail, scatter: 0 mV}"), "B-PLAN-120", "a scatter of 0 mV is not above zero"),
        (reading("{name: rail, max: 150 mv}"), "B-PLAN-120", "did you mean '150 mV'?"),
        (reading("{name: rail, max: 10 %}"), "B-PLAN-120", "10 % is in 1"),
        (reading("{name: rail, equals: 5 V}"), "B-YAML-012", "belong together"),
        (reading("{name: rail, max: 5 V, equals: 5 V, tolerance: 1 V}"), "B-YAML-012", "one of: within"),
        (steps("supply.output_off:\n    expect: {name: rail, max: 5 V}"), "B-PLAN-120", "gives no number"),
        (steps(f"{VOLTS}{{name: rail}}", OTHER), "B-PLAN-121", "one name is of one reading"),
        (steps(*(f"{VOLTS}{{name: rail, max: {most} V}}" for most in (5, 6))), "B-PLAN-121", "expected elsewhere"),
        (LINE.replace("FIT", "rial, against: time") + reading("{name: rail}"), "B-PLAN-123", "no value and no cond"),
        (LINE.replace("FIT", "rail, against: levle") + reading("{name: rail}"), "B-PLAN-123", "no value and no cond"),
        (LINE.replace("FIT", "rail, against: time, per: [x]") + reading("{name: rail}"), "B-PLAN-123", "no value and"),
        ("steps:\n  - settle: 60 s\n", "B-PLAN-078", ""),
    ],
)
def test_what_cannot_be_expected(tmp_path: Path, body: str, code: str, words: str) -> None:
    found, message = refused(tmp_path, body)
    assert (found, words in message) == (code, True), message


def test_nothing_is_expected_where_nothing_judges(tmp_path: Path) -> None:
    head = HEAD.replace("analysis: readings\n", "")
    assert refused(tmp_path, reading("{name: rail, max: 5 V}"), head)[0] == "B-PLAN-122"
    fits, head = LINE.replace("FIT", "rail, against: time"), head.replace("uut", "analysis: none\nuut")
    assert refused(tmp_path, fits + steps("rail_meter.measure_voltage"), head)[0] == "B-PLAN-122"


def test_a_fit_has_the_units_of_its_quantities(tmp_path: Path) -> None:
    body = "fits: [{name: drift, of: rail, against: time, degree: 2, expect: {c1: {max: 1e-6 V/s}}}]\n"
    (fit,) = plan_of(tmp_path, body + at_levels(reading("{name: rail}"))).campaign["fits"]
    assert fit["units"] == {"c0": "V", "c1": "V/s", "c2": "V/s2", "nonlinearity": "V"}
    assert fit["expected"] == {"c1": {"high": 1e-6}}
    assert refused(tmp_path, body.replace("V/s}", "V}") + at_levels(reading("{name: rail}")))[0] == "B-PLAN-120"
    assert refused(tmp_path, body + reading("{name: rail}"))[1].startswith("1 points do not determine the 3 coeff")


NTC = "fits: [{name: ntc, of: 1/air, against: log(ohm), powers: [0, 1, 3], MORE}]\n"
NTC_READ = at_levels(steps(
    "ohmmeter.measure_resistance: {range: 100 kohm, cycles: 10}\n    expect: {name: ohm}",
    "chamber.measure_air:\n    expect: {name: air}",
))  # fmt: skip


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
        ("MORE", "expect: {c2: {max: 1 1/K}}", "B-YAML-012", "has no result 'c2'"),
    ],
)
def test_functions_that_cannot_be_fitted(tmp_path: Path, old: str, new: str, code: str, words: str) -> None:
    found, message = refused(tmp_path, NTC.replace(old, new).replace(", MORE", "") + NTC_READ)
    assert (found, words in message) == (code, True), message


QUANTUM_C, AF_Hz, WHITE_A_rtHz = 1.25e-6, 256e3, 2e-9


UNTIL_2_PPM = "{random: 2 ppm, most: 30}"
UNTIL_LINE = f"until: {UNTIL_2_PPM}\n"


def ending(plan: Plan) -> list[PlannedRecord]:
    return [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord) and step.longest_s]


def random_A(level_A: float, seconds: float) -> float:
    """Standard uncertainty of a mean over one record, by hand."""
    residue = math.sqrt(1.0 / 12.0 + 1.0 / 12.0)
    counts, clock = residue * QUANTUM_C / seconds, residue * level_A / (AF_Hz * seconds)
    return math.sqrt(counts**2 + clock**2 + WHITE_A_rtHz**2 / (2.0 * seconds))


@pytest.mark.validates("lengths that declared noise asks for", against="quantisation and white noise, by hand")
@pytest.mark.parametrize(("until", "share"), [("{random: 2 ppm, most: 100}", 2e-6), ("{random: 30 nA, most: 100}", 0)])
def test_a_record_is_no_longer_than_declared_noise_asks_for(tmp_path: Path, until: str, share: float) -> None:
    plan = stopping_plan(tmp_path, until, "1 s", "10 mA, 100 mA, 200 mA")
    records = ending(plan)
    assert len(records) == 6
    for record in records:
        level_A = record.conditions["current_A"]
        target_A = share * level_A or 30e-9
        assert random_A(level_A, record.seconds) <= target_A * (1 + 1e-9)
        assert random_A(level_A, record.seconds - 1.0) > target_A if record.seconds > 1.0 else True
        assert record.longest_s == 100.0
    assert decisions_of(plan.steps) == []
    (told,) = summarise(plan).stops
    assert told.startswith("6 points last ")


def test_least_is_never_undercut(tmp_path: Path) -> None:
    plan = stopping_plan(tmp_path, "{random: 1000 ppm, least: 4, most: 100}", "1 s")
    assert {record.seconds for record in ending(plan)} == {4.0}


def test_a_second_stage_has_a_branch_for_each_length(tmp_path: Path) -> None:
    plan = stopping_plan(tmp_path, "{random: 10 ppm, least: 12, most: 40, by: scatter}", "1 s", "100 mA")
    decision = decisions_of(plan.steps)[0]
    assert (decision.word, decision.unit, decision.missing) == (UNTIL, "1", "28 more")
    first = [plan.steps[number] for number in decision.arguments["first"]]
    assert [step.number for step in first] == list(range(decision.number - 12, decision.number))
    assert all(isinstance(step, PlannedRecord) and step.follows == bool(at) for at, step in enumerate(first))
    assert {step.conditions[STAGE] for step in first} == {1}
    lengths = [sum(plan.steps[at].duration_s for at in range(b.first, b.stop)) for b in decision.branches]
    assert lengths == [0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 28]
    outcomes = {need: decision.outcome(float(need)) for need in (0, 1, 5, 17, 28, 400)}
    assert outcomes == {0: "0 more", 1: "1 more", 5: "6 more", 17: "24 more", 28: "28 more", 400: "28 more"}
    behind = next(step for step in plan.steps if step.number == decision.branches[-1].stop)
    assert behind.at_s == first[0].at_s + 40.0, "the longest counts"


@pytest.mark.parametrize(
    ("until", "changes", "code", "says"),
    [
        ("{random: 0.5 ppm, most: 5}", ("", ""), "B-PLAN-161", "noise and quantisation leave 20.4 nA (2.04 ppm)"),
        ("{random: 0.5 ppm, most: 15, by: scatter}", ("", ""), "B-PLAN-161", "quantisation alone leaves 9.63 nA"),
        ("{random: 2 ppm, least: 9, most: 30, by: scatter}", ("", ""), "B-PLAN-160", "first stage has 10 records or"),
        ("{random: 2 ppm, most: 10, by: scatter}", ("", ""), "B-PLAN-160", "and fewer than 'most': 10"),
        (UNTIL_2_PPM, (UNTIL_LINE, f"{UNTIL_LINE}          pulse_timing: true\n"), "B-PLAN-160", "'pulse_timing'"),
        (UNTIL_2_PPM, ("analysis: scale_factor", NONE), "B-PLAN-160", ""),
        ("{random: 2 s, most: 30}", ("", ""), "B-PLAN-031", "2 s is no ratio and no quantity in A above zero"),
    ],
)
def test_a_target_out_of_reach_is_told(
    tmp_path: Path, until: str, changes: tuple[str, str], code: str, says: str
) -> None:
    path = tmp_path / "stopping.yaml"
    text = stopping_text(until, "5 s", "10 mA")
    assert changes[0] in text
    path.write_text(text.replace(*changes, 1))
    with pytest.raises(InputErrors) as caught:
        compiled(path)
    assert {error.code for error in caught.value.errors} == {code}
    assert "stopping.yaml:" in caught.value.errors[0].where
    assert says in caught.value.errors[0].message
