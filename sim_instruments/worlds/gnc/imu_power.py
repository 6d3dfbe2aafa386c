"""Power-on periods of a simulated module: how warm its own losses make it, and which turn-on bias it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS
from sim_instruments.worlds.gnc.imu_errors import WARM_UP_DEGC, WARM_UP_LAG_S

Float = NDArray[np.float64]
Int64 = NDArray[np.int64]


@dataclass(frozen=True)
class _Stretch:
    """From ``start_ns`` on the self-heating goes from ``start_degC`` to ``target_degC``; ``period`` counts from 0."""

    start_ns: int
    start_degC: float
    target_degC: float
    period: int


class PowerPeriods:
    """Times of power-on and power-off, given in order of time; before the first one the module is cold."""

    def __init__(self) -> None:
        self._stretches = [_Stretch(0, 0.0, 0.0, 0)]

    def on(self, t_ns: int) -> None:
        """Power comes on; each time but the first begins a new period."""
        self._begin(t_ns, WARM_UP_DEGC)

    def off(self, t_ns: int) -> None:
        """Power goes off: the module cools with the lag it warmed with."""
        self._begin(t_ns, 0.0)

    @property
    def first_ns(self) -> int:
        """Bench time of the first power-on, 0 before it."""
        return next((s.start_ns for s in self._stretches if s.target_degC > 0.0), 0)

    def rise_degC(self, t_ns: Int64) -> Float:
        """Self-heating above the surroundings at bench times (n,), degC."""
        starts = np.array([s.start_ns for s in self._stretches], np.int64)
        states = np.array([(s.start_degC, s.target_degC) for s in self._stretches])
        at = self._at(t_ns)
        first, last = states[at].T
        since_s = np.maximum(t_ns - starts[at], 0) / NS
        return np.asarray(last + (first - last) * np.exp(-since_s / WARM_UP_LAG_S))

    def period(self, t_ns: Int64) -> Int64:
        """Return number of the power-on period at bench times (n,), from 0."""
        return np.array([s.period for s in self._stretches], np.int64)[self._at(t_ns)]

    def _at(self, t_ns: Int64) -> Int64:
        starts = [s.start_ns for s in self._stretches]
        return np.maximum(np.searchsorted(starts, t_ns, side="right") - 1, 0)

    def _begin(self, t_ns: int, target_degC: float) -> None:
        last = self._stretches[-1]
        if target_degC == last.target_degC:
            return
        started = any(s.target_degC > 0.0 for s in self._stretches)
        period = last.period + 1 if started and target_degC > 0.0 else last.period
        rise_degC = float(self.rise_degC(np.array([t_ns]))[0])
        self._stretches.append(_Stretch(t_ns, rise_degC, target_degC, period))
