"""The static check of a table that moves, against a brute-force model of it over random orders of calls."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plan_sample import make_bench, mistakes

from bench.model.errors import InputError
from bench.plan import compile_sequence
from bench.plan.summary import summarise

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
CALLS = {
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
ORDERS = st.tuples(st.sampled_from([[], READY]), st.lists(st.sampled_from(sorted(CALLS)), min_size=1, max_size=8))


def sequence(order: list[str]) -> str:
    return HEAD + "".join(f"  - {{at: {20 * place} s, {CALLS[name]}}}\n" for place, name in enumerate(order))


def found(folder: Path, order: list[str]) -> set[tuple[int, str]]:
    """(place, code) of every mistake of motion."""
    errors = mistakes(make_bench(folder, sequence(order), ("instruments:\n", TABLE)))
    assert {error.code for error in errors} <= {"B-PLAN-074", "B-PLAN-087", "B-PLAN-088", "B-PLAN-089"}, errors
    return {(_line(error) - HEAD.count("\n") - 1, error.code) for error in errors}


def _line(error: InputError) -> int:
    return int(error.where.split(":")[1])


def hazards(order: list[str]) -> set[tuple[int, str]]:
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
@given(ORDERS)
def test_exactly_the_unsafe_steps_are_found(tmp_path: Path, orders: tuple[list[str], list[str]]) -> None:
    order = [*orders[0], *orders[1]]
    assert found(tmp_path, order) == hazards(order)


@pytest.mark.parametrize(
    ("order", "code", "text"),
    [
        ([*READY, "prompt"], "B-PLAN-087", "while the turntable may move"),
        (["limits 1", "close"], "B-PLAN-088", "before set_limits of axis 2, 3"),
        (["limits 1", "move 1"], "B-PLAN-088", "moves axis 1 before the interlock is closed"),
        (["move 1"], "B-PLAN-088", "moves axis 1 before set_limits"),
        ([*READY, "limits 1"], "B-PLAN-088", "with the interlock closed"),
        ([*READY, "spin 2"], "B-PLAN-089", "rate -31 is above 30"),
        (["raw"], "B-PLAN-074", "may move it, faster and further than its limits allow"),
    ],
)
def test_the_message_says_what_is_wrong(tmp_path: Path, order: list[str], code: str, text: str) -> None:
    (error,) = mistakes(make_bench(tmp_path, sequence(order), ("instruments:\n", TABLE)))
    assert error.code == code
    assert text in error.message


def test_the_summary_names_the_hazard_and_what_is_left(tmp_path: Path) -> None:
    moved = compile_sequence(make_bench(tmp_path, sequence([*READY, "move 1"]), ("instruments:\n", TABLE)))
    assert summarise(moved).hazards == (
        "turntable: moves at up to 50 deg/s, interlock closed 1 times; nobody may stand at it",
        "turntable: on until it is made safe at the end",
    )
    still = compile_sequence(make_bench(tmp_path, sequence(["open"]), ("instruments:\n", TABLE)))
    assert summarise(still).hazards == ()


def test_a_bare_number_or_a_fourth_axis_is_refused(tmp_path: Path) -> None:
    order = sequence([*READY, "move 1"]).replace("axis: 1, angle: 90 deg", "axis: 4, angle: 90 arcmin/s")
    codes = {error.code for error in mistakes(make_bench(tmp_path, order, ("instruments:\n", TABLE)))}
    assert codes == {"B-PLAN-052"}


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
