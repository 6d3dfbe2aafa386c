"""Commands of the frame, tests, prompts in every unit, pure numbers, records of samples: from the file to the plan."""

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from plan_sample import changed, make_bench, mistakes, reworded

from bench.model.errors import InputError, InputErrors
from bench.model.ports import Parameter
from bench.plan import Findings, Plan, PlannedPrompt, check_plan, compile_sequence, plan_json, steps_of
from bench.plan.check.actions import ActionCheck
from bench.run.control.asking import Refused, _judged
from bench.run.operator import Question, limits_of

SEQUENCE = """\
sequence: sample
station: gnc_bench_sim
frame: {rs422: gnc_422}
uut: {model: GNC, serial: "{serial}"}
site: {latitude: 30 deg, gravity: 9.8 m/s2, azimuth: 90 deg}
parameters: {serial: GNC-07}
prepare:
  - prompt: {text: "Put unit {serial} on the board, {angle_text} of it.", sets: {unit: "{serial}", dip_switch: 2}}
  - supply.configure: {voltage: 5 V, current_limit: 0.6 A, over_voltage: 5.6 V}
  - supply.output_on
  - settle: 3 s
  - unit: {rs422: {stream_start: {sensors: 7, rate: 200 Hz, samples: 0}}}
  - unit: {rs422: stream_stop}
  - settle: 1 s
steps:
  - for: setting
    in: [0.5 ms, 2 ms]
    do:
      - test: {item: timer, command: timer, arguments: {setting_us: "{setting}", ticks: 20}}
  - settle: 2 s
  - record: {seconds: 1 s, samples: true, conditions: {item: bias}}
"""
TEXT = ("{angle_text}", "all")


def compiled(folder: Path, *changes: tuple[str, str]) -> Plan:
    path = folder / "sample.yaml"
    path.write_text(reworded(SEQUENCE, TEXT, *changes))
    return compile_sequence(path)


def unit_mistakes(folder: Path, *changes: tuple[str, str]) -> list[tuple[str, str]]:
    try:
        return [(one.code, one.message) for one in check_plan(compiled(folder, *changes))]
    except InputErrors as errors:
        return [(one.code, one.message) for one in errors.errors]


def test_from_the_file_to_the_plan(tmp_path: Path) -> None:
    """A command of the frame becomes its bytes, a test carries what it was given, a prompt what it changes."""
    plan = compiled(tmp_path)
    prompt = plan.phase("prepare")[0]
    assert prompt.text == "Put unit GNC-07 on the board, all of it."
    assert prompt.sets == {"unit": "GNC-07", "dip_switch": 2}
    start, stop = (step for step in plan.phase("prepare") if step.kind == "unit")
    assert (start.name, start.code, start.item) == ("stream_start", 0x20, "")
    assert bytes(start.payload) == bytes.fromhex("07 c8 00 00 00 00 00")
    assert (stop.code, stop.payload, stop.written({})) == (0x21, (), {"unit": {stop.role: "stream_stop"}})
    assert replace(stop, item="timer").written({})["test"]["item"] == "timer"
    with pytest.raises(InputError, match="the arguments of the command 'stream_start' stand in the plan as bytes"):
        start.written({})
    tests = [step for step in plan.phase("campaign") if step.kind == "unit"]
    assert [bytes(step.payload).hex(" ") for step in tests] == ["f4 01 00 00 14", "d0 07 00 00 14"]
    assert [(step.item, step.conditions["setting_us_s"]) for step in tests] == [("timer", 0.0005), ("timer", 0.002)]
    assert next(step for step in plan.steps if step.kind == "record").samples is True
    assert plan.campaign["site"] == {"latitude_deg": 30.0, "gravity_m_s2": 9.8, "azimuth_deg": 90.0}
    assert plan.campaign["uut"] == {"model": "GNC", "serial": "GNC-07"}
    assert "af_clock_Hz" not in plan.campaign


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (("rate: 200 Hz", "rate: 70000 Hz"), "B-PLAN-091", "70000"),
        (("rate: 200 Hz, ", ""), "B-PLAN-091", "rate"),
        (("{rs422: stream_stop}", "{rs422: stream_stp}"), "B-PLAN-049", "did you mean 'stream_stop'"),
        (("item: timer,", "link: rs42, item: timer,"), "B-PLAN-041", "no link 'rs42'"),
        (("seconds: 1 s", "seconds: 20000 s"), "B-PLAN-092", "4000000 samples"),
        (('serial: "{serial}"}', 'serial: "{serial}", limits: {supply_volts: 5 V}}'), "B-PLAN-093", "supply_volts"),
        (('serial: "{serial}"}', 'serial: "{serial}", limits: {supply_voltage: 5 V}}'), "B-PLAN-093", "nothing judges"),
        (("sets: {unit:", "sets: {unti:"), "B-PLAN-094", "'unti' cannot be set"),
        (("dip_switch: 2", "dip_switch: 9"), "B-PLAN-094", "dip_switch cannot be 9"),
        (('sets: {unit: "{serial}"', "sets: {unit: ../../x"), "B-PLAN-025", "'../../x' is not a serial number"),
        (("all of it", "all {of it"), "B-PLAN-030", "'{of it.' in the text is no variable"),
        (("sets: {unit:", "value: {unit: m, low: 26 mm, high: 20 mm}, sets: {unit:"), "B-PLAN-044", "26 mm is above"),
    ],
)
def test_mistakes(tmp_path: Path, change: tuple[str, str], code: str, says: str) -> None:
    found = unit_mistakes(tmp_path, change)
    assert any(one == code and says in message for one, message in found), found


OF_TESTS = ("station: gnc", "analysis: gnc_unit_test\nstation: gnc")


@pytest.mark.parametrize(
    ("item", "says"),
    [("timr", "does not judge the item 'timr'; did you mean 'timer'?"), ("timer", ""), ("fan_speed", "")],
)
def test_an_item_that_is_nearly_one_is_a_slip_of_the_pen(tmp_path: Path, item: str, says: str) -> None:
    found = unit_mistakes(tmp_path, OF_TESTS, ("item: timer", f"item: {item}"))
    assert [code for code, _ in found] == (["B-PLAN-078"] if says else [])
    assert all(says in message for _, message in found)


def test_an_analysis_of_records_needs_one(tmp_path: Path) -> None:
    record = "  - record: {seconds: 1 s, samples: true, conditions: {item: bias}}\n"
    ((code, message),) = unit_mistakes(tmp_path, ("station: gnc", "analysis: imu_bias\nstation: gnc"), (record, ""))
    assert (code, "imu_bias is made of records" in message) == ("B-PLAN-078", True)


def test_samples_of_frames_that_count_b_plan_092(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[3] / "sequences" / "bias_ramp_short.yaml").read_text()
    path = tmp_path / "bias_ramp_short.yaml"
    path.write_text(text.replace("pulse_timing: true", "samples: true"))
    with pytest.raises(InputErrors) as caught:
        compile_sequence(path)
    assert {one.code for one in caught.value.errors} == {"B-PLAN-092"}


IMU = "gnc_imu_calibration"
MIDDLE = 'mounting: x, outer: 0 deg, middle: "{middle}"'


@pytest.mark.parametrize(
    ("shipped", "old", "new", "says"),
    [
        (IMU, "{up: +x, middle: -90 deg,", "{up: +x, middle: -80 deg,", ""),
        (IMU, MIDDLE, MIDDLE.replace('"{middle}"', "45 deg"), "middle axis at 45 deg"),
        (IMU, "mounting: x, outer", "mounting: y, outer", "mounting y, but the operator was told x"),
        (IMU, "turn: -1080 deg, inner: 1080 deg", "turn: -1080 deg, inner: 90 deg", "inner axis at 90 deg"),
        ("gnc_bias", "up: -z, inner: 180 deg", "up: -z, inner: 0 deg", "sent to 180 deg"),
    ],
)
def test_poses(tmp_path: Path, shipped: str, old: str, new: str, says: str) -> None:
    text = (Path(__file__).resolve().parents[3] / "sequences" / f"{shipped}.yaml").read_text()
    assert old in text
    path = tmp_path / f"{shipped}.yaml"
    path.write_text(text.replace(old, new))
    found = check_plan(compile_sequence(path))
    assert {one.code for one in found} == ({"B-PLAN-076"} if says else set())
    assert not says or says in found[0].message


def test_what_a_test_takes_must_fit_in_its_settle_time(tmp_path: Path) -> None:
    longer = ("ticks: 20}}", "ticks: 20}, takes: 0.6 s}")
    assert unit_mistakes(tmp_path, longer) == []
    ((code, message),) = unit_mistakes(tmp_path, longer, ("  - settle: 2 s\n  - record", "  - settle: 1 s\n  - record"))
    assert (code, "1.2 s" in message) == ("B-PLAN-060", True)


PROMPT = "prompt: {text: earth, value: {unit: ohm, high: 0.5 ohm}}"


def shown_prompt(folder: Path, text: str) -> PlannedPrompt:
    plan = compile_sequence(make_bench(folder, changed(PROMPT, f"prompt: {text}")))
    read = steps_of(plan_json(plan.steps))
    assert list(read) == list(plan.steps)
    return next(step for step in read if isinstance(step, PlannedPrompt))


@pytest.mark.parametrize(
    ("text", "presence", "told"),
    [
        ("earth", "bench", {}),
        ("{text: earth, presence: bench}", "bench", {}),
        ("{text: earth, presence: anywhere}", "anywhere", {"presence": "anywhere"}),
    ],
)
def test_the_bench_is_the_default_and_not_written(tmp_path: Path, text: str, presence: str, told: object) -> None:
    """A plan without the word has the same bytes, and so the same hash, as before there was one."""
    step = shown_prompt(tmp_path, text)
    assert step.presence == presence
    assert step.told() == {"text": "earth", "confirm": "operator", **told}  # type: ignore[dict-item]


@pytest.mark.parametrize("text", ["{text: earth, presence: phone}", "{text: e, sets: {unit: A}, presence: anywhere}"])
def test_what_cannot_be_is_refused(tmp_path: Path, text: str) -> None:
    (found,) = mistakes(make_bench(tmp_path, changed(PROMPT, f"prompt: {text}")))
    assert found.code in ("B-YAML-013", "B-YAML-012")
    assert "presence" in str(found)


ASKED = "value: {unit: ohm, high: 0.5 ohm}"


@pytest.mark.parametrize(
    ("unit", "written", "base", "high"),
    [
        ('"%"', "80 %", "1", 0.8),
        ("ppm", "20 ppm", "1", 20e-6),
        ("min", "2 min", "s", 120.0),
        ("kohm", "0.5 Mohm", "ohm", 5e5),
        ("degC", "23 °C", "degC", 23.0),
        ("arcmin", "30 arcmin", "deg", 0.5),
        ("m/s2", "9.81 m/s²", "m/s2", 9.81),
        ("mm", "26 mm", "m", 0.026),
        ("ppm/degC2", "5 ppm/degC2", "1/degC2", 5e-6),
    ],
)
def test_every_kind_of_unit(tmp_path: Path, unit: str, written: str, base: str, high: float) -> None:
    step = shown_prompt(tmp_path, f"{{text: earth, {ASKED.replace('ohm, high: 0.5 ohm', f'{unit}, high: {written}')}}}")
    assert step.unit == base
    assert step.high == pytest.approx(high, rel=1e-15)


def test_a_ratio_is_asked_for_in_percent(tmp_path: Path) -> None:
    """Humidity of the room, for example: 45 % is 0.45 in session and results."""
    step = shown_prompt(tmp_path, '{text: x, value: {unit: "%", low: 20 %, high: 60 %, quantity: humidity}}')
    question = Question(step.text, step.confirm, step.unit, step.low, step.high)
    assert (step.low, step.high, limits_of(question)) == (0.2, 0.6, "20 % to 60 %")
    assert _judged(question, "45 %", "somebody").value == 0.45
    with pytest.raises(Refused, match="70 % is outside the limits"):
        _judged(question, "70 %", "somebody")
    with pytest.raises(Refused, match="a value in % is due"):
        _judged(question, "", "somebody")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("{unit: MM, high: 1 mm}", "'MM' is no unit; did you mean 'mm'?"),
        ("{unit: furlong, high: 1 m}", "'furlong' is no unit; use one of: %, "),
        ('{unit: "%", high: 1 mm}', "'1 mm' is in m; a ratio is due"),
    ],
)
def test_a_unit_that_is_none(tmp_path: Path, value: str, expected: str) -> None:
    found = mistakes(make_bench(tmp_path, changed(ASKED, f"value: {value}")))
    assert any(expected in error.message for error in found), [str(error) for error in found]


COUNT = Parameter("count", "1", 1.0, 5.0)
STEP: Any = SimpleNamespace(role="meter", name="average", where="s.yaml:3:5", number=0)


def checker() -> tuple[ActionCheck, Findings]:
    findings = Findings()
    plan: Any = SimpleNamespace(origins=defaultdict(dict), declared=defaultdict(dict))
    station: Any = SimpleNamespace(name="station")
    return ActionCheck(plan, station, findings), findings


@pytest.mark.parametrize(
    ("value", "dimension", "right"),
    [(3, "", True), (2.5, "", True), (0.05, "1", True), (True, "", False), ("3", "", False), (3.0, "A", False)],
)
def test_what_counts_as_a_pure_number(value: Any, dimension: str, right: bool) -> None:
    check, findings = checker()
    assert check._sort_is_right(STEP, COUNT, value, dimension) is right
    assert [one.code for one in findings.sorted()] == ([] if right else ["B-PLAN-052"])
