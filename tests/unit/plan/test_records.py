"""What a record says of itself against what the bench was told, and records without a gap: each way to be wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_sample import FLAT, ROOT, changed, make_bench, mistakes

from bench.plan import check_plan, compile_sequence

SHORT = (ROOT / "sequences" / "scale_factor_short.yaml").read_text()
POINT = (
    '      - switch.route: {channel: "{channel}", polarity: "{polarity}"}\n      - calibrator.output: {current: "{cur'
)
RANGE = '            range: "{calibrator.range}"\n'
OPEN = "            current: 0 A\n            polarity: 0"
SOAK = '          temperature: "{temperature}"'
OPERATE = '      - calibrator.operate\n      - settle: "{settle}"'
RECORD = '            route: closed\n            level_index: "{level_index}"'
RAMP = """\
sequence: sample
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
duration: 70 s
records: 7
uut:
  model: NGU
  serial: SIM-1
  af_clock: 256 kHz
  master_clock: 10 MHz
  function_generator: 10 MHz
  kinds:
    gyro: {k0: 1.25 uC, full_scale: 299 mA, sensor_full_scale: 83 deg/s, stability_limit: 100 ppm,
      bias_stability_limit: 24 nA}
unit_commands:
  start_stream: {code: 2, payload: "64"}
channels:
  - {numbers: 1-2, kind: gyro}
prepare:
  - unit: {port_b: start_stream}
  - settle: 5 s
  - soak: {temperature: 20 degC, ramp: 0.5 degC/min, slot: 570 s, stable: {within: 1 degC, for: 5 min}}
steps:
  - record: {seconds: 10 s, windows: 3, pulse_timing: true, conditions: {route: open, branch: hold_start}}
  - chamber.set_temperature: {temperature: 30 degC, ramp: 0.1 degC/min}
  - chamber.run
  - record: {seconds: 10 s, windows: 4, follows: true, pulse_timing: true, conditions: {route: open, branch: up}}
"""
CALL = "  - chamber.run\n"
SOAK_BEFORE = "  - soak: {temperature: 30 degC, ramp: 1 degC/min, slot: 10 s, stable: {within: 1 degC, for: 5 s}}\n"
SECOND = "windows: 4, follows: true"
ANALYSIS = "reference_temperature: 20 degC\nanalysis: bias_ramp\n"
CASES = [
    # a mistake in each new key
    ("windows: 3", "windows: 0", "B-YAML-013", "windows: 0"),
    ("windows: 3", "windows: 10001", "B-YAML-013", "windows: 10001"),
    ("windows: 3", "windows: 2.5", "B-YAML-013", "windows: 2.5"),
    ("windows: 3", 'windows: "3"', "B-YAML-013", 'windows: "3"'),
    ("windows: 3", "window: 3", "B-YAML-010", "window: 3"),
    ("follows: true", "follows: 1", "B-YAML-013", "follows: 1"),
    ("windows: 3, pulse_timing: true", "windows: 3, pulse_timing: 10 s", "B-YAML-013", "pulse_timing: 10 s"),
    ("bias_stability_limit: 24 nA", "bias_stability_limit: 24 nV", "B-YAML-012", "24 nV"),
    ("bias_stability_limit: 24 nA", "bias_stability_limit: -1 nA", "B-YAML-012", "-1 nA"),
    # nothing to follow
    ("windows: 3", "windows: 3, follows: true", "B-PLAN-067", "hold_start"),
    (CALL, CALL + "  - settle: 10 s\n", "B-PLAN-067", "branch: up"),
    (CALL, CALL + "  - prompt: look\n", "B-PLAN-067", "branch: up"),
    (CALL, CALL + SOAK_BEFORE, "B-PLAN-067", "branch: up"),
    # taken again
    (SECOND, SECOND + ", retry: 1", "B-PLAN-068", "branch: up"),
    ("windows: 3", "windows: 3, retry: 1", "B-PLAN-068", "hold_start"),
    ("windows: 3", "windows: 1, retry: 1", "B-PLAN-068", "hold_start"),
    (SECOND, "follows: true, retry: 2", "B-PLAN-068", "branch: up"),
    # no time for pulses
    ("port_a: ngu_a,", "port_a: imu,", "B-PLAN-069", "hold_start"),
    ("seconds: 10 s, windows: 3", "seconds: 1001 s, windows: 3", "B-PLAN-069", "hold_start"),
    # calls that do not belong into a window
    (CALL, CALL + "  - calibrator.standby\n", "B-PLAN-061", "branch: up"),
    (CALL, CALL + "  - function_generator.output_off\n", "B-PLAN-061", "branch: up"),
    (CALL, CALL + "  - unit: {port_b: start_stream}\n", "B-PLAN-061", "branch: up"),
    (CALL, CALL + '  - send: {function_generator: "FREQ 1"}\n', "B-PLAN-061", "branch: up"),
    (SECOND, "windows: 4", "B-PLAN-061", "branch: up"),
    ("seconds: 10 s, windows: 4", "seconds: 4 s, windows: 4", "B-PLAN-060", "branch: up"),
    # what the analysis needs
    ("records: 7\n", "records: 7\n" + ANALYSIS, "B-PLAN-026", "uut:"),
]  # fmt: skip


def found(tmp_path: Path, text: str) -> list[str]:
    """Messages of B-PLAN-076; nothing else may be found."""
    errors = mistakes(make_bench(tmp_path, text.replace("sequence: scale_factor_short", "sequence: sample")))
    assert {error.code for error in errors} <= {"B-PLAN-076"}, errors
    return [error.message for error in errors]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (POINT, POINT.replace('"{channel}"', "1"), "channel 2, but the route has 1"),
        (POINT, POINT.replace('"{polarity}"', "+"), "polarity -1, but the route has 1"),
        ('output: {current: "{current}"', "output: {current: 1 mA", "current 0 A, but calibrator was set to 0.001 A"),
        (RANGE + RECORD, "            range: 22 mA\n" + RECORD, "calibrator is on"),
        (RECORD, RECORD.replace("closed", "open"), "its route is open, but switch has channel 1 closed"),
        (OPEN, OPEN.replace("0 A", "1 mA"), "current 0.001 A, but an open input has 0"),
        ("            polarity: 0\n", "            polarity: +\n", "polarity 1, but an open input has 0"),
        ("            route: open\n", "            route: closed\n", "its route is closed, but no route is"),
        ("            route: open\n", "", "its route is closed, but no route is"),
        (SOAK, SOAK.replace('"{temperature}"', "24 degC"), "temperature 23 degC, but the chamber is at 24"),
        (OPERATE, OPERATE.split("\n")[1], "output of calibrator is off"),
    ],
)  # fmt: skip
def test_conditions_that_the_bench_does_not_meet_b_plan_076(tmp_path: Path, old: str, new: str, says: str) -> None:
    messages = found(tmp_path, changed(old, new, SHORT))
    assert any(says in message for message in messages), messages


def test_the_shipped_one_is_true(tmp_path: Path) -> None:
    assert found(tmp_path, SHORT) == []


def test_a_locked_range_is_followed(tmp_path: Path) -> None:
    zero = 'point: {current: 0 A, polarity: -, repeat: "{repeat}"}'
    locked = "      - calibrator.output: {current: 0 A, range: locked}\n      - calibrator.operate\n"
    text = changed(
        '      - calibrator.operate\n      - settle: "{settle}"', locked + '      - settle: "{settle}"', SHORT
    )
    text = changed(zero, 'point: {current: 0 A, polarity: +, repeat: "{repeat}"}', text)
    messages = found(tmp_path, text)
    assert all("range" not in message for message in messages)  # {calibrator.range} follows the lock
    assert any("current 3e-05 A, but calibrator was set to 0 A" in message for message in messages)


def test_a_range_locked_before_any_is_known(tmp_path: Path) -> None:
    wiring = "range: lowest_that_holds}\n      - calibrator.operate\n      - settle: 10 s"
    text = changed(wiring, wiring.replace("lowest_that_holds", "locked"), SHORT)
    errors = mistakes(make_bench(tmp_path, text))
    assert [error.code for error in errors] == ["B-PLAN-031"]


def test_what_follows_raw_text_is_not_believed_b_plan_076(tmp_path: Path) -> None:
    flat = changed("call: switch.open_all", "call: {switch.route: {channel: 1, polarity: +}}", FLAT)
    flat = changed("record: 10 s", "record: {seconds: 10 s, conditions: {current: 1 mA}}", flat)
    flat = changed('  - {at: "00:00:10"', '  - {at: 2 s, send: {calibrator: "OUT 1E-3 A"}}\n  - {at: "00:00:10"', flat)
    flat = flat.replace('at: "00:00:20", call: switch.open_all', 'at: "00:00:20", call: calibrator.standby')
    errors = mistakes(make_bench(tmp_path, flat))
    assert [error.code for error in errors] == ["B-PLAN-076"]
    assert "nobody knows the current of calibrator" in errors[0].message


def test_a_record_carries_the_band_of_its_soak() -> None:
    plan = compile_sequence("scale_factor_short", overrides={"within": "0.4 degC"})
    bands = {
        phase: {s.conditions.get("settle_band_degC") for s in plan.phase(phase) if s.kind == "record"}
        for phase in ("prepare", "campaign")
    }
    assert bands == {"prepare": {None}, "campaign": {0.4}}


def test_the_act_of_a_person_may_stand_between_records(tmp_path: Path) -> None:
    """Not on this bench, where nobody can do it; that is then the only mistake."""
    source = make_bench(tmp_path, RAMP.replace(CALL, CALL + "  - prompt: {text: Go., sets: {speed: 1 m/s}}\n"))
    assert [error.code for error in mistakes(source)] == ["B-PLAN-094"]


def imu(folder: Path) -> None:
    """A frame with a counter and a count, but without N and P pulses."""
    text = (folder / "frames" / "ngu_a.yaml").read_text().replace("frame: ngu_a", "frame: imu")
    (folder / "frames" / "imu.yaml").write_text(text.replace("npp", "left").replace("ppp", "right"))


@pytest.mark.parametrize(("old", "new", "code", "on_line"), CASES)
def test_a_mistake_has_a_place_and_a_next_step(tmp_path: Path, old: str, new: str, code: str, on_line: str) -> None:
    text = changed(old, new, RAMP)
    path = make_bench(tmp_path, text)
    imu(tmp_path)
    found = {error.code: error for error in reversed(mistakes(path))}
    assert code in found, [str(error) for error in found.values()]
    line = int(found[code].where.split(":")[-2])
    assert on_line in text.split("\n")[line - 1], found[code]
    assert found[code].next_step or code.startswith("B-YAML")


def test_windows_unroll_into_records_that_follow_each_other(tmp_path: Path) -> None:
    plan = compile_sequence(make_bench(tmp_path, RAMP))
    assert check_plan(plan) == []
    records = [step for step in plan.phase("campaign") if step.kind == "record"]
    assert [step.at_s for step in records] == [10.0 * k for k in range(7)]
    assert [step.follows for step in records] == [False] + [True] * 6
    assert {step.pulse_timing for step in records} == {True}
    assert [dict(step.conditions) for step in records] == [
        {"route": "open", "branch": branch, "window_index": k, "purpose": "measurement"}
        for branch, count in (("hold_start", 3), ("up", 4))
        for k in range(count)
    ]
    assert [c["bias_stability_limit_A"] for c in plan.campaign["channels"]] == [24e-9] * 2
    assert [c["levels_A"] for c in plan.campaign["channels"]] == [[], []]


def test_readings_may_stand_between_two_windows(tmp_path: Path) -> None:
    text = changed(CALL, CALL + "  - logger.scan\n  - verify: calibrator.operating\n", RAMP)
    assert mistakes(make_bench(tmp_path, text)) == []


def test_the_band_of_a_soak_ends_where_the_chamber_is_sent_on(tmp_path: Path) -> None:
    text = changed("branch: hold_start}", "branch: hold_start, temperature: 20 degC}", RAMP)
    text = changed("branch: up}", "branch: up, temperature: 30 degC}", text)
    plan = compile_sequence(make_bench(tmp_path, text))
    bands = [step.conditions.get("settle_band_degC") for step in plan.phase("campaign") if step.kind == "record"]
    assert bands == [1.0] * 3 + [None] * 4


def test_plain_records_are_planned_as_before() -> None:
    """The new keys add nothing where they are not written: a plan keeps its hash."""
    records = [step for step in compile_sequence("scale_factor_short").steps if step.kind == "record"]
    assert {frozenset(step.told()) for step in records} == {
        frozenset({"seconds", "retry", "max_lost", "purpose", "retry_step"})
    }
    assert all("window_index" not in step.conditions for step in records)
