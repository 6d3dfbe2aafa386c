"""Temperatures of the simulated bench in closed form: set-point ramp, air with a lag, unit with a lag, its play.

Between two commands the set-point is a straight line, so air and unit are sums of a line and two exponentials.
Each command starts a new segment from the state the last one has reached; nothing is integrated step by step.

A unit that remembers where its temperature has turned (hysteresis) finds the turning points here, exactly, for the play
(backlash) operator. A play of half-width r follows a rising input r behind and a falling one r ahead, and rests while
the input crosses 2r after a turn. On a stretch without a turn the result depends on the end of the stretch only, so a
history is the list of its turning points and nothing is sampled.
Source: Krasnosel'skii and Pokrovskii, Systems with Hysteresis, section 2 (definition on piecewise monotone inputs).
"""

from __future__ import annotations

import bisect
import itertools
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS

_Tables = tuple[Integers, Floats]
_Moments = tuple[list[int], list[tuple[float, ...]]]

AIR_LAG_S = 120.0  # air behind the controller's set-point
UNIT_LAG_S = 1500.0  # unit under test behind the air, 25 min
IDLE_LAG_S = 2400.0  # chamber switched off: air towards the laboratory's temperature
START_DEGC = 23.0
LAB_DEGC = 23.0
_LAB_SWING_DEGC = 0.3
_DAY_S = 86_400.0
_SETTLED_S = 1e6  # after so long without a command nothing moves any more
_BISECTIONS = 64


@dataclass(frozen=True)
class _Segment:
    """From ``start_ns`` on: set-point level + slope * t, air and unit as lines with exponentials (t from start)."""

    start_ns: int
    setpoint_degC: float
    slope_degC_s: float
    air_lag_s: float
    unit_lag_s: float
    air_degC: float
    unit_degC: float

    def coefficients(self) -> tuple[float, ...]:
        air_line = self.setpoint_degC - self.slope_degC_s * self.air_lag_s
        air_decay = self.air_degC - air_line
        unit_line = air_line - self.slope_degC_s * self.unit_lag_s
        unit_decay = air_decay / (1.0 - self.unit_lag_s / self.air_lag_s)
        return (
            float(self.start_ns),
            self.slope_degC_s,
            self.air_lag_s,
            air_line,
            air_decay,
            unit_line,
            unit_decay,
            self.unit_degC - unit_line - unit_decay,
        )

    def turns_s(self, length_s: float) -> list[float]:
        """Return when the unit's temperature turns, seconds from the start, below ``length_s``: it equals the air's.

        Their difference is a constant and two exponentials, so it has one extreme at most and one zero on either side.
        """
        _, slope, air_lag_s, _, air_decay, _, fast, slow = self.coefficients()
        unit_lag_s = self.unit_lag_s
        rate, decay = 1.0 / air_lag_s - 1.0 / unit_lag_s, air_decay - fast

        def above_unit(t_s: float) -> float:
            return slope * unit_lag_s + decay * math.exp(-t_s / air_lag_s) - slow * math.exp(-t_s / unit_lag_s)

        ratio = decay * unit_lag_s / (slow * air_lag_s) if slow else 0.0
        extreme_s = math.log(ratio) / rate if ratio > 0.0 else 0.0
        knots = [0.0, *([extreme_s] if 0.0 < extreme_s < length_s else []), length_s]
        pairs = itertools.pairwise(knots)
        return [_zero(above_unit, *pair) for pair in pairs if above_unit(pair[0]) * above_unit(pair[1]) < 0.0]


def _zero(function: Callable[[float], float], low: float, high: float) -> float:
    """Return zero of a function that changes its sign between two places."""
    falls = function(low) > 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if (function(middle) > 0.0) == falls else (low, middle)
    return 0.5 * (low + high)


class Thermal:
    """Chamber air and unit temperature as functions of time; commands may only be given in order of time.

    ``time_constants`` divides all lags, so that a short campaign can wait for a temperature; ``unit_lag_s`` is what is
    left of the unit's, which is ``unit_lag`` times the usual one.
    """

    def __init__(self, time_constants: float = 1.0, unit_lag: float = 1.0) -> None:
        self.unit_lag_s = UNIT_LAG_S * unit_lag / time_constants
        self._air_lag_s, self._idle_lag_s = AIR_LAG_S / time_constants, IDLE_LAG_S / time_constants
        self._segments = [_Segment(0, START_DEGC, 0.0, self._air_lag_s, self.unit_lag_s, START_DEGC, START_DEGC)]
        self._lock = threading.Lock()
        self._tables, self._moments = self._tabulate()
        self._turns: tuple[list[int], tuple[float, ...]] = ([0], (START_DEGC,))

    def ramp(self, target_degC: float, rate_degC_min: float, t_ns: int) -> None:
        """Let the controller's set-point go to ``target_degC`` at ``rate_degC_min`` (> 0) from where the air is."""
        start_degC = self.setpoint_degC(t_ns)
        slope = np.copysign(rate_degC_min / 60.0, target_degC - start_degC)
        ramp_s = abs(target_degC - start_degC) / abs(slope)
        self._begin(t_ns, start_degC, float(slope), self._air_lag_s)
        self._begin(t_ns + round(ramp_s * NS), target_degC, 0.0, self._air_lag_s)

    def hold(self, t_ns: int) -> None:
        """Freeze the set-point where the ramp is now."""
        self._begin(t_ns, self.setpoint_degC(t_ns), 0.0, self._air_lag_s)

    def stop(self, t_ns: int) -> None:
        """Switch heating and cooling off: the air drifts to the laboratory's temperature."""
        self._begin(t_ns, LAB_DEGC, 0.0, self._idle_lag_s)

    def run_away(self, rate_degC_min: float, t_ns: int) -> None:
        """Let the air itself rise (or fall) at a rate from now on, as with a control loop that is broken."""
        slope = rate_degC_min / 60.0
        ahead_degC = float(self.air_degC(t_ns)) + slope * self._air_lag_s
        self._begin(t_ns, ahead_degC, slope, self._air_lag_s)

    def setpoint_degC(self, t_ns: int) -> float:
        """Return present set-point of the ramp, degC; the air temperature itself while the chamber is off."""
        segment = self._at(t_ns)
        if segment.air_lag_s == self._idle_lag_s:
            return float(self.air_degC(t_ns))
        return segment.setpoint_degC + segment.slope_degC_s * (t_ns - segment.start_ns) / NS

    def air_degC(self, t_ns: int | np.ndarray) -> np.ndarray:
        """Return chamber air at ``t_ns`` (bench clock, scalar or any shape), degC."""
        t_s, (slope, lag, line, decay, _, _, _) = self._elapsed(t_ns)
        return line + slope * t_s + decay * np.exp(-t_s / lag)

    def unit_degC(self, t_ns: int | np.ndarray) -> np.ndarray:
        """Return unit under test at ``t_ns`` (bench clock, scalar or any shape), degC."""
        t_s, (slope, lag, _, _, line, fast, slow) = self._elapsed(t_ns)
        return line + slope * t_s + fast * np.exp(-t_s / lag) + slow * np.exp(-t_s / self.unit_lag_s)

    def unit_moment(self, t_ns: int) -> tuple[float, float]:
        """Return unit under test at one bench time, degC, and how fast it warms, degC per second.

        What it will be told later does not enter.
        """
        starts_ns, coefficients = self._moments
        at = max(bisect.bisect_right(starts_ns, t_ns) - 1, 0)
        slope, lag, _, _, line, fast, slow = coefficients[at]
        t_s = (t_ns - starts_ns[at]) / NS
        fast, slow = fast * math.exp(-t_s / lag), slow * math.exp(-t_s / self.unit_lag_s)
        return line + slope * t_s + fast + slow, slope - fast / lag - slow / self.unit_lag_s

    def turns_degC(self, t_ns: int) -> tuple[float, ...]:
        """Return temperatures of the unit at its start and where it may have turned up to ``t_ns``, oldest first."""
        times_ns, degC = self._turns
        return degC[: bisect.bisect_right(times_ns, t_ns)]

    def play_offset_degC(self, t_ns: Integers, half_width_degC: ArrayLike) -> Floats:
        """Play operator of the unit's temperature minus that temperature, degC: +-half-width on a long branch.

        ``t_ns`` is (n,), bench clock; ``half_width_degC`` is () or (n,).
        """
        t_ns = np.asarray(t_ns, np.int64)
        half_width = np.broadcast_to(np.asarray(half_width_degC, float), t_ns.shape)
        times_ns, degC = self._turns
        state = np.empty(t_ns.shape)
        for count in np.unique(last := np.searchsorted(times_ns, t_ns, side="right")):
            state[last == count] = play_after(degC[:count], half_width[last == count])
        unit = self.unit_degC(t_ns)
        return follow(state, unit, half_width) - unit

    @staticmethod
    def lab_degC(t_ns: int | np.ndarray) -> np.ndarray:
        """Return laboratory air: 23 degC with a daily swing of 0.3 degC."""
        return LAB_DEGC + _LAB_SWING_DEGC * np.sin(2.0 * np.pi * np.asarray(t_ns, float) / NS / _DAY_S)

    def _at(self, t_ns: int) -> _Segment:
        with self._lock:
            segments = self._segments
        return next((s for s in reversed(segments) if s.start_ns <= t_ns), segments[0])

    def _begin(self, t_ns: int, setpoint_degC: float, slope_degC_s: float, air_lag_s: float) -> None:
        """Start a segment at ``t_ns``; what was planned for later (the end of a ramp) is dropped."""
        air, unit = float(self.air_degC(t_ns)), float(self.unit_degC(t_ns))
        with self._lock:
            kept = [s for s in self._segments if s.start_ns < t_ns]
            segment = _Segment(t_ns, setpoint_degC, slope_degC_s, air_lag_s, self.unit_lag_s, air, unit)
            self._segments = [*kept, segment]
            self._tables, self._moments = self._tabulate()
        self._turns = self._find_turns()

    def _find_turns(self) -> tuple[list[int], tuple[float, ...]]:
        """Return times and temperatures: the start of every segment (a turn or not) and every turn inside one."""
        ends_ns = [s.start_ns for s in self._segments[1:]] + [self._segments[-1].start_ns + round(_SETTLED_S * NS)]
        times_ns = []
        for segment, end_ns in zip(self._segments, ends_ns, strict=True):
            inside = segment.turns_s((end_ns - segment.start_ns) / NS)
            times_ns += [segment.start_ns, *(segment.start_ns + round(t_s * NS) for t_s in inside)]
        return times_ns, tuple(self.unit_degC(np.array(times_ns)).tolist())

    def _tabulate(self) -> tuple[_Tables, _Moments]:
        """Return starts of the segments and their coefficients, (7, segments): as arrays and as plain numbers."""
        starts_ns = [segment.start_ns for segment in self._segments]
        rows = [segment.coefficients()[1:] for segment in self._segments]
        return (np.array(starts_ns, np.int64), np.array(rows).T.copy()), (starts_ns, rows)

    def _elapsed(self, t_ns: int | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return seconds since the start of each time's segment, and the segments' coefficients, (7, ...)."""
        starts, columns = self._tables
        t_ns = np.asarray(t_ns, np.int64)
        index = np.maximum(np.searchsorted(starts, t_ns, side="right") - 1, 0)
        if index.size > 1 and index.min() == (last := index.max()):
            return (t_ns - starts[last]) / NS, columns[:, last]
        return (t_ns - starts[index]) / NS, columns[:, index]


class PlaceInAir:
    """The temperature of a unit at its place in the chamber: ``share`` times that of ``thermal``, and an offset."""

    def __init__(self, thermal: Thermal, share: float, offset_degC: float) -> None:
        self._thermal, self._share, self._offset_degC = thermal, share, offset_degC

    @property
    def unit_lag_s(self) -> float:
        """Return how far the unit lags behind the air, second."""
        return self._thermal.unit_lag_s

    def unit_degC(self, t_ns: int | np.ndarray) -> np.ndarray:
        """Return temperature at bench times, degC."""
        return self._share * self._thermal.unit_degC(t_ns) + self._offset_degC

    def play_offset_degC(self, t_ns: Integers, half_width_degC: ArrayLike) -> Floats:
        """Return play operator minus the temperature, degC; a scaled input has a play of scaled width."""
        own = np.asarray(half_width_degC, float) / self._share
        return self._share * self._thermal.play_offset_degC(t_ns, own)

    def unit_moment(self, t_ns: int) -> tuple[float, float]:
        """Return temperature at one bench time, degC, and how fast it rises, degC per second."""
        degC, rate_degC_s = self._thermal.unit_moment(t_ns)
        return self._share * degC + self._offset_degC, self._share * rate_degC_s

    def turns_degC(self, t_ns: int) -> tuple[float, ...]:
        """Return temperatures at its start and where it may have turned up to ``t_ns``, oldest first."""
        return tuple(self._share * degC + self._offset_degC for degC in self._thermal.turns_degC(t_ns))


ThermalOfUnit = Thermal | PlaceInAir


class SharedAir(Thermal):
    """The chamber of several units: what it is told moves the air of all of them.

    Args: time_constants: as of ``Thermal``.   places: of the units.
    """

    def __init__(self, time_constants: float, places: Sequence[Thermal]) -> None:
        self._places = places
        super().__init__(time_constants)

    def _begin(self, t_ns: int, setpoint_degC: float, slope_degC_s: float, air_lag_s: float) -> None:
        super()._begin(t_ns, setpoint_degC, slope_degC_s, air_lag_s)
        for place in self._places:
            place._begin(t_ns, setpoint_degC, slope_degC_s, air_lag_s)


def play_after(turns_degC: Sequence[float], half_width_degC: ArrayLike) -> Floats:
    """Return state of the plays after a history that starts relaxed; half-widths of any shape, degC."""
    half_width = np.asarray(half_width_degC, float)
    state = np.full(half_width.shape, turns_degC[0])
    for degC in turns_degC[1:]:
        state = follow(state, degC, half_width)
    return state


def follow(state_degC: ArrayLike, degC: ArrayLike, half_width_degC: ArrayLike) -> Floats:
    """Return state after the input has gone to ``degC`` without a turn on the way; the arguments broadcast."""
    return np.minimum(np.maximum(state_degC, np.subtract(degC, half_width_degC)), np.add(degC, half_width_degC))
