"""An axis of a turntable as its controller tells and counts it, and how to turn by more than half its range.

An axis without stops knows positions within its range only (one turn, as delivered) and takes the shortest way to a
demand. So a turn of half the range or more is begun at a rate and handed over to a position demand when less than half
a turn is left. An axis with stops goes where it is sent, whatever way that is.

Source: manual TM-8004-C 4.2.26 (range, roll-over), 4.6.6 and 4.6.7 (stops of limited axes), 4.7.4 (shortest way), 5.1.6
(demands outside the range wrap); TM-9388 section on user preferences (range and middle).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from bench.model.ports import Figure, Tells
from instruments.values import read_number

OPEN, CLOSED, FAULT = "OPEN", "CLOSED", "FAULT"
TURN_DEG = 360.0
HAND_OVER_DEG = 135.0  # left of a turn when the position demand takes over: surely the shortest way
_MARGIN_DEG = 10.0  # to half the range, for what is sent in one demand
_BRAKE_DEG = 90.0  # most that an axis needs to come to rest: with the way of a late command, less than is left
_LOOK_S = 0.9  # from full rate to the hand-over at least, for two looks at the position
_ABSOLUTE_VALUES = (6, 7)


@dataclass(frozen=True)
class AxisRange:
    """Positions of an axis, degree: ``width`` of the range around ``middle``; ``low`` and ``high`` of its window."""

    width: float
    middle: float
    low: float
    high: float

    @property
    def limited(self) -> bool:
        """Whether the axis has stops: its window is smaller than its range."""
        return self.high - self.low < self.width

    def holds(self, angle: float) -> bool:
        """Return whether an axis may be sent to an angle; anywhere if it has no stops."""
        return not self.limited or self.low <= angle <= self.high

    def wrapped(self, angle: float) -> float:
        """Return an angle as the controller counts it."""
        return angle if self.limited else self.middle + math.remainder(angle - self.middle, self.width)

    @property
    def turn(self) -> float:
        """Width of a whole turn, which numbers of one place may differ by; infinite for an axis with limits."""
        return math.inf if self.limited else self.width

    def apart(self, one: float, other: float) -> float:
        """Return how far an angle is from another, signed."""
        return math.remainder(one - other, self.turn)

    def shorter_way(self, here: float, angle: float) -> float:
        """Return how far to go from here to an angle, whole turns not counted, where the stops let it."""
        way = math.remainder(angle - here, TURN_DEG)
        ways = (way, way - TURN_DEG, way + TURN_DEG)
        return next((one for one in ways if self.holds(here + one)), angle - here)

    def at_once(self, way: float) -> bool:
        """Return whether one position demand goes this way and no other."""
        return self.limited or abs(way) <= self.width / 2.0 - _MARGIN_DEG


@dataclass(frozen=True)
class LongTurn:
    """A turn that begins at ``rate`` (deg/s, signed) and ends by position; ``way`` in deg, ``acceleration`` deg/s2."""

    way: float
    rate: float
    acceleration: float

    @classmethod
    def of(cls, way: float, rate: float, acceleration: float) -> LongTurn:
        """Return the turn at most at ``rate``: it must come to rest within what is left at the hand-over."""
        free = abs(way) - HAND_OVER_DEG
        looks = acceleration * (math.sqrt(_LOOK_S**2 + 2.0 * free / acceleration) - _LOOK_S)
        fastest = min(rate, math.sqrt(2.0 * acceleration * _BRAKE_DEG), looks)
        return cls(way, math.copysign(fastest, way), acceleration)

    @property
    def up_s(self) -> float:
        """Time to full rate, second."""
        return abs(self.rate) / self.acceleration

    @property
    def hand_over_s(self) -> float:
        """Time from the beginning to the hand-over, second."""
        return (abs(self.way) - HAND_OVER_DEG) / abs(self.rate) + self.up_s / 2.0

    def done(self, after_s: float) -> float:
        """Return the way that is done at full rate ``after_s`` behind the beginning, degree."""
        return self.rate * (after_s - self.up_s / 2.0)

    def left_s(self, done: float) -> float:
        """Return the time to the hand-over from where ``done`` degrees of the way lie behind, second."""
        return (abs(self.way) - HAND_OVER_DEG - math.copysign(1.0, self.way) * done) / abs(self.rate)


def is_mode(answer: str, word: str) -> bool:
    """Return whether a mode reads back: the word or any beginning of it, as firmwares differ. Source: 4.7."""
    return bool(answer) and word.startswith(answer)


def read_interlock(reply: str) -> str:
    """Return the state of an interlock in capitals. Raises: ValueError. Source: public programs."""
    word = reply.upper()
    if word not in (OPEN, CLOSED, FAULT):
        raise ValueError("Open, Closed or Fault is due")
    return word


def read_absolute(reply: str) -> list[float]:
    """Return rate, acceleration, jerk, lowest and highest position, trips. Raises: ValueError. Source: 4.6.1."""
    values = [read_number(field.strip()) for field in reply.split(",")]
    if len(values) not in _ABSOLUTE_VALUES:
        raise ValueError("rate, acceleration, jerk, lowest and highest position and one or two trips are due")
    return values


def read_scaling(reply: str) -> tuple[float, float]:
    """Return width and middle of the range, deg: fields 1 and 3; field 2 is its factor, a turn or the range.

    Raises: ValueError. Source: 4.2.26.
    """
    fields = [field.strip().strip('"') for field in reply.split(",")]
    width, factor, middle = (read_number(field) for field in fields[:3])
    in_deg = factor in (TURN_DEG, width) and (fields[3:4] or ["deg"])[0].lower().startswith("deg")
    if not (width >= TURN_DEG and in_deg):
        raise ValueError("a range of at least 360, its factor 360 and offset, in deg, are due")
    return width, middle


def tells_of(axes: Sequence[int], at_rest_deg_s: float) -> Tells:
    """Return what replies say of a table: an axis whose interlock is closed may move, one that turns does."""
    rates = {f":read:rate? {axis}": Figure(f"rate of axis {axis}", "deg/s", read_number) for axis in axes}
    angles = {f":read:pos? {axis}": Figure(f"angle of axis {axis}", "deg", read_number) for axis in axes}
    closed = {f":int? {axis}": lambda reply: read_interlock(reply) == CLOSED for axis in axes}
    turns = {question: lambda reply: abs(read_number(reply)) > at_rest_deg_s for question in rates}
    return Tells({**closed, **turns}, {**rates, **angles})
