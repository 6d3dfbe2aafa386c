"""Records and soaks: what they say of themselves against what the bench was told, and their form in a plan file."""

import json
from pathlib import Path

import pytest
from plan_sample import FLAT, ROOT, changed, make_bench, mistakes, planned

from bench.model.errors import SessionDamaged
from bench.plan import PlannedSoak, SetPoint, check_plan, compile_sequence, plan_json, steps_of, steps_sha256
from bench.record import SessionReader

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
    # nothing to follow
    ("windows: 3", "windows: 3, follows: true", "B-PLAN-067", "hold_start"),
    (CALL, CALL + "  - settle: 10 s\n", "B-PLAN-067", "branch: up"),
    (CALL, CALL + "  - prompt: look\n", "B-PLAN-067", "branch: up"),
    (CALL, CALL + SOAK_BEFORE, "B-PLAN-067", "branch: up"),
    # taken again
    (SECOND, SECOND + ", retry: 1", "B-PLAN-068", "branch: up"),
    ("windows: 3", "windows: 3, retry: 1", "B-PLAN-068", "hold_start"),
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
        (RANGE + RECORD, "            range: 22 mA\n" + RECORD, "calibrator is on"),
        (RECORD, RECORD.replace("closed", "open"), "its route is open, but switch has channel 1 closed"),
        (OPEN, OPEN.replace("0 A", "1 mA"), "current 0.001 A, but an open input has 0"),
        ("            polarity: 0\n", "            polarity: +\n", "polarity 1, but an open input has 0"),
        ("            route: open\n", "", "its route is closed, but no route is"),
        (SOAK, SOAK.replace('"{temperature}"', "24 degC"), "temperature 23 degC, but the chamber is at 24"),
        (OPERATE, OPERATE.split("\n")[1], "output of calibrator is off"),
    ],
)  # fmt: skip
def test_conditions_that_the_bench_does_not_meet_b_plan_076(tmp_path: Path, old: str, new: str, says: str) -> None:
    messages = found(tmp_path, changed(old, new, SHORT))
    assert any(says in message for message in messages), messages


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


def test_the_act_of_a_person_or_readings_may_stand_between_records(tmp_path: Path) -> None:
    """Not on this bench, where nobody can do it; that is then the only mistake."""
    source = make_bench(tmp_path, RAMP.replace(CALL, CALL + "  - prompt: {text: Go., sets: {speed: 1 m/s}}\n"))
    assert [error.code for error in mistakes(source)] == ["B-PLAN-094"]
    text = changed(CALL, CALL + "  - logger.scan\n  - verify: calibrator.operating\n", RAMP)
    assert mistakes(make_bench(tmp_path, text)) == []


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
    assert "Next: " in str(found[code])


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


def test_the_band_of_a_soak_ends_where_the_chamber_is_sent_on(tmp_path: Path) -> None:
    text = changed("branch: hold_start}", "branch: hold_start, temperature: 20 degC}", RAMP)
    text = changed("branch: up}", "branch: up, temperature: 30 degC}", text)
    plan = compile_sequence(make_bench(tmp_path, text))
    bands = [step.conditions.get("settle_band_degC") for step in plan.phase("campaign") if step.kind == "record"]
    assert bands == [1.0] * 3 + [None] * 4


SLOT = "slot: 570 s"
DONE = f"{SLOT}, done: {{residual: 0.1 degC, least: 400 s}}"


def soaks(path: Path) -> list[PlannedSoak]:
    return [step for step in compile_sequence(path).steps if isinstance(step, PlannedSoak)]


def test_a_plan_says_how_near_and_not_before_when(tmp_path: Path) -> None:
    path = make_bench(tmp_path, changed(SLOT, DONE))
    assert mistakes(path) == []
    (soak,) = soaks(path)
    assert (soak.residual_degC, soak.least_s, soak.duration_s) == (0.1, 400.0, 570.0)
    steps = compile_sequence(path).steps
    assert steps_of(plan_json(steps)) == steps
    (plain,) = soaks(make_bench(tmp_path))
    assert {"residual", "least"}.isdisjoint(plain.told()), "a plan without it keeps its hash"


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        (SLOT, DONE.replace("400 s", "571 s"), "least"),
        (SLOT, DONE.replace("0.1 degC", "0 degC"), "residual"),
        ("slot: 570 s, stable: {within: 1 degC, for: 5 min}",
         f"{DONE}, stable: {{within: 1 degC, for: 5 min, sensor: air}}", "the soak is judged by the air"),
        ("finally:\n", "finally:\n  - soak: {temperature: 23 degC, ramp: 0.5 degC/min, slot: 600 s, "
         "stable: {within: 1 degC, for: 5 min}, done: {residual: 0.1 degC, least: 400 s}}\n", "never shortened"),
    ],
)  # fmt: skip
def test_what_cannot_end_a_soak_is_one_mistake(tmp_path: Path, old: str, new: str, place: str) -> None:
    found = mistakes(make_bench(tmp_path, changed(old, new)))
    assert [error.code for error in found] == ["B-PLAN-156"]
    assert place in f"{found[0]}"


def test_a_soak_that_is_made_up_for_is_written_as_it_was(tmp_path: Path) -> None:
    plan = compile_sequence(make_bench(tmp_path, changed(SLOT, DONE)))
    (soak,) = (step for step in plan.steps if isinstance(step, PlannedSoak))
    assert soak.written({})["soak"]["done"] == {"residual": "0.1 degC", "least": "400.0 s"}


GOLDEN = Path(__file__).resolve().parents[2] / "golden"
SESSIONS = sorted(path.parent for path in GOLDEN.glob("*/*/20000101T*/session.0001.mcap"))  # runs, not logs


@pytest.mark.parametrize("folder", SESSIONS, ids=lambda folder: folder.name)
def test_the_plan_of_an_older_session_is_read_and_written_byte_for_byte(folder: Path) -> None:
    reader = SessionReader(folder)
    steps = steps_of(reader.texts["plan.json"])
    assert plan_json(steps) == reader.texts["plan.json"]
    assert steps_sha256(steps) == reader.manifest["plan_sha256"]


def test_set_points_are_those_of_the_chamber() -> None:
    assert planned("soak", role="oven", temperature=5.0, ramp=1.0).set_point == SetPoint(5.0, 1.0)
    assert planned("call", role="chamber", temperature=7.0, ramp=0.5).set_point == SetPoint(7.0, 0.5)
    assert planned("call", role="supply", temperature=7.0).set_point is None
    assert planned("call", role="chamber").set_point is None
    assert planned("settle").set_point is None


@pytest.mark.parametrize("change", [{"kind": "dance"}, {"arguments": {"tempo": 1}}, {"arguments": None}, {"more": 1}])
def test_what_is_no_plan_is_one_clear_error(change: dict[str, object]) -> None:
    text = json.dumps([{**planned("settle").as_json(), **change}])
    for wrong in (text, "[1]", "7", "{"):
        with pytest.raises(SessionDamaged, match="B-RES-004") as caught:
            steps_of(wrong, "sessions/a")
        assert caught.value.where == "sessions/a"
