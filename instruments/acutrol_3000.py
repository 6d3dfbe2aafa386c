"""Acutronic ACUTROL3000 controller of a three-axis turntable over GPIB: outer axis 1, middle axis 2, inner axis 3.

A mode that is activated moves the table to whatever demand is loaded, so a demand is loaded and read back before its
mode; another signal that is summed to it is switched off (state table). ``*STB?`` clears what it tells: bit 0
interlocks, bit 7 messages in the error queue. Commands are kept 200 ms apart, as in public programs, which report
commands that are not recognised; 100 ms in the first hurried attempt to make it safe (40 ms are said to be the least).
Angles in deg as the controller counts them, rates in deg/s. An axis without stops takes the shortest way to a demand
(acutrol_axis.py).

Source: manual TM-8004-C: 3.10 (status byte), 4.2.6 (sums), 4.2.26 (range of positions), 4.5 (interlocks), 4.6 (limits;
a trip of the tracking error may stand behind that of speed), 4.7 (modes; :MODE? answers "P" too), 4.11.4 (messages of a
queue, a null string when it is empty), 4.14.1 (format); public Python, C# and ROS programs for this controller (words
"Rate", "Position", "Fault"). Not confirmed on hardware: the text of a message; the words "Open", "Closed" and "Off";
how :CONF:SCAL? answers. An emergency stop within reach and the table's own limits stay the safety function.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

from bench.model.clock import NS, to_ns
from bench.model.errors import InstrumentError
from bench.model.ports import Effect, Parameter, action
from instruments import acutrol_axis as table
from instruments.acutrol_axis import CLOSED, AxisRange, LongTurn, is_mode, read_absolute, read_interlock, read_scaling
from instruments.base import BaseInstrument
from instruments.commands import either
from instruments.values import plain_form, read_integer, read_number

_AXES = (1, 2, 3)
_INNER_FIRST = (3, 2, 1)  # the inner axis is the fast one
_INTERLOCK_FAULT, _ERRORS_QUEUED = 1 << 0, 1 << 7
_AT_REST_DEG_S, _THERE_DEG = 0.01, 0.003
_STEP = 1e-4  # of the read-back of limits and demands
_STANDSTILL_S, _HURRIED_STANDSTILL_S = 10.0, 1.0  # what still turns then is braked by the open interlock
_BRAKED_S = 3.0
_LOOK_S = 0.2
_LONG = (170.0, 14.0)  # a turn by more than this, deg, takes its caller up to so long, s
_LONGEST_TURN_S = 8.0  # that a turn may keep its caller
_ASTRAY_DEG = 75.0  # in a turn, from where it should be: half a turn would be miscounted
_FIRST_LOOK_S, _LAST_LOOK_S = 0.3, 0.6  # behind full rate, and before the hand-over
_LATE_S = 0.15  # of the hand-over; more, and the axis could not come to rest where it is sent
_AXIS = Parameter("axis", choices=_AXES)
_ANGLE = Parameter("angle", "deg", -3600.0, 3600.0)
_RATE = Parameter("rate", "deg/s", 0.001, 1000.0)
_ACCELERATION = Parameter("acceleration", "deg/s2", 0.1, 5000.0)


class Acutrol3000(BaseInstrument):
    """Control of the table: limits, then interlock, then motion. No action waits until a motion has ended."""

    identity_pattern = r"ACUTRONIC.*,ACUTROL3000"
    safe_state = "all rates 0, at rest, all interlocks open (:INT:OPEN), confirmed by :INT? and :READ:RATE?"
    spacing_s = 0.2
    tells = table.tells_of(_AXES, _AT_REST_DEG_S)

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.limits: dict[int, tuple[float, float]] = {}  # deg/s and deg/s2 by axis, of this run
        self.ranges: dict[int, AxisRange] = {}  # positions by axis
        self.wanted: dict[int, float] = {}  # position demand by axis, deg; none for an axis in rate mode
        self.closed = False

    @action(_AXIS, _RATE, _ACCELERATION, bus_s=4.3)
    def set_limits(self, axis: int, rate: float, acceleration: float) -> None:
        """Set the most an axis may do in either mode, deg/s and deg/s2, and read it back; its interlock must be open.

        Switched off or aborted by its controller it comes to rest with that acceleration at least (4.6.8).

        Raises: InstrumentError B-INST-004 (not in deg), B-INST-008 (also above the table's own limits), B-INST-017,
                B-INST-005, B-INST-011.
        """
        if self._interlock(axis) == CLOSED:
            message = f"set_limits: the interlock of axis {axis} is closed; nothing was set"
            raise self.error("B-INST-017", message, "set the limits before close_interlock")
        width, middle = self.ask(f":conf:scal? {axis}", read_scaling)
        most_rate, most_acceleration, _, low, high = self.ask(f":lim:abs? {axis}", read_absolute)[:5]
        most = most_rate, most_acceleration
        self._check_most("set_limits", (rate, acceleration), most, f"the table's own limit of axis {axis}")
        self.limits.pop(axis, None)
        for mode in ("pos", "rate"):
            self._limit("rate", mode, axis, rate)
            self._limit("acc", mode, axis, acceleration)
        for mode in ("off", "abort"):  # never less: it brakes a fault
            if self.ask(f":lim:acc? {mode},{axis}", read_number) < acceleration:
                self._limit("acc", mode, axis, acceleration)
        self.limits[axis], self.ranges[axis] = (rate, acceleration), AxisRange(width, middle, low, high)

    @action(effect=Effect.MOTION_ON, bus_s=10.0)
    def close_interlock(self) -> None:
        """Set the interlocks of all axes closed with rate 0 demanded, if all limits read back, and confirm each.

        Raises: InstrumentError B-INST-010 before ``set_limits`` of each axis, B-INST-005, B-INST-011.
        """
        if missing := [axis for axis in _AXES if axis not in self.limits]:
            message = f"close_interlock refused: no limits were set by this run for axis {missing[0]}"
            raise self.error("B-INST-010", message, "call set_limits for each axis before it")
        self._recheck()
        self.bring("close_interlock")
        self.set(":int:reset")
        for axis in _AXES:
            self._mode("off", "OFF", axis)
            self._load(":dem:rate", str(axis), 0.0, "deg/s")
            self.set(f":int:close {axis}", either(lambda axis=axis: self._interlock(axis), CLOSED))  # type: ignore[misc]
            self._confirm_closed(axis)
            self._mode("rate", "RATE", axis)
        self.wanted.clear()
        self.closed = True

    @action(effect=Effect.MOTION_OFF, bus_s=5.0)
    def open_interlock(self) -> None:
        """Set all rates to 0, wait for standstill, then open all interlocks and confirm it.

        Raises: InstrumentError B-INST-009 if an interlock stays closed or an axis does not come to rest in 10 s.
        """
        self._ready()
        self._rest_and_open(_STANDSTILL_S)

    @action(_AXIS, _ANGLE, _RATE, effect=Effect.MOTION_ON, bus_s=3.5)
    def move(self, axis: int, angle: float, rate: float) -> None:
        """Set an axis on its way to an angle (deg, absolute up to whole turns) the shorter way, at most at ``rate``.

        Raises: InstrumentError B-INST-008, B-INST-010 (no limits), B-INST-017 (interlock open), B-INST-005, B-INST-011.
        """
        acceleration = self._limits_of("move", axis, rate)[1]
        here = self._here("move", axis)
        way = self.ranges[axis].shorter_way(here, angle)
        self._go("move", axis, here + way, rate, acceleration)

    @action(_AXIS, _ANGLE, _RATE, _ACCELERATION, effect=Effect.MOTION_ON, bus_s=3.5, longer={"angle": _LONG})
    def turn(self, axis: int, angle: float, rate: float, acceleration: float) -> None:
        """Set an axis turning by an angle (deg, signed, turns included) from its demand, at most at ``rate``.

        What is less than half the range of the axis is one demand: a trapezoid. A longer turn runs at a rate until
        135 deg are left, which keeps the caller up to 8 s; its turns are counted by the position on the way.

        Raises: InstrumentError B-INST-008 (also for a turn that would take longer), B-INST-010 (no limits), B-INST-017
                (interlock open, or an axis that turns with no position demand), B-INST-005, B-INST-011 (also for an
                axis that is not where it should be on the way, or a hand-over that is late: it is stopped).
        """
        self._limits_of("turn", axis, rate, acceleration)
        here = self._here("turn", axis)
        if self.ranges[axis].at_once(angle):
            self._go("turn", axis, here + angle, rate, acceleration)
        else:
            self._go_far(axis, here, LongTurn.of(angle, rate, acceleration))

    @action(_AXIS, Parameter("rate", "deg/s", -1000.0, 1000.0), effect=Effect.MOTION_ON, bus_s=2.0)
    def spin(self, axis: int, rate: float) -> None:
        """Set an axis turning at a constant rate, deg/s, signed.

        Raises: InstrumentError B-INST-008, B-INST-010 (no limits), B-INST-017 (interlock open), B-INST-005, B-INST-011.
        """
        self._limits_of("spin", axis, rate)
        self._must_be_closed("spin", axis)
        self._turn_at(axis, rate)

    @action(_AXIS, bus_s=1.5)
    def stop(self, axis: int) -> None:
        """Set the rate of an axis to 0, whatever it does. Raises: InstrumentError B-INST-005, B-INST-011."""
        self._turn_at(axis, 0.0)

    @action(_AXIS, bus_s=0.5, returns="deg")
    def measure_position(self, axis: int) -> float:
        """Measure the angle of an axis, deg, within its range: one turn, as delivered."""
        return self.ask(f":read:pos? {axis}", read_number)

    @action(_AXIS, bus_s=0.5, returns="deg/s")
    def measure_rate(self, axis: int) -> float:
        """Measure the rate of an axis, deg/s."""
        return self.ask(f":read:rate? {axis}", read_number)

    @action(bus_s=2.0)
    def in_position(self) -> bool:
        """Get whether all axes are at rest, within 0.003 deg of their demands, and held by closed interlocks."""
        self._ready()
        if not self.closed or not self._at_rest() or any(self._interlock(axis) != CLOSED for axis in _AXES):
            return False
        return all(self._off(axis, angle) <= _THERE_DEG for axis, angle in self.wanted.items())

    def _go_safe_unheard(self) -> None:
        """Order rest and open interlocks where nobody said who is there; one that falls silent later has its orders."""
        if self.identity is None:
            self._order_rest()
            self._order_open()

    def drain_errors(self) -> list[str]:
        """Get what the status byte tells, which that clears, and all queued messages, oldest first."""
        status = self.bus.query("*STB?", read_integer, self.timeout_s, repeatable=False)
        problems = ["interlock fault"] if status & _INTERLOCK_FAULT else []
        return problems + super().drain_errors() if status & _ERRORS_QUEUED else problems

    def _next_error(self) -> str | None:
        """Get the oldest message, in whatever words; the manual leaves them open."""
        said = self.bus.query(":stat:msg? qerror", str.strip, self.timeout_s, repeatable=False)
        return said.strip('"') or None

    def _limits_of(self, name: str, axis: int, rate: float, acceleration: float = 0.0) -> tuple[float, float]:
        if axis not in self.limits:
            message = f"{name} refused: no limits were set by this run for axis {axis}; nothing was sent"
            raise self.error("B-INST-010", message, "call set_limits, then close_interlock before it")
        limits = self.limits[axis]
        self._check_most(name, (abs(rate), acceleration), limits, f"the limit set for axis {axis}")
        return limits

    def _check_most(self, name: str, wanted: tuple[float, float], most: tuple[float, float], whose: str) -> None:
        """Raise InstrumentError B-INST-008 if a rate or an acceleration is above a limit."""
        for what, value, limit in zip(("rate", "acceleration"), wanted, most, strict=True):
            if value > limit:
                raise self.refusal(f"{name}: {what} {value!r} is above {limit!r}, {whose}")

    def _must_be_closed(self, name: str, axis: int) -> None:
        if (state := self._interlock(axis)) != CLOSED:
            message = f"{name} refused: the interlock of axis {axis} is {state.lower()}; nothing was moved"
            raise self.error("B-INST-017", message, "close_interlock before it; after a fault look at the table first")

    def _here(self, name: str, axis: int) -> float:
        """Return where a motion begins, deg: the demand, or the reading of an axis at rest that has none."""
        self._must_be_closed(name, axis)
        if axis in self.wanted:
            return self.wanted[axis]
        if abs(rate := self.measure_rate(axis)) > _AT_REST_DEG_S:
            message = f"{name} refused: axis {axis} turns at {rate!r} deg/s without a position demand"
            raise self.error("B-INST-017", message, "stop the axis and settle before it")
        return self.measure_position(axis)

    def _off(self, axis: int, angle: float) -> float:
        """Return how far an axis is from an angle, deg; a turn of its range more or less is the same place."""
        return abs(self.ranges[axis].apart(self.measure_position(axis), angle))

    def _go(self, name: str, axis: int, target: float, rate: float, acceleration: float) -> None:
        known = self.ranges[axis]
        if not known.holds(target):
            message = f"{name}: {target!r} deg is outside {known.low!r} to {known.high!r} deg of axis {axis}"
            raise self.refusal(message, "nothing was moved")
        self._limit("rate", "pos", axis, rate)
        self._limit("acc", "pos", axis, acceleration)
        self.wanted.pop(axis, None)
        self._demand_position(axis, known.wrapped(target))
        self._mode("pos", "POSITION", axis)
        self.wanted[axis] = known.wrapped(target)

    def _go_far(self, axis: int, here: float, turn: LongTurn) -> None:
        """A demand that is loaded is not obeyed in rate mode, so the last command of the turn is its mode alone."""
        if turn.hand_over_s > _LONGEST_TURN_S:
            message = f"turn: {turn.way!r} deg would keep the bench {turn.hand_over_s:.0f} s; nothing was moved"
            raise self.error("B-INST-008", message, f"turn faster, or by less than half a turn; {_LONGEST_TURN_S:g} s")
        target = self.ranges[axis].wrapped(here + turn.way)
        self._limit("rate", "pos", axis, abs(turn.rate))
        self._limit("acc", "pos", axis, turn.acceleration)
        self._turn_at(axis, 0.0)
        self._limit("acc", "rate", axis, turn.acceleration)
        self._demand_position(axis, target)
        try:
            self._run_and_hand_over(axis, here, turn)
        except InstrumentError:
            with suppress(InstrumentError):
                self._turn_at(axis, 0.0)
                self._limit("acc", "rate", axis, self.limits[axis][1])
            raise
        self.wanted[axis] = target
        self._limit("acc", "rate", axis, self.limits[axis][1])

    def _run_and_hand_over(self, axis: int, here: float, turn: LongTurn) -> None:
        self.bus.write(f":dem:rate {axis},{plain_form(turn.rate)}", self.timeout_s)
        began_ns = self.clock.now_ns()
        self.check_errors(f":dem:rate {axis}")
        due_ns = began_ns + to_ns(turn.hand_over_s)
        for before_s in (turn.hand_over_s - turn.up_s - _FIRST_LOOK_S, _LAST_LOOK_S):
            self.bus.pause((due_ns - self.clock.now_ns()) / NS - before_s)
            position = self.measure_position(axis)
            now_ns = self.clock.now_ns()
            expected = turn.done((now_ns - began_ns) / NS)
            astray = self.ranges[axis].apart(position, here + expected)
            if abs(astray) > _ASTRAY_DEG:
                message = f"turn: axis {axis} is {astray:.0f} deg from where it should be after {expected:.0f} deg"
                raise self.error("B-INST-011", message, "look at the table: it slips, is blocked or is not driven")
            due_ns = now_ns + to_ns(turn.left_s(expected + astray))
        self.bus.pause((due_ns - self.clock.now_ns()) / NS)
        self.bus.write(f":mode:pos {axis}", self.timeout_s)
        late_s = (self.clock.now_ns() - due_ns) / NS
        self.check_errors(f":mode:pos {axis}")
        self._confirm_mode("POSITION", axis)
        if late_s > _LATE_S:
            message = f"turn: axis {axis} was handed over {late_s:.2f} s late; its turns cannot be counted any more"
            raise self.error("B-INST-011", message, "look what held the controller up, then take the point again")

    def _turn_at(self, axis: int, rate: float) -> None:
        self.wanted.pop(axis, None)
        self._load(":dem:rate", str(axis), rate, "deg/s")
        self._mode("rate", "RATE", axis)

    def _limit(self, what: str, mode: str, axis: int, value: float) -> None:
        self._load(f":lim:{what}", f"{mode},{axis}", value, "deg/s" if what == "rate" else "deg/s2")

    def _load(self, header: str, place: str, value: float, unit: str, turn: float = math.inf) -> None:
        query = f"{header}? {place}"
        self.set(f"{header} {place},{plain_form(value)}", self.number(query, value, _STEP, turn))
        self.confirm(query, value, _STEP, unit, turn)

    def _demand_position(self, axis: int, value: float) -> None:
        """Load a position; it may read back a whole range apart, which is the same place."""
        self._load(":dem:pos", str(axis), value, "deg", self.ranges[axis].turn)

    def _mode(self, mode: str, word: str, axis: int) -> None:
        query = f":mode? {axis}"
        self.set(f":mode:{mode} {axis}", either(lambda: is_mode(self.ask(query, str.upper), word), True))
        self._confirm_mode(word, axis)

    def _confirm_mode(self, word: str, axis: int) -> None:
        query = f":mode? {axis}"
        if not is_mode(answer := self.ask(query, str.upper), word):
            raise self.error("B-INST-011", f"{query!r} reads back {answer!r}, but {word!r} was set")
        self.seen[query] = word

    def _interlock(self, axis: int) -> str:
        return self.ask(f":int? {axis}", read_interlock)

    def _confirm_closed(self, axis: int) -> None:
        if (state := self._interlock(axis)) != CLOSED:
            message = f"the interlock of axis {axis} reads back {state.lower()}, but it was closed"
            raise self.error("B-INST-011", message, "look at the table and its emergency stop")

    def _at_rest(self) -> bool:
        return all(abs(self.measure_rate(axis)) <= _AT_REST_DEG_S for axis in _INNER_FIRST)

    def _recheck(self) -> None:
        for axis, (rate, acceleration) in sorted(self.limits.items()):
            self.confirm(f":lim:rate? rate,{axis}", rate, _STEP, "deg/s")
            self.confirm(f":lim:acc? rate,{axis}", acceleration, _STEP, "deg/s2")
        if self.closed:
            for axis in _AXES:
                self._confirm_closed(axis)

    def _forget(self) -> None:
        self.limits, self.ranges, self.wanted, self.closed = {}, {}, {}, False

    def _go_safe(self) -> None:
        self._rest_and_open(_HURRIED_STANDSTILL_S if self.bus.hurried else _STANDSTILL_S)

    def _rest_and_open(self, patience_s: float) -> None:
        """Rates 0, standstill for at most ``patience_s``, interlocks open: the last whatever was answered before."""
        self.wanted.clear()
        self._order_rest()
        at_rest, doubt = False, None
        try:
            self.bus.write(":util:form float", self.timeout_s)  # binary rates, of the last user, could not be read
            at_rest = self.poll(self._at_rest, patience_s, _LOOK_S)
        except InstrumentError as error:
            doubt = error
        self._order_open()
        if doubt is not None:
            raise doubt
        self.drain_errors()
        if still := [axis for axis in _AXES if self._interlock(axis) == CLOSED]:
            message = f"the interlock of axis {still[0]} is still closed after :int:open"
            raise self.error("B-INST-009", message, "press the emergency stop of the table")
        self.closed = False
        if not at_rest and not self.poll(self._at_rest, _BRAKED_S, _LOOK_S):
            raise self.error(
                "B-INST-009", "the interlocks are open and the table still turns", "keep away until it rests"
            )

    def _order_rest(self) -> None:
        for axis in _INNER_FIRST:
            self.bus.write(f":dem:rate {axis},0", self.timeout_s)
            self.bus.write(f":mode:rate {axis}", self.timeout_s)

    def _order_open(self) -> None:
        for axis in _INNER_FIRST:
            self.bus.write(f":int:open {axis}", self.timeout_s)


DRIVER = Acutrol3000
