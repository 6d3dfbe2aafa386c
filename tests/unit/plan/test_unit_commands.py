"""Commands of the frame, tests, prompts that change the bench, records of samples: from the file to the plan."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.model.errors import InputErrors
from bench.model.systems import analyses
from bench.plan import Plan, check_plan, compile_sequence
from bench.systems.gnc.declaration import DECLARATION
from bench.systems.gnc.limits import SPECIFIED
from bench.systems.gnc.unit_test.units import IDENTITY, SUPPLY
from bench.systems.gnc.unit_test.units import ITEMS as JUDGED

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
    text = SEQUENCE
    for old, new in (TEXT, *changes):
        assert old in text
        text = text.replace(old, new)
    path = folder / "sample.yaml"
    path.write_text(text)
    return compile_sequence(path)


def mistakes(folder: Path, *changes: tuple[str, str]) -> list[tuple[str, str]]:
    try:
        return [(one.code, one.message) for one in check_plan(compiled(folder, *changes))]
    except InputErrors as errors:
        return [(one.code, one.message) for one in errors.errors]


def test_a_command_of_the_frame_becomes_its_bytes(tmp_path: Path) -> None:
    start, stop = (step for step in compiled(tmp_path).phase("prepare") if step.kind == "unit")
    assert (start.name, start.code) == ("stream_start", 0x20)
    assert bytes(start.payload) == bytes.fromhex("07 c8 00 00 00 00 00")
    assert not start.item
    assert (stop.code, stop.payload) == (0x21, ())


def test_a_test_carries_its_item_and_what_it_was_given(tmp_path: Path) -> None:
    tests = [step for step in compiled(tmp_path).phase("campaign") if step.kind == "unit"]
    assert [bytes(step.payload) for step in tests] == [
        bytes.fromhex("f4 01 00 00 14"),
        bytes.fromhex("d0 07 00 00 14"),
    ]
    assert {step.item for step in tests} == {"timer"}
    assert [step.conditions["setting_us_s"] for step in tests] == [0.0005, 0.002]


def test_a_prompt_says_what_it_changes(tmp_path: Path) -> None:
    prompt = compiled(tmp_path).phase("prepare")[0]
    assert prompt.text == "Put unit GNC-07 on the board, all of it."
    assert prompt.sets == {"unit": "GNC-07", "dip_switch": 2}


def test_the_place_of_the_bench_reaches_the_analysis(tmp_path: Path) -> None:
    campaign = compiled(tmp_path).campaign
    assert campaign["site"] == {"latitude_deg": 30.0, "gravity_m_s2": 9.8, "azimuth_deg": 90.0}
    assert campaign["uut"] == {"model": "GNC", "serial": "GNC-07"}
    assert "af_clock_Hz" not in campaign


def test_a_record_of_samples_says_so(tmp_path: Path) -> None:
    record = next(step for step in compiled(tmp_path).steps if step.kind == "record")
    assert record.samples is True


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (("samples: 0}", "smples: 0}"), "B-PLAN-091", "smples"),
        (("rate: 200 Hz", "rate: 70000 Hz"), "B-PLAN-091", "70000"),
        (("rate: 200 Hz, ", ""), "B-PLAN-091", "rate"),
        (("rate: 200 Hz", "rate: 200 s"), "B-PLAN-091", "200"),
        (("ticks: 20", "ticks: 2000"), "B-PLAN-091", "2000"),
        (("command: timer", "command: timr"), "B-PLAN-049", "did you mean 'timer'"),
        (("{rs422: stream_stop}", "{rs422: stream_stp}"), "B-PLAN-049", "did you mean 'stream_stop'"),
        (("item: timer,", "link: rs42, item: timer,"), "B-PLAN-041", "no link 'rs42'"),
        (("Put unit {serial}", "Put unit {serail}"), "B-PLAN-030", "serail"),
        (("seconds: 1 s", "seconds: 20000 s"), "B-PLAN-092", "4000000 samples"),
        (('serial: "{serial}"}', 'serial: "{serial}", limits: {supply_volts: 5 V}}'), "B-PLAN-093", "supply_volts"),
        (('serial: "{serial}"}', 'serial: "{serial}", limits: {supply_voltage: 5 V}}'), "B-PLAN-093", "nothing judges"),
        (("sets: {unit:", "sets: {unti:"), "B-PLAN-094", "'unti' cannot be set"),
        (("dip_switch: 2", "dip_switch: 9"), "B-PLAN-094", "dip_switch cannot be 9"),
        (('sets: {unit: "{serial}"', "sets: {unit: GNC-1234567890"), "B-PLAN-094", "unit cannot be 'GNC-1234567890'"),
        (('sets: {unit: "{serial}"', "sets: {unit: ../../x"), "B-PLAN-025", "'../../x' is not a serial number"),
        (('sets: {unit: "{serial}"', "sets: {unit: ''"), "B-PLAN-025", "'' is not a serial number"),
        (('sets: {unit: "{serial}"', "sets: {unit: " + "U" * 300), "B-PLAN-025", "UUU...' is not a serial number"),
        (("all of it", "all {Of} it"), "B-PLAN-030", "'{Of}' in the text is no variable"),
        (("all of it", "all {of it"), "B-PLAN-030", "'{of it.' in the text is no variable"),
        (("all of it", "all of {{serial}} it"), "B-PLAN-030", "is no variable"),
        (("sets: {unit:", "value: {unit: m, low: 26 mm, high: 20 mm}, sets: {unit:"), "B-PLAN-044", "26 mm is above"),
        (("sets: {unit:", "value: {unit: m, low: 26}, sets: {unit:"), "B-YAML-012", "26 has no unit"),
        (
            ('serial: "{serial}"}', 'serial: "{serial}", limits: {supply_voltage: 5}}'),
            "B-YAML-012",
            "5 is not a quantity",
        ),
        (("latitude: 30 deg", "latitude: 130 deg"), "B-YAML-012", "130 deg"),
        (("latitude: 30 deg", "latitude: 30"), "B-YAML-012", "no unit"),
    ],
)
def test_mistakes(tmp_path: Path, change: tuple[str, str], code: str, says: str) -> None:
    found = mistakes(tmp_path, change)
    assert any(one == code and says in message for one, message in found), found


OF_TESTS = ("station: gnc", "analysis: gnc_unit_test\nstation: gnc")


@pytest.mark.parametrize(
    ("item", "says"),
    [("timr", "does not judge the item 'timr'; did you mean 'timer'?"), ("timer", ""), ("fan_speed", "")],
)
def test_an_item_that_is_nearly_one_is_a_slip_of_the_pen(tmp_path: Path, item: str, says: str) -> None:
    found = mistakes(tmp_path, OF_TESTS, ("item: timer", f"item: {item}"))
    assert [code for code, _ in found] == (["B-PLAN-078"] if says else [])
    assert all(says in message for _, message in found)


def test_the_items_are_those_of_the_analysis() -> None:
    assert set(analyses()["gnc_unit_test"][0].items) == {SUPPLY, IDENTITY, *JUDGED}


def test_an_analysis_of_records_needs_one(tmp_path: Path) -> None:
    record = "  - record: {seconds: 1 s, samples: true, conditions: {item: bias}}\n"
    ((code, message),) = mistakes(tmp_path, ("station: gnc", "analysis: imu_bias\nstation: gnc"), (record, ""))
    assert (code, "imu_bias is made of records" in message) == ("B-PLAN-078", True)


def test_the_limits_are_those_of_the_analyses() -> None:
    assert SPECIFIED.keys() == DECLARATION.limits.keys()
    declared = {name: analysis.limits for name, (analysis, _, _) in analyses().items() if analysis.limits}
    dimensions = {name: {key: limit.dimension for key, limit in limits.items()} for name, limits in declared.items()}
    assert dimensions == {
        "fog_north": {"azimuth_error": "deg"},
        "rlg_lock_in": {"alignment_error": "deg", "alignment_time": "s"},
        "time_sync": {"time_offset_uncertainty": "s", "stamps_difference": "s"},
    }
    assert all(limit.above_zero for limits in declared.values() for limit in limits.values())


def test_samples_of_frames_that_count_b_plan_092(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[3] / "sequences" / "bias_ramp_short.yaml").read_text()
    path = tmp_path / "bias_ramp_short.yaml"
    path.write_text(text.replace("pulse_timing: true", "samples: true"))
    with pytest.raises(InputErrors) as caught:
        compile_sequence(path)
    assert {one.code for one in caught.value.errors} == {"B-PLAN-092"}


@pytest.mark.parametrize(
    ("shipped", "change", "says"),
    [
        ("gnc_imu_calibration", ("{up: +x, middle: -90 deg,", "{up: +x, middle: -80 deg,"), None),
        (
            "gnc_imu_calibration",
            ('mounting: x, outer: 0 deg, middle: "{middle}"', "mounting: x, outer: 0 deg, middle: 45 deg"),
            "middle axis at 45 deg",
        ),
        (
            "gnc_imu_calibration",
            ("mounting: x, outer", "mounting: y, outer"),
            "mounting y, but the operator was told x",
        ),
        (
            "gnc_imu_calibration",
            ("turn: -1080 deg, inner: 1080 deg", "turn: -1080 deg, inner: 90 deg"),
            "inner axis at 90 deg",
        ),
        ("gnc_bias", ("up: -z, inner: 180 deg", "up: -z, inner: 0 deg"), "sent to 180 deg"),
    ],
)
def test_poses(tmp_path: Path, shipped: str, change: tuple[str, str], says: str | None) -> None:
    found = shipped_mistakes(tmp_path, shipped, change)
    assert [code for code, _ in found] == ([] if says is None else ["B-PLAN-076"] * len(found))
    assert says is None or (found and says in found[0][1])


def shipped_mistakes(folder: Path, shipped: str, change: tuple[str, str]) -> list[tuple[str, str]]:
    text = (Path(__file__).resolve().parents[3] / "sequences" / f"{shipped}.yaml").read_text()
    assert change[0] in text
    path = folder / f"{shipped}.yaml"
    path.write_text(text.replace(*change))
    return [(one.code, one.message) for one in check_plan(compile_sequence(path))]


def test_what_a_test_takes_must_fit_in_its_settle_time(tmp_path: Path) -> None:
    longer = ("ticks: 20}}", "ticks: 20}, takes: 0.6 s}")
    assert mistakes(tmp_path, longer) == []
    (found,) = mistakes(tmp_path, longer, ("  - settle: 2 s\n  - record", "  - settle: 1 s\n  - record"))
    assert found[0] == "B-PLAN-060"
    assert "1.2 s" in found[1]
