"""The static check against brute-force models of bench and table; mistakes that come together, without an echo."""

from dataclasses import replace
from pathlib import Path
from runpy import run_path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_sample import FLAT, SEQUENCE, changed, make_bench, mistakes

from bench.model.clock import NS, VIRTUAL_START_UTC_NS
from bench.model.errors import InputError
from bench.model.ports import Effect
from bench.plan import KINDS, PlannedSend, PlannedVerify, Step, check_plan, compile_sequence, driver_actions, summarise
from bench.run.steps import dispatch

CALLS = {
    "standby": "calibrator.standby",
    "open": "switch.open_all",
    "route": "{switch.route: {channel: 1, polarity: -}}",
    "set": "{calibrator.output: {current: 1 mA}}",
    "on": "calibrator.operate",
}
ORDERS = st.lists(st.sampled_from(sorted(CALLS)), min_size=1, max_size=8)


def hazards(order: list[str]) -> set[tuple[int, str]]:
    """What happens on a bench whose relays and output do just as they are told: (place, code)."""
    output, closed, found = False, False, set()
    for place, name in enumerate(order):
        if name in ("open", "route") and output:
            found.add((place, "B-PLAN-070"))
        if name == "on" and not closed:
            found.add((place, "B-PLAN-072"))
        output = {"on": True, "standby": False}.get(name, output)
        closed = {"route": True, "open": False}.get(name, closed)
    return found


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ORDERS)
def test_exactly_the_unsafe_steps_are_found(tmp_path: Path, order: list[str]) -> None:
    head = FLAT[: FLAT.index("timeline:") + len("timeline:\n")]
    lines = [f'  - {{at: "00:00:{5 * place:02}", call: {CALLS[name]}}}\n' for place, name in enumerate(order)]
    first = head.count("\n") + 1
    errors = mistakes(make_bench(tmp_path, head + "".join(lines)))
    found = {(int(e.where.split(":")[1]) - first, e.code) for e in errors if e.code.startswith("B-PLAN-07")}
    assert found == hazards(order)


def test_the_end_of_the_run_decides_whether_a_standard_is_due(tmp_path: Path) -> None:
    path = make_bench(tmp_path)
    station = tmp_path / "stations" / "af_bench_sim.yaml"
    station.write_text(station.read_text().replace("age: 2160 h, ", ""))
    plan = compile_sequence(path)
    day_ns = 86_400 * NS
    due_2000_11_01 = VIRTUAL_START_UTC_NS + 305 * day_ns
    last_second = due_2000_11_01 + day_ns - NS - round(plan.duration_s + plan.prepare_s) * NS
    assert check_plan(plan, start_utc_ns=last_second) == []
    codes = {error.code for error in check_plan(plan, start_utc_ns=last_second + 2 * NS)}
    assert codes == {"B-PLAN-063"}
    (error,) = check_plan(plan, start_utc_ns=0)
    told = "the clock says 1970-01-01; all 3 standards were calibrated later, from 1999-11-01 on"
    assert (error.code, error.message, error.next_step) == ("B-PLAN-063", told, "set the clock of this machine")


def test_the_end_of_the_run_decides_whether_a_specification_holds(tmp_path: Path) -> None:
    """Calibrated on 1 November 1999 and good for 90 days: until midnight before 30 January 2000."""
    plan = compile_sequence(make_bench(tmp_path))
    length_ns = round(plan.duration_s + plan.prepare_s + plan.finally_s) * NS
    last = VIRTUAL_START_UTC_NS + 29 * 86_400 * NS - length_ns
    assert check_plan(plan, start_utc_ns=last - NS) == []
    (error,) = check_plan(plan, start_utc_ns=last + 2 * NS)
    assert error.code == "B-PLAN-130"
    assert "calibrator: a specification holds 90 days after the calibration of 1999-11-01" in error.message


@pytest.mark.parametrize("text", ["OUT 1.0E-03 A, 0 HZ", "OPER"])
def test_raw_text_to_a_source_needs_a_closed_route_and_a_call_to_switch_it_off(tmp_path: Path, text: str) -> None:
    flat = changed("call: switch.open_all", "call: {switch.route: {channel: 1, polarity: +}}", FLAT)
    flat = changed("record: 10 s", f'send: {{calibrator: "{text}"}}', flat)
    assert [error.code for error in mistakes(make_bench(tmp_path, flat))] == ["B-PLAN-070"]
    safe = flat.replace('at: "00:00:20", call: switch.open_all', 'at: "00:00:20", call: calibrator.standby')
    assert mistakes(make_bench(tmp_path, safe)) == []


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [
        ("rlg_lock_in", {"clocks": "20 MHz,30 MHz"}, "clock 3e+07 Hz is none of its settings; the nearest is 2e+07"),
        ("fog_north", {"time_constant": "2 s"}, "time_constant 2 s is none of its settings; the nearest is 3 s"),
    ],
)  # fmt: skip
def test_a_setting_between_two_that_there_are_is_refused(name: str, settings: dict[str, str], said: str) -> None:
    findings = [str(one) for one in check_plan(compile_sequence(name, None, settings))]
    assert findings
    assert all("B-PLAN-055" in one and said in one for one in findings), findings
    assert check_plan(compile_sequence("rlg_lock_in", None, {"clocks": "10 MHz,100 MHz", "paths": "15 cm"})) == []


HEAD = """\
sequence: table
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
timeline:
"""
TABLE = """\
instruments:
  turntable:
    driver: acutrol_3000
    resource: GPIB0::29::INSTR
    safe_order: 99
    standard: {model: ACUTROL3000, serial: SIM3000, certificate: T-1, calibrated: "1999-06-01", due: "2000-06-01"}
"""
MOVES = {
    "limits 1": "call: {turntable.set_limits: {axis: 1, rate: 100 deg/s, acceleration: 90 deg/s2}}",
    "limits 2": "call: {turntable.set_limits: {axis: 2, rate: 30 deg/s, acceleration: 90 deg/s2}}",
    "limits 3": "call: {turntable.set_limits: {axis: 3, rate: 100 deg/s, acceleration: 90 deg/s2}}",
    "close": "call: turntable.close_interlock",
    "open": "call: turntable.open_interlock",
    "move 1": "call: {turntable.move: {axis: 1, angle: 90 deg, rate: 50 deg/s}}",
    "turn 2": "call: {turntable.turn: {axis: 2, angle: -1080 deg, rate: 30 deg/s, acceleration: 90 deg/s2}}",
    "spin 2": "call: {turntable.spin: {axis: 2, rate: -31 deg/s}}",
    "stop 2": "call: {turntable.stop: {axis: 2}}",
    "prompt": "prompt: Look at it.",
    "raw": "send: {turntable: ':int:close 1'}",
}
READY = ["limits 1", "limits 2", "limits 3", "close"]
MOVE_ORDERS = st.tuples(st.sampled_from([[], READY]), st.lists(st.sampled_from(sorted(MOVES)), min_size=1, max_size=8))


def sequence(order: list[str]) -> str:
    return HEAD + "".join(f"  - {{at: {20 * place} s, {MOVES[name]}}}\n" for place, name in enumerate(order))


def found_motion(folder: Path, order: list[str]) -> set[tuple[int, str]]:
    """(place, code) of every mistake of motion."""
    errors = mistakes(make_bench(folder, sequence(order), ("instruments:\n", TABLE)))
    assert {error.code for error in errors} <= {"B-PLAN-074", "B-PLAN-087", "B-PLAN-088", "B-PLAN-089"}, errors
    return {(_line(error) - HEAD.count("\n") - 1, error.code) for error in errors}


def _line(error: InputError) -> int:
    return int(error.where.split(":")[1])


def motion_hazards(order: list[str]) -> set[tuple[int, str]]:
    """What happens at a table that does just as it is told: (place, code)."""
    limits: set[str] = set()
    live, wrong = False, set()
    for place, name in enumerate(order):
        what, _, axis = name.partition(" ")
        if what == "prompt" and live:
            wrong.add((place, "B-PLAN-087"))
        if what == "limits" and live:
            wrong.add((place, "B-PLAN-088"))
        if what == "close" and limits != {"1", "2", "3"}:
            wrong.add((place, "B-PLAN-088"))
        if what in ("move", "turn", "spin") and not (live and axis in limits):
            wrong.add((place, "B-PLAN-088"))
        if what == "spin" and axis in limits:
            wrong.add((place, "B-PLAN-089"))
        if what == "raw":
            wrong.add((place, "B-PLAN-074"))
        limits |= {axis} if what == "limits" else set()
        live = {"close": True, "raw": True, "open": False}.get(what, live)
    return wrong


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(MOVE_ORDERS)
def test_exactly_the_unsafe_moves_are_found(tmp_path: Path, orders: tuple[list[str], list[str]]) -> None:
    order = [*orders[0], *orders[1]]
    assert found_motion(tmp_path, order) == motion_hazards(order)


def test_the_summary_names_the_hazard_and_what_is_left(tmp_path: Path) -> None:
    moved = compile_sequence(make_bench(tmp_path, sequence([*READY, "move 1"]), ("instruments:\n", TABLE)))
    assert summarise(moved).hazards == (
        "turntable: moves at up to 50 deg/s, interlock closed 1 times; nobody may stand at it",
        "turntable: on until it is made safe at the end",
    )
    still = compile_sequence(make_bench(tmp_path, sequence(["open"]), ("instruments:\n", TABLE)))
    assert summarise(still).hazards == ()


@pytest.mark.parametrize(
    ("text", "moves"),
    [
        (":int? 1", False),
        (":READ:POS? 3;*STB?", False),
        (":int? 1;:int:close 1", True),
        (":dem:rate 1,?5", True),
        ("?", True),
    ],
)
def test_only_questions_may_be_sent_as_text_to_a_table(tmp_path: Path, text: str, moves: bool) -> None:
    order = HEAD + f"  - {{at: 0 s, send: {{turntable: '{text}'}}}}\n"
    errors = mistakes(make_bench(tmp_path, order, ("instruments:\n", TABLE)))
    assert [error.code for error in errors] == (["B-PLAN-074"] if moves else [])


def codes(path: Path, overrides: dict[str, str] | None = None) -> list[str]:
    return sorted(error.code for error in mistakes(path, overrides))


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("settle: 20 s", "settle: 20 V", "B-YAML-012"),
        ("title: a sample", "titel: a sample", "B-YAML-010"),
        ("  temperature_sensor_uncertainty: 0.1 degC\n", "", "B-PLAN-026"),
    ],
)
def test_it_hides_no_misspelt_action_and_no_misspelt_driver(tmp_path: Path, old: str, new: str, code: str) -> None:
    text = changed("- switch.open_all", "- switch.open_al", changed(old, new))
    station = ("driver: hp_3458a", "driver: hp_3459a")
    assert codes(make_bench(tmp_path, text, station)) == sorted([code, "B-PLAN-050", "B-PLAN-011"])


def test_names_in_every_part_of_a_file_that_cannot_be_compiled(tmp_path: Path) -> None:
    text = changed("settle: 20 s", "settle: 20 V")
    for old in ("calibrator.standby", "switch.open_all", "calibrator.output", "calibrator.operating"):
        text = text.replace(old, old + "x")
    found = [error for error in mistakes(make_bench(tmp_path, text)) if error.code == "B-PLAN-050"]
    lines = [text.split("\n")[int(error.where.split(":")[1]) - 1] for error in found]
    assert len(found) == len([line for line in text.split("\n") if "x:" in line or line.endswith("x")]) == 7
    assert all(word in "".join(lines) for word in ("standbyx", "open_allx", "outputx", "operatingx"))
    text = changed("record: 10 s", "record: 10 V", changed("call: switch.open_all", "call: swich.open_all", FLAT))
    assert codes(make_bench(tmp_path, text)) == ["B-PLAN-040", "B-YAML-012"]


@pytest.mark.parametrize(
    ("old", "new", "overrides", "code", "origin"),
    [
        ("levels: [1 mA]", "levels: [1 mA, 250 mA]", {}, "B-PLAN-055", "from levels[1], line {}"),
        ("[20 degC]", "[20 degC, 61 degC]", {}, "B-PLAN-055", "from parameter temperatures[1], line {}"),
        ('in: "{temperatures}"', "in: [61 degC]", {}, "B-PLAN-055", "from the list, line {}"),
        ("{current: 0 A,", "{current: -1 mA,", {}, "B-PLAN-055", "from argument current, line {}"),
        ("dwell: 10 s", "dwell: 10.005 s", {}, "B-PLAN-042", "from parameter dwell, line {}"),
        ("dwell: 10 s", "dwell: 20 s", {"dwell": "10.005 s"}, "B-PLAN-042", "from --set dwell"),
        ("dwell: 10 s", "dwell: 20 s", {"dwell": "-1 s"}, "B-PLAN-031", "from --set dwell"),
        ("[20 degC]", "[21 degC]", {"temperatures": "20 degC, 99 degC"}, "B-PLAN-055", "from --set temperatures[1]"),
        ("settle: 20 s", 'settle: "{dwell}"', {"dwell": "1 s"}, "B-PLAN-060", "from --set dwell"),
        ("slot: 570 s", 'slot: "{dwell}"', {}, "B-PLAN-043", "from parameter dwell, line"),
    ],
)
def test_a_value_says_where_it_was_written(
    tmp_path: Path, old: str, new: str, overrides: dict[str, str], code: str, origin: str
) -> None:
    text = changed(old, new)
    line = text[: text.index(new)].count("\n") + 1
    found = {error.code: error.message for error in mistakes(make_bench(tmp_path, text), overrides)}
    assert f"({origin.format(line)}" in found[code]


@pytest.mark.parametrize(
    ("old", "what"),
    [
        ("  temperature_sensor_uncertainty: 0.1 degC\n", "temperature_sensor_uncertainty"),
        ("white_noise_per_rtHz: 2 nA, ", "white_noise_per_rtHz"),
        (", bias_walk_per_rth: 0.3 nA", "bias_walk_per_rth"),
    ],
)
def test_declared_noise_has_no_default_b_plan_026(tmp_path: Path, old: str, what: str) -> None:
    found = mistakes(make_bench(tmp_path, changed(old, "")))
    assert [error.code for error in found] == ["B-PLAN-026"]
    assert what in found[0].message
    assert mistakes(make_bench(tmp_path, changed("analysis: scale_factor\n", "", changed(old, "")))) == []


def test_the_analysis_needs_the_data_sheet_of_the_unit_b_plan_026(tmp_path: Path) -> None:
    flat = changed("frame:", "analysis: scale_factor\nframe:", FLAT)
    assert codes(make_bench(tmp_path, flat)) == ["B-PLAN-026"]


@pytest.mark.parametrize("step", ["settle: 1 s", "record: 10 s", "prompt: open the door"])
def test_only_calls_and_a_soak_may_end_a_campaign_b_plan_037(tmp_path: Path, step: str) -> None:
    assert "B-PLAN-037" in codes(make_bench(tmp_path, changed("finally:\n", f"finally:\n  - {step}\n")))
    soak = "soak: {temperature: 23 degC, ramp: 0.5 degC/min, slot: 600 s, stable: {within: 2 degC, for: 1 min}}"
    assert codes(make_bench(tmp_path, changed("finally:\n", f"finally:\n  - {soak}\n"))) == []
    assert SEQUENCE.count("finally:\n") == 1


def test_a_kind_of_step_says_what_it_may_do_to_the_bench_and_whether_it_is_done_again() -> None:
    questions = ("kind", "on_the_bus", "proof", "effects", "again", "leaves", "written")
    for at, question in enumerate(questions):
        with pytest.raises(TypeError, match=f"the kind of step Ninth has no '{question}'"):
            type("Ninth", (Step,), {answered: vars(PlannedVerify)[answered] for answered in questions[:at]})


NINTH = [(Effect.STIMULUS_ON, "calibrator"), (Effect.ROUTE, "switch"), (Effect.MOTION_ON, "chamber")]


@pytest.mark.parametrize(("effect", "role"), NINTH)
def test_what_another_kind_of_step_may_do_is_refused_and_nobody_does_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, effect: Effect, role: str
) -> None:
    monkeypatch.setitem(KINDS, "ninth", PlannedVerify)  # taken away again
    answers = {name: vars(PlannedVerify)[name] for name in ("on_the_bus", "proof", "again", "leaves", "written")}
    ninth = type("Ninth", (Step,), {**answers, "kind": "ninth", "effects": lambda step, actions: frozenset({effect})})
    plan = compile_sequence(make_bench(tmp_path))
    step = ninth(0, "prepare", 0.0, 0.0, role, "", {}, plan.steps[0].where)
    (found,) = [e for e in check_plan(replace(plan, steps=(step, *plan.steps[1:]))) if e.code == "B-PLAN-074"]
    assert found.message.startswith(f"a ninth step of {role} may ")
    with pytest.raises(TypeError, match=r"nobody does the kinds of step .*Ninth"):
        run_path(dispatch.__file__)


@pytest.mark.parametrize(("text", "may"), [("OUT 1 A", True), ("OUT?", False), ("OUT?;OPER", True), ("*RST", True)])
def test_raw_text_may_do_all_that_its_instrument_can(text: str, may: bool) -> None:
    send = PlannedSend(0, "campaign", 0.0, 0.0, "calibrator", "send", {}, "here", text)
    actions = driver_actions("fluke_5720a")
    assert send.effects(actions) == ({Effect.STIMULUS_ON} if may else frozenset())
    assert send.again(actions) is None
