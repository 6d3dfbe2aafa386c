"""Exact exchanges of the turntable: limits, interlock, motion, and everything it refuses."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from known_drivers import IDENTIFY, MAKE_SAFE, after
from scripted import CLEAR, TIMEOUT, make, refused, scripted

from bench.model.clock import NS
from instruments.acutrol_axis import AxisRange

START = IDENTIFY["acutrol_3000"]
FINE = (b"*STB?\n", b"0\n")
ABSOLUTE = b"400.0, 500.0, 10000.0, -180.0, 180.0, 440.0\n"
ONE_TURN = b"360.0,360.0,0.0,deg,NR2,NR2,NR2,NR2,NR2\n"
Pairs = list[tuple[Any, Any]]


def put(command: str, value: str = "", query: str = "") -> Pairs:
    """A setting that is accepted, with its read-back."""
    back = [(f"{query}\n".encode(), f"{value}\n".encode())] if query else []
    return [*after(f"{command}\n".encode(), FINE), *back]


def interlock(axis: int, word: str) -> tuple[bytes, bytes]:
    return f":int? {axis}\n".encode(), f"{word}\n".encode()


def limits(axis: int, absolute: bytes = ABSOLUTE, scaling: bytes = ONE_TURN) -> Pairs:
    """The exchange of set_limits."""
    rate, acceleration = "300", "200"
    script: Pairs = [interlock(axis, "Open"), (f":lim:abs? {axis}\n".encode(), absolute)]
    for mode in ("pos", "rate"):
        script += put(f":lim:rate {mode},{axis},{rate}", f"{rate}.0", f":lim:rate? {mode},{axis}")
        script += put(f":lim:acc {mode},{axis},{acceleration}", f"{acceleration}.0", f":lim:acc? {mode},{axis}")
    return [*script, (f":conf:scal? {axis}\n".encode(), scaling)]


def closing() -> Pairs:
    """The exchange of close_interlock."""
    script: Pairs = []
    for axis in (1, 2, 3):
        script += [(f":lim:rate? rate,{axis}\n".encode(), b"300\n"), (f":lim:acc? rate,{axis}\n".encode(), b"200\n")]
    script += put(":int:reset")
    for axis in (1, 2, 3):
        script += put(f":mode:off {axis}", "Off", f":mode? {axis}")
        script += put(f":dem:rate {axis},0", "0.0", f":dem:rate? {axis}")
        script += [*put(f":int:close {axis}"), interlock(axis, "Closed")]
        script += put(f":mode:rate {axis}", "Rate", f":mode? {axis}")
    return script


def motion(axis: int, target: str, rate: str, acceleration: str) -> Pairs:
    """The exchange that sends an axis to a position."""
    return [
        *put(f":lim:rate pos,{axis},{rate}", rate, f":lim:rate? pos,{axis}"),
        *put(f":lim:acc pos,{axis},{acceleration}", acceleration, f":lim:acc? pos,{axis}"),
        *put(f":dem:pos {axis},{target}", target, f":dem:pos? {axis}"),
        *put(f":mode:pos {axis}", "Position", f":mode? {axis}"),
    ]


def resting(axis: int, at: str) -> Pairs:
    """An axis without a demand says where it is."""
    return [(f":read:rate? {axis}\n".encode(), b"0.0004\n"), (f":read:pos? {axis}\n".encode(), f"{at}\n".encode())]


READY: Pairs = [*START, *limits(1), *limits(2), *limits(3), *closing()]


@pytest.mark.parametrize("absolute", [ABSOLUTE, b"400.0, 500.0, 10000.0, -180.0, 180.0, 440.0, 5.0\n"])
@pytest.mark.parametrize("scaling", [ONE_TURN, b"360,360,0\n", b'360.0, 360.0, 0.0, "Degrees"\n'])
def test_limits_with_and_without_a_trip_of_the_tracking_error(absolute: bytes, scaling: bytes) -> None:
    with scripted("acutrol_3000", [*START, *limits(1, absolute, scaling)]) as table:
        table.set_limits(1, 300.0, 200.0)
        assert table.ranges[1] == AxisRange(360.0, 0.0, -180.0, 180.0)


@pytest.mark.parametrize("scaling", [b"6.2832,6.2832,0,rad\n", b"1,1,0,rev\n", b"360.0\n"])
def test_an_axis_that_does_not_count_in_degrees_is_not_used(scaling: bytes) -> None:
    asked = limits(1, scaling=scaling)[-1]
    again = [(CLEAR, None), FINE, asked]
    with scripted("acutrol_3000", [*START, *limits(1, scaling=scaling), *again, *again, (CLEAR, None)]) as table:
        with refused("B-INST-004"):
            table.set_limits(1, 300.0, 200.0)
        assert not table.limits


def make_ready(table: Any) -> None:
    for axis in (1, 2, 3):
        table.set_limits(axis, 300.0, 200.0)
    table.close_interlock()


def test_limits_then_interlock_then_motion() -> None:
    script = [*READY, interlock(3, "Closed"), *resting(3, "0.0003"), *motion(3, "90", "45", "200")]
    script += [interlock(3, "Closed"), *motion(3, "-70", "270", "150")]
    script += [interlock(3, "Closed"), *put(":dem:rate 3,-30", "-30.0", ":dem:rate? 3")]
    script += put(":mode:rate 3", "Rate", ":mode? 3")
    script += [*put(":dem:rate 3,0", "0.0", ":dem:rate? 3"), *put(":mode:rate 3", "Rate", ":mode? 3")]
    with scripted("acutrol_3000", script) as table:
        make_ready(table)
        table.move(3, 90.0, 45.0)
        table.turn(3, -160.0, 270.0, 150.0)
        table.spin(3, -30.0)
        table.stop(3)


def limited(low: str, high: str) -> Pairs:
    """A table ready to move whose first axis has stops."""
    absolute = f"400.0, 500.0, 10000.0, {low}, {high}, 440.0\n".encode()
    return [*START, *limits(1, absolute), *limits(2), *limits(3), *closing()]


@pytest.mark.parametrize(
    ("stops", "here", "angle", "target"),
    [
        (False, "-9.9999", 0.0, "0"),
        (False, "179.9998", 190.0, "-170"),  # the same place as 190, 10 deg on
        (False, "-160", 170.0, "170"),  # through -180
        (False, "0", 360.0, "0"),
        (True, "-100", 130.0, "130"),
        (True, "100", 220.0, "-140"),
        (True, "0", 370.0, "10"),
    ],
)
def test_a_move_goes_the_shorter_way_that_the_stops_leave(stops: bool, here: str, angle: float, target: str) -> None:
    start = limited("-150", "150") if stops else READY
    script = [*start, interlock(1, "Closed"), *resting(1, here), *motion(1, target, "10", "200")]
    with scripted("acutrol_3000", script) as table:
        make_ready(table)
        table.move(1, angle, 10.0)


def test_commands_are_two_tenths_of_a_second_apart_in_a_hurry_half_of_that() -> None:
    with scripted("acutrol_3000", [*READY, (b":read:rate? 3\n", b"0.0\n")]) as table:
        make_ready(table)
        table.measure_rate(3)
        sent_ns = [0, *(t_ns for _, direction, _, t_ns in table.test_log.lines if direction == "tx")]
    assert len(sent_ns) > 80
    assert min(later - earlier for earlier, later in pairwise(sent_ns)) >= 0.2 * NS
    with scripted("acutrol_3000", [*START, *MAKE_SAFE["acutrol_3000"]]) as table:
        with table.quick(0.5):
            table.make_safe()
        sent_ns = [t_ns for _, direction, _, t_ns in table.test_log.lines if direction == "tx"]
    assert {later - earlier for earlier, later in pairwise(sent_ns)} == {NS // 10}


LIMITED: Pairs = [*START, *limits(1), *limits(2), *limits(3)]
CLOSING = closing()
OTHER_MODE = [(sent, b"P\n" if reply == b"Rate\n" else reply) for sent, reply in CLOSING]


@pytest.mark.parametrize(
    ("script", "match"),
    [
        ([*LIMITED, (b":lim:rate? rate,1\n", b"400.0\n")], "400.0 deg/s"),  # changed by somebody else
        ([*LIMITED, *CLOSING[: CLOSING.index(interlock(2, "Closed"))], interlock(2, "Open")], "axis 2 reads back open"),
        ([*LIMITED, *OTHER_MODE[: OTHER_MODE.index((b":mode? 1\n", b"P\n")) + 1]], "'P'"),
    ],
)
def test_an_interlock_is_not_taken_for_closed_when_something_reads_back_different(script: Pairs, match: str) -> None:
    with scripted("acutrol_3000", script) as table, refused("B-INST-011", match):
        make_ready(table)


def test_a_mode_may_read_back_as_its_first_letter() -> None:
    short = {b"Off\n": b"O\n", b"Rate\n": b"R\n"}
    with scripted("acutrol_3000", [(sent, short.get(reply, reply)) for sent, reply in READY]) as table:
        make_ready(table)


def test_another_demand_is_noticed_and_one_a_turn_apart_is_the_same() -> None:
    elsewhere = [*motion(3, "90", "90", "90")[:-4], (b":dem:pos? 3\n", b"91.0\n")]
    script = [*READY, interlock(3, "Closed"), *resting(3, "0.0"), *elsewhere]
    with scripted("acutrol_3000", script) as table:
        make_ready(table)
        with refused("B-INST-011", "reads back 91.0 deg, but 90.0 deg was set"):
            table.turn(3, 90.0, 90.0, 90.0)
    apart = [(sent, b"-170\n" if sent == b":dem:pos? 3\n" else reply) for sent, reply in motion(3, "-170", "90", "90")]
    apart = [(sent, b"190\n" if sent == b":dem:pos? 3\n" else reply) for sent, reply in apart]
    with scripted("acutrol_3000", [*READY, interlock(3, "Closed"), *resting(3, "100.0"), *apart]) as table:
        make_ready(table)
        table.turn(3, 90.0, 90.0, 90.0)


SPINNING = [interlock(1, "Closed"), (b":read:rate? 1\n", b"29.9999\n")]
STOPS = limited("-150", "150")
OWN = [interlock(1, "Open"), (b":lim:abs? 1\n", ABSOLUTE)]
MOVES = [("move", (90.0, 10.0)), ("turn", (90.0, 10.0, 10.0)), ("spin", (10.0,))]


@pytest.mark.parametrize(
    ("start", "found", "name", "values", "code", "match"),
    [
        *[([], [], name, values, "B-INST-010", f"{name} refused.*axis 1") for name, values in MOVES],
        (READY, [], "move", (9.0, 300.5), "B-INST-008", "move: rate .*300.0.*nothing was sent"),
        (READY, [], "turn", (9.0, 301.0, 1.0), "B-INST-008", "turn: rate .*300.0.*nothing was sent"),
        (READY, [], "spin", (-300.5,), "B-INST-008", "spin: rate .*300.0.*nothing was sent"),
        (READY, [], "turn", (9.0, 10.0, 201.0), "B-INST-008", "turn: acceleration 201.0"),
        (START, OWN, "set_limits", (401.0, 100.0), "B-INST-008", "rate 401.0 is above 400.0"),
        (START, OWN, "set_limits", (400.0, 501.0), "B-INST-008", "acceleration 501.0 is above 500.0"),
        *[
            (READY, [interlock(1, "Open")], name, values, "B-INST-017", f"{name}.*axis 1 is open")
            for name, values in MOVES
        ],
        *[(READY, [interlock(1, "Fault")], name, values, "B-INST-017", "is fault") for name, values in MOVES],
        (READY, [interlock(1, "Closed")], "set_limits", (10.0, 10.0), "B-INST-017", "interlock of axis 1 is closed"),
        (
            STOPS,
            [interlock(1, "Closed"), *resting(1, "0")],
            "move",
            (170.0, 10.0),
            "B-INST-008",
            "outside -150.0 to 150.0",
        ),
        (
            STOPS,
            [interlock(1, "Closed"), *resting(1, "0")],
            "turn",
            (400.0, 9.0, 9.0),
            "B-INST-008",
            "nothing was moved",
        ),
        (READY, SPINNING, "turn", (10.0, 10.0, 10.0), "B-INST-017", "turns at 29.9999"),
    ],
)
def test_a_motion_that_may_not_be_is_refused(
    start: Pairs, found: Pairs, name: str, values: tuple[float, ...], code: str, match: str
) -> None:
    with scripted("acutrol_3000", [*start, *found]) as table:
        if start in (READY, STOPS):
            make_ready(table)
        with refused(code, match):
            getattr(table, name)(1, *values)


def test_without_limits_of_its_own_a_table_is_not_closed_or_moved() -> None:
    with refused("B-INST-010", "axis 1"):
        make("acutrol_3000", []).close_interlock()
    table = make("acutrol_3000", [*START, *limits(1)])
    table.set_limits(1, 300.0, 200.0)
    table._forget()
    with refused("B-INST-010", "axis 1"):
        table.spin(1, 10.0)


def test_the_status_byte_is_cleared_by_reading_so_all_errors_are_read_at_once() -> None:
    queue = [(b":stat:msg? qerror\n", reply) for reply in (b"103,LIMIT EXCEEDED\n", b'"12 BAD"\n', b"\n")]
    script = [*START, (b":dem:rate 1,0\n", None), (b"*STB?\n", b"193\n"), *queue]
    with (
        scripted("acutrol_3000", script) as table,
        refused("B-INST-005", "interlock fault; 103,LIMIT EXCEEDED; 12 BAD"),
    ):
        table.stop(1)


@pytest.mark.parametrize(
    ("closed", "rates", "words", "positions", "there"),
    [
        (True, ["0.0003", "0.0", "-0.0005"], ["Closed"] * 3, ["90.0004"], True),
        (True, ["0.0003", "0.0", "-0.0005"], ["Closed"] * 3, ["90.0031"], False),
        (True, ["0.0003", "0.0", "0.0131"], [], [], False),
        (True, ["0.0003", "0.0", "0.0"], ["Closed", "Fault"], [], False),
        (False, [], [], [], False),
    ],
)
def test_in_position(closed: bool, rates: list[str], words: list[str], positions: list[str], there: bool) -> None:
    moved = [interlock(1, "Closed"), *resting(1, "0.0"), *motion(1, "90", "10", "200")]
    script: Pairs = [*READY, *moved] if closed else [*START]
    script += [
        (f":read:rate? {axis}\n".encode(), f"{rate}\n".encode()) for axis, rate in zip((3, 2, 1), rates, strict=False)
    ]
    script += [interlock(axis, word) for axis, word in zip((1, 2, 3), words, strict=False)]
    script += [(b":read:pos? 1\n", f"{at}\n".encode()) for at in positions]
    with scripted("acutrol_3000", script) as table:
        if closed:
            make_ready(table)
            table.move(1, 90.0, 10.0)
        assert table.in_position() is there


def test_opening_waits_for_standstill_and_is_told_when_it_is_none() -> None:
    safe, turning = MAKE_SAFE["acutrol_3000"], (b":read:rate? 3\n", b"20.0\n")
    script = [*START, *safe[:6], (b":read:rate? 3\n", b"41.5\n"), (b":read:rate? 3\n", b"1.5\n"), *safe[6:]]
    with scripted("acutrol_3000", script) as table:
        table.open_interlock()
    waiting, braked = 50, 15  # looks in 10 s and in 3 s
    script = [*START, *safe[:6], *[turning] * waiting, *safe[9:], *[turning] * braked]
    with scripted("acutrol_3000", script) as table, refused("B-INST-009", "still turns"):
        table.open_interlock()
    script = [*START, *safe[:-1], interlock(3, "Closed")]
    with scripted("acutrol_3000", script) as table, refused("B-INST-009", "axis 3 is still closed"):
        table.make_safe()


def test_a_mute_table_is_stopped_and_opened_unheard() -> None:
    safe = MAKE_SAFE["acutrol_3000"]
    mute = [(b":read:rate? 3\n", TIMEOUT)]
    with scripted("acutrol_3000", [*START, *safe[:6], *mute, *safe[9:12]]) as table:
        table.identify()
        with table.quick(0.5), refused("B-INST-001", "read:rate"):
            table.make_safe()
    safe = MAKE_SAFE["acutrol_3000"]
    with (
        scripted("acutrol_3000", [(b"*IDN?\n", TIMEOUT), *safe[:6], *safe[9:12]]) as table,
        table.quick(0.5),
        refused("B-INST-001", "IDN"),
    ):
        table.make_safe()


def test_a_word_that_is_no_state_of_an_interlock_is_not_guessed() -> None:
    script = [*START, *[(b":int? 1\n", b"Ready\n"), (CLEAR, None), FINE] * 2, (b":int? 1\n", b"Ready\n"), (CLEAR, None)]
    with scripted("acutrol_3000", script) as table, refused("B-INST-004", "Open, Closed or Fault"):
        table.set_limits(1, 10.0, 10.0)
