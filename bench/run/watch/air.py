"""The air of a chamber held against its set-points: how far outside it is, how fast it moves away, how sensors differ.

Pure logic without a clock of its own: it is told every set-point that was sent and every reading that was taken.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from bench.model.clock import NS
from bench.plan import SetPoint

OWN, SECOND = "own", "second"  # the chamber's sensor, and an independent one
MARGIN_K = 2.0  # chambers of this class hold 0.5 K and overshoot a ramp by 1 to 2 K
COME_K = 1.0  # it has come to a set-point when its ramp is over and it is so near: more than it cycles
BACK_K = 0.5  # it is back when it is so much inside its margin again
MOST_OVERSHOOT_K = 5.0  # what leaves its set-point by more is not taken for an overshoot
OVERSHOOT_S = 900.0  # after the air came to a set-point; later nothing overshoots any more
RUNAWAY_TIMES = 3.0  # the planned rate
LEAST_RUNAWAY_DEGC_MIN = 4.0  # a cycle of 0.6 K in 90 s has 2.5, and a sensor that tells 0.1 K adds 0.6 in 10 s
UNPLANNED_DEGC_MIN = 5.0  # without a ramp a chamber goes as fast as it can
HALF_S = 4.5  # both halves of the time a rate is taken over: told within 20 s where a reading comes each 5 s
OLDEST_S = 600.0  # of a reading that a rate is taken from: in a rehearsal they come each minute or less often
APART_K = 5.0
APART_BACK_K = 4.0
FRESH_S = 45.0  # a reading that is older says nothing of now; less than a dwell, so one reading alone is no deviation


@dataclass
class _Sensor:
    """The newest readings of one sensor, oldest first."""

    readings: deque[tuple[int, float]] = field(default_factory=deque)

    def add(self, t_ns: int, degC: float) -> None:
        self.readings.append((t_ns, degC))
        while len(self.readings) > 3 and t_ns - self.readings[1][0] > 3.0 * HALF_S * NS:
            self.readings.popleft()

    def fresh_degC(self, t_ns: int) -> float:
        """Return the newest reading, NaN if there is none or it is old."""
        if not self.readings or t_ns - self.readings[-1][0] > FRESH_S * NS:
            return math.nan
        return self.readings[-1][1]

    def rates_degC_min(self) -> tuple[float, float, float] | None:
        """Return how fast it changed in the older half, in the newer one, and in both; None: not known."""
        last = self.readings[-1] if self.readings else None
        middle = None if last is None else self._before(last)
        first = None if middle is None else self._before(middle)
        if last is None or middle is None or first is None or last[0] - first[0] > OLDEST_S * NS:
            return None
        return _slope(first, middle), _slope(middle, last), _slope(first, last)

    def _before(self, reading: tuple[int, float]) -> tuple[int, float] | None:
        """Return the newest reading that is older by ``HALF_S`` at least."""
        return next((known for known in reversed(self.readings) if reading[0] - known[0] >= HALF_S * NS), None)


def _slope(first: tuple[int, float], last: tuple[int, float]) -> float:
    return (last[1] - first[1]) / ((last[0] - first[0]) / NS / 60.0)


class ChamberAir:
    """The air between the last set-point and the next; once it has come to the next, it has to stay there.

    ``target_degC`` is the next set-point, NaN while the chamber has none; ``overshoot_K`` the largest one so far.
    """

    def __init__(self) -> None:
        self.target_degC = math.nan
        self.overshoot_K = 0.0
        self._ramp_degC_min = 0.0
        self._sensors = {OWN: _Sensor(), SECOND: _Sensor()}
        self._low_degC = self._high_degC = math.nan
        self._planned_degC_min = 0.0  # the fastest the air may follow: of its ramps since it came to a set-point last
        self._direction = 0.0  # towards the set-point; 0 until it is known where the air comes from
        self._due_ns = 0  # the ramp is over
        self._came_ns: int | None = None
        self._is_away = False  # it had come, and has left again
        self._peak_K = 0.0

    def set_point(self, t_ns: int, asked: SetPoint) -> None:
        """A set-point was sent: the air may be anywhere between where it is, the last set-point and this one."""
        degC = [self.target_degC, asked.temperature_degC, self.air_degC(t_ns)]
        if self._came_ns is None:  # it was still on its way to the last one
            degC += [self._low_degC, self._high_degC]
        known = [edge for edge in degC if math.isfinite(edge)]
        ramp_degC_min = asked.ramp_degC_min or UNPLANNED_DEGC_MIN
        self._planned_degC_min = max(self._planned_degC_min, ramp_degC_min)  # the air goes on as before for a while
        self.target_degC, self._ramp_degC_min = asked.temperature_degC, ramp_degC_min
        self._low_degC, self._high_degC = min(known), max(known)
        self._came_ns, self._is_away, self._peak_K, self._direction = None, False, 0.0, 0.0
        self._begin(t_ns, self.air_degC(t_ns))

    def forget(self) -> None:
        """The chamber was stopped or put on hold: it has no set-point any more."""
        self.target_degC = self._low_degC = self._high_degC = math.nan
        self._came_ns = None

    def take(self, t_ns: int, sensor: str, degC: float) -> None:
        """A sensor says so; what is no number is no reading."""
        if not math.isfinite(degC):
            return
        self._sensors[sensor].add(t_ns, degC)
        if sensor == OWN and math.isfinite(self.target_degC):
            self._follow(t_ns, degC)

    def air_degC(self, t_ns: int) -> float:
        """Return the newest reading of the chamber's own sensor, else of the other; NaN if both are old."""
        own_degC = self._sensors[OWN].fresh_degC(t_ns)
        return own_degC if math.isfinite(own_degC) else self._sensors[SECOND].fresh_degC(t_ns)

    def reading_degC(self, t_ns: int, sensor: str) -> float:
        """Return the newest reading of a sensor, NaN if it is old."""
        return self._sensors[sensor].fresh_degC(t_ns)

    @property
    def runaway_limit_degC_min(self) -> float:
        """How fast the air may move away from its set-point: three times the fastest ramp it may follow."""
        return max(RUNAWAY_TIMES * self._planned_degC_min, LEAST_RUNAWAY_DEGC_MIN)

    def margin_K(self, t_ns: int) -> float:
        """Return how far the air may be outside: 2 K, or by how much it has overshot; what it does now counts too."""
        if self._overshoots(t_ns, self.air_degC(t_ns)):
            return MOST_OVERSHOOT_K
        return max(MARGIN_K, self.overshoot_K)

    def outside_K(self, t_ns: int) -> float:
        """Return how far the air is outside its set-points, K, negative inside; NaN if either is not known."""
        degC = self.air_degC(t_ns)
        return max(self._low_degC - degC, degC - self._high_degC)

    def runaway_degC_min(self, t_ns: int, sensor: str) -> float:
        """Return how fast a sensor moves away from the set-point, by its last readings; NaN: not known.

        Both halves of them have to show half of it at least, else the slower one counts: a wild reading is no runaway.
        """
        degC, rates = self._sensors[sensor].fresh_degC(t_ns), self._sensors[sensor].rates_degC_min()
        if rates is None or not math.isfinite(degC) or not math.isfinite(self.target_degC):
            return math.nan
        away = math.copysign(1.0, degC - self.target_degC)
        older, newer, both = (away * rate for rate in rates)
        slower = min(older, newer)
        return both if slower >= 0.5 * both else slower

    def apart_K(self, t_ns: int) -> float:
        """Return how much the two sensors differ, K; NaN if one of them says nothing."""
        return abs(self._sensors[OWN].fresh_degC(t_ns) - self._sensors[SECOND].fresh_degC(t_ns))

    def _overshoots(self, t_ns: int, degC: float) -> bool:
        """Return whether the air has just come to its set-point and is behind it, as seen from where it came from."""
        just_came = self._came_ns is not None and t_ns - self._came_ns <= OVERSHOOT_S * NS
        return just_came and self._direction * (degC - self.target_degC) > 0.0

    def _begin(self, t_ns: int, degC: float) -> None:
        """Note where the air comes from, as soon as it is known, and when its ramp is over."""
        if math.isfinite(degC):
            self._low_degC, self._high_degC = min(self._low_degC, degC), max(self._high_degC, degC)
            self._direction = math.copysign(1.0, self.target_degC - degC)
            self._due_ns = t_ns + round(abs(self.target_degC - degC) / self._ramp_degC_min * 60.0 * NS)

    def _follow(self, t_ns: int, degC: float) -> None:
        """Note that the air has come to its set-point or has left it, and by how much it overshoots."""
        if not self._direction:
            self._begin(t_ns, degC)
        beyond_K = self._direction * (degC - self.target_degC)
        if self._came_ns is None or self._is_away:
            is_there = abs(beyond_K) <= COME_K and t_ns >= self._due_ns
            if is_there or beyond_K > 0.0:
                if self._is_away:  # it comes back as fast as the chamber can, whatever ramp was planned
                    self._planned_degC_min = UNPLANNED_DEGC_MIN
                self._came_ns, self._is_away = t_ns, False
                self._low_degC = self._high_degC = self.target_degC
        elif self._overshoots(t_ns, degC):
            self._peak_K = max(self._peak_K, beyond_K)
        elif abs(beyond_K) > MARGIN_K:
            self._is_away, self._peak_K = True, 0.0
            self._direction = -math.copysign(1.0, degC - self.target_degC)
        elif t_ns - self._came_ns > OVERSHOOT_S * NS:
            self._planned_degC_min = self._ramp_degC_min
        if self.overshoot_K < self._peak_K <= MOST_OVERSHOOT_K and abs(beyond_K) < MARGIN_K - BACK_K:
            self.overshoot_K = self._peak_K
