"""Exact exchanges of the turntable: limits, interlock, motion, and everything it refuses.

How a row is read stands in ``tests/support/simulated/exchanges.py``.
"""

from itertools import pairwise

import pytest
from exchanges import Call, Row, does, exchange, gives, refuses, row
from scripted import make, refused, scripted

from bench.model.clock import NS
from instruments.acutrol_axis import AxisRange

NAME = "acutrol_3000"
ABSOLUTE = "400.0, 500.0, 10000.0, -180.0, 180.0, 440.0"
ONE_TURN = "360.0,360.0,0.0,deg,NR2,NR2,NR2,NR2,NR2"
AXES = (1, 2, 3)


def limits(axis: int, absolute: str = ABSOLUTE, scaling: str = ONE_TURN) -> str:
    """The exchange of set_limits(axis, 300, 200)."""
    settings = [
        f":lim:{what} {mode},{axis},{value}! | :lim:{what}? {mode},{axis} -> {value}.0"
        for mode in ("pos", "rate")
        for what, value in (("rate", 300), ("acc", 200))
    ]
    settings += [f":lim:acc? off,{axis} -> 200.0 | :lim:acc? abort,{axis} -> 199.0"]
    settings += [f":lim:acc abort,{axis},200! | :lim:acc? abort,{axis} -> 200.0"]
    told = f":int? {axis} -> Open | :conf:scal? {axis} -> {scaling}"
    return " | ".join([told, f":lim:abs? {axis} -> {absolute}", *settings])


def summing(axis: int, query: str, rest: str) -> str:
    return ";".join(f":conf:demandsum{query} {axis},{state}{rest}" for state in "praj")


def closing() -> str:
    """The exchange of close_interlock."""
    looks = [f":lim:rate? rate,{axis} -> 300 | :lim:acc? rate,{axis} -> 200" for axis in AXES]
    closes = [
        f":mode:off {axis}! | :mode? {axis} -> Off | :dem:rate {axis},0! | :dem:rate? {axis} -> 0.0 | "
        f":int:close {axis}! | :int? {axis} -> Closed | :mode:rate {axis}! | :mode? {axis} -> Rate"
        for axis in AXES
    ]
    sums = [f"{summing(axis, '?', '')} -> D,0,0,0;D,2090,100,0.022;D,0,0,0;D,0,0,0" for axis in AXES]
    return " | ".join([*looks, *sums, ":int:reset!", *closes])


def motion(axis: int, target: str, rate: str, acceleration: str, reached: str = "") -> str:
    """The exchange that sends an axis to a position."""
    return (
        f":lim:rate pos,{axis},{rate}! | :lim:rate? pos,{axis} -> {rate} | "
        f":lim:acc pos,{axis},{acceleration}! | :lim:acc? pos,{axis} -> {acceleration} | "
        f":dem:pos {axis},{target}! | :dem:pos? {axis} -> {reached or target} | "
        f":mode:pos {axis}! | :mode? {axis} -> Position"
    )


def resting(axis: int, at: str) -> str:
    """An axis without a demand says where it is."""
    return f":read:rate? {axis} -> 0.0004 | :read:pos? {axis} -> {at}"


def spinning(axis: int, rate: str) -> str:
    return f":dem:rate {axis},{rate}! | :dem:rate? {axis} -> {rate} | :mode:rate {axis}! | :mode? {axis} -> Rate"


LIMITED = " | ".join(["<start>", *map(limits, AXES)])
CLOSING = closing()
READY = f"{LIMITED} | {CLOSING}"
STOPS = READY.replace(f":lim:abs? 1 -> {ABSOLUTE}", f":lim:abs? 1 -> {ABSOLUTE.replace('180.0', '150')}")
SET = tuple(does("set_limits", axis, 300.0, 200.0) for axis in AXES)
MADE_READY = (*SET, does("close_interlock"))
CLOSED_1, CLOSED_3 = ":int? 1 -> Closed", ":int? 3 -> Closed"
OWN = f"<start> | :int? 1 -> Open | :conf:scal? 1 -> {ONE_TURN} | :lim:abs? 1 -> {ABSOLUTE}"
SUMS = f"{summing(1, '?', '')} -> D,0,0,0;E,2090,1,0;D,0,0,0;D,0,0,0"
SUMMED = f"{LIMITED} | {CLOSING.partition(':conf')[0]}{SUMS}"
MOVES = [("move", (90.0, 10.0)), ("turn", (90.0, 10.0, 10.0)), ("spin", (10.0,))]
IN_PLACE = [  # rates of axes 3, 2, 1, interlocks of 1, 2, 3, where 1 is
    (["0.0003", "0.0", "-0.0005"], ["Closed"] * 3, ["90.0004"], True),
    (["0.0003", "0.0", "-0.0005"], ["Closed"] * 3, ["90.0031"], False),
    (["0.0003", "0.0", "0.0131"], [], [], False),
    (["0.0003", "0.0", "0.0"], ["Closed", "Fault"], [], False),
]
WAYS = [
    (READY, "-9.9999", 0.0, "0"), (READY, "179.9998", 190.0, "-170"), (READY, "-160", 170.0, "170"),  # through -180
    (READY, "0", 360.0, "0"), (STOPS, "-100", 130.0, "130"), (STOPS, "100", 220.0, "-140"), (STOPS, "0", 370.0, "10"),
]  # fmt: skip
QUEUE = ':stat:msg? qerror -> 103,LIMIT EXCEEDED | :stat:msg? qerror -> "12 BAD" | :stat:msg? qerror -> '
NO_SCALE, NO_STATE = ":conf:scal? 1 -> {} | <clear>", ":int? 1 -> Ready | <clear>"


def looks(rates: list[str], words: list[str], positions: list[str]) -> str:
    """The exchange of in_position as far as it goes."""
    return " | ".join([
        *[f":read:rate? {axis} -> {rate}" for axis, rate in zip((3, 2, 1), rates, strict=False)],
        *[f":int? {axis} -> {word}" for axis, word in zip(AXES, words, strict=False)],
        *[f":read:pos? 1 -> {at}" for at in positions],
    ])  # fmt: skip


def ready(claim: str, script: str, *calls: Call, start: str = READY) -> Row:
    """A row of a table whose limits are set and whose interlock is closed."""
    return row(NAME, claim, f"{start} | {script}", *MADE_READY, *calls)


ROWS = [
    *[row(NAME, f"{scaling} with {absolute.count(',')} limits", f"<start> | {limits(1, absolute, scaling)}", SET[0],
          leaves={"ranges": {1: AxisRange(360.0, 0.0, -180.0, 180.0)}})
      for absolute in (ABSOLUTE, f"{ABSOLUTE}, 5.0")  # with and without a trip of the tracking error
      for scaling in (ONE_TURN, "360,360,0", '360.0, 360.0, 0.0, "Degrees"')],
    *[row(NAME, f"an axis that counts in {scaling} is not used",
          "<start> | :int? 1 -> Open | " + " | <ok> | ".join([NO_SCALE.format(scaling)] * 3),
          refuses("B-INST-004", "", "set_limits", 1, 300.0, 200.0), leaves={"limits": {}})
      for scaling in ("6.2832,6.2832,0,rad", "1,1,0,rev", "360.0", "360,6.2832,0,deg", "360,360,0,rad")],
    row(NAME, "a signal that is summed to a demand is switched off, and the interlock stays open unless it is",
        f"{SUMMED} | {summing(1, '', ',disable')}! | {SUMS}", *SET,
        refuses("B-INST-011", "demand summing of axis 1 is not right", "close_interlock")),
    row(NAME, "numbers are told in figures",
        "<start:2> | :util:form? -> BINARY | :util:form float! | :util:form? -> FLOAT", does("identify")),
    ready("limits, then the interlock, then motion",
          f"{CLOSED_3} | {resting(3, '0.0003')} | {motion(3, '90', '45', '200')} | {CLOSED_3} | "
          f"{motion(3, '-70', '270', '150')} | {CLOSED_3} | {spinning(3, '-30')} | {spinning(3, '0')}",
          does("move", 3, 90.0, 45.0), does("turn", 3, -160.0, 270.0, 150.0), does("spin", 3, -30.0), does("stop", 3)),
    *[ready(f"from {here} to {angle} the shorter way that the stops leave",
            f"{CLOSED_1} | {resting(1, here)} | {motion(1, target, '10', '200')}", does("move", 1, angle, 10.0),
            start=start)
      for start, here, angle, target in WAYS],
    row(NAME, "a limit that somebody changed", f"{LIMITED} | :lim:rate? rate,1 -> 400.0", *SET,
        refuses("B-INST-011", "400.0 deg/s", "close_interlock")),
    row(NAME, "an interlock that does not close",
        f"{LIMITED} | {CLOSING.partition(':int? 2')[0]}:int? 2 -> Open", *SET,
        refuses("B-INST-011", "axis 2 reads back open", "close_interlock")),
    row(NAME, "another mode before it is closed",
        f"{LIMITED} | {CLOSING.partition(':mode? 1 -> Rate')[0]}:mode? 1 -> P", *SET,
        refuses("B-INST-011", "'P'", "close_interlock")),
    row(NAME, "a mode may read back as its first letter", READY.replace("-> Off", "-> O").replace("-> Rate", "-> R"),
        *MADE_READY),
    ready("another demand is noticed", f"{CLOSED_3} | {resting(3, '0.0')} | "
          + motion(3, "90", "90", "90").partition(":dem:pos? 3")[0] + ":dem:pos? 3 -> 91.0",
          refuses("B-INST-011", "reads back 91.0 deg, but 90.0 deg was set", "turn", 3, 90.0, 90.0, 90.0)),
    ready("a demand a turn apart is the same",
          f"{CLOSED_3} | {resting(3, '100.0')} | {motion(3, '-170', '90', '90', '190')}",
          does("turn", 3, 90.0, 90.0, 90.0)),
    *[row(NAME, f"no {name} without limits", "", refuses("B-INST-010", f"{name} refused.*axis 1", name, 1, *values))
      for name, values in MOVES],
    *[row(NAME, f"no {name} with {what}", READY, *MADE_READY, refuses("B-INST-008", what, name, 1, *values))
      for name, values, what in (
          ("move", (9.0, 300.5), "move: rate .*300.0.*nothing was sent"),
          ("turn", (9.0, 301.0, 1.0), "turn: rate .*300.0.*nothing was sent"),
          ("spin", (-300.5,), "spin: rate .*300.0.*nothing was sent"),
          ("turn", (9.0, 10.0, 201.0), "turn: acceleration 201.0"))],
    *[row(NAME, f"no limit with {what}", OWN, refuses("B-INST-008", what, "set_limits", 1, *values))
      for values, what in (
          ((401.0, 100.0), "rate 401.0 is above 400.0"), ((400.0, 501.0), "acceleration 501.0 is above 500.0"))],
    *[ready(f"no {name} where the interlock is {word}", f":int? 1 -> {word}",
            refuses("B-INST-017", f"{name}.*axis 1 is {word.lower()}", name, 1, *values))
      for name, values in MOVES for word in ("Open", "Fault")],
    ready("no limits where the interlock is closed", CLOSED_1,
          refuses("B-INST-017", "interlock of axis 1 is closed", "set_limits", 1, 10.0, 10.0)),
    ready("no move beyond a stop", f"{CLOSED_1} | {resting(1, '0')}",
          refuses("B-INST-008", "outside -150.0 to 150.0", "move", 1, 170.0, 10.0), start=STOPS),
    ready("no turn beyond a stop", f"{CLOSED_1} | {resting(1, '0')}",
          refuses("B-INST-008", "nothing was moved", "turn", 1, 400.0, 9.0, 9.0), start=STOPS),
    ready("no turn of an axis that spins", f"{CLOSED_1} | :read:rate? 1 -> 29.9999",
          refuses("B-INST-017", "turns at 29.9999", "turn", 1, 10.0, 10.0, 10.0)),
    row(NAME, "no interlock is closed without limits", "", refuses("B-INST-010", "axis 1", "close_interlock")),
    row(NAME, "another table has no limits", f"<start> | {limits(1)}", SET[0], does("_forget"),
        refuses("B-INST-010", "axis 1", "spin", 1, 10.0)),
    row(NAME, "the status byte is cleared by reading, so all errors are read at once",
        f"<start> | :dem:rate 1,0 | *STB? -> 193 | {QUEUE}",
        refuses("B-INST-005", "interlock fault; 103,LIMIT EXCEEDED; 12 BAD", "stop", 1)),
    *[ready(f"in position: {there}, {rates[2]}, {words}, {positions}",
            f"{CLOSED_1} | {resting(1, '0.0')} | {motion(1, '90', '10', '200')} | {looks(rates, words, positions)}",
            does("move", 1, 90.0, 10.0), gives(there, "in_position")) for rates, words, positions, there in IN_PLACE],
    row(NAME, "not in position before it is ready", "<start>", gives(False, "in_position")),
    row(NAME, "a word that is no state of an interlock is not guessed",
        f"<start> | {NO_STATE} | <ok> | {NO_STATE} | <ok> | {NO_STATE}",
        refuses("B-INST-004", "Open, Closed or Fault", "set_limits", 1, 10.0, 10.0)),
]  # fmt: skip


@pytest.mark.parametrize("case", ROWS, ids=lambda case: case.claim)
def test_an_exchange(case: Row) -> None:
    case.play()


def test_commands_are_two_tenths_of_a_second_apart_in_a_hurry_half_of_that() -> None:
    with scripted(NAME, exchange(NAME, f"{READY} | :read:rate? 3 -> 0.0")) as table:
        for call in MADE_READY:
            call.on(table)
        table.measure_rate(3)
        sent_ns = [0, *(t_ns for _, direction, _, t_ns in table.test_log.lines if direction == "tx")]
    assert len(sent_ns) > 80
    assert min(later - earlier for earlier, later in pairwise(sent_ns)) >= 0.2 * NS
    with scripted(NAME, exchange(NAME, "<start> | <safe>")) as table:
        with table.quick(0.5):
            table.make_safe()
        sent_ns = [t_ns for _, direction, _, t_ns in table.test_log.lines if direction == "tx"]
    assert {later - earlier for earlier, later in pairwise(sent_ns)} == {NS // 10}


SAFE = exchange(NAME, "<safe>")  # six commands, three looks, three openings, the status, three interlocks
START, TURNING = exchange(NAME, "<start>"), exchange(NAME, ":read:rate? 3 -> 20.0")
MUTE = exchange(NAME, ":read:rate? 3 -> <timeout>")


def test_opening_waits_for_standstill_and_is_told_when_it_is_none() -> None:
    slowing = exchange(NAME, ":read:rate? 3 -> 41.5 | :read:rate? 3 -> 1.5")
    with scripted(NAME, [*START, *SAFE[:6], *slowing, *SAFE[6:]]) as table:
        table.open_interlock()
    waiting, braked = 50, 15  # looks in 10 s and in 3 s
    script = [*START, *SAFE[:6], *TURNING * waiting, *SAFE[9:], *TURNING * braked]
    with scripted(NAME, script) as table, refused("B-INST-009", "still turns"):
        table.open_interlock()
    script = [*START, *SAFE[:-1], *exchange(NAME, CLOSED_3)]
    with scripted(NAME, script) as table, refused("B-INST-009", "axis 3 is still closed"):
        table.make_safe()


@pytest.mark.parametrize("identified", [True, False])
def test_a_mute_table_is_stopped_and_opened_unheard(identified: bool) -> None:
    begins = [*START, *SAFE[:6], *MUTE] if identified else [*exchange(NAME, "*IDN? -> <timeout>"), *SAFE[:6]]
    table = make(NAME, [*begins, *SAFE[9:12]])
    if identified:
        table.identify()
    with table.quick(0.5), refused("B-INST-001", "read:rate" if identified else "IDN"):
        table.make_safe()
    assert table.test_resource.events == []
