"""Temperatures of the simulated bench in closed form: chamber set-point ramp, air with a lag, unit with a lag.

Between two commands the set-point is a straight line, so air and unit are sums of a line and two exponentials.
Each command starts a new segment from the state the last one has reached; nothing is integrated step by step.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from bench.model.clock import NS

AIR_LAG_S = 120.0  # air behind the controller's set-point
UNIT_LAG_S = 1500.0  # unit under test behind the air, 25 min
IDLE_LAG_S = 2400.0  # chamber switched off: air towards the laboratory's temperature
START_DEGC = 23.0
LAB_DEGC = 23.0
_LAB_SWING_DEGC = 0.3
_DAY_S = 86_400.0


@dataclass(frozen=True)
class _Segment:
    """From ``start_ns`` on: set-point level + slope * t, air and unit as lines with exponentials (t from start)."""

    start_ns: int
    setpoint_degC: float
    slope_degC_s: float
    air_lag_s: float
    air_degC: float
    unit_degC: float

    def coefficients(self) -> tuple[float, ...]:
        air_line = self.setpoint_degC - self.slope_degC_s * self.air_lag_s
        air_decay = self.air_degC - air_line
        unit_line = air_line - self.slope_degC_s * UNIT_LAG_S
        unit_decay = air_decay / (1.0 - UNIT_LAG_S / self.air_lag_s)
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


class Thermal:
    """Chamber air and unit temperature as functions of time; commands may only be given in order of time."""

    def __init__(self) -> None:
        self._segments = [_Segment(0, START_DEGC, 0.0, AIR_LAG_S, START_DEGC, START_DEGC)]
        self._lock = threading.Lock()
        self._tables = self._tabulate()

    def ramp(self, target_degC: float, rate_degC_min: float, t_ns: int) -> None:
        """Let the controller's set-point go to ``target_degC`` at ``rate_degC_min`` (> 0) from where the air is."""
        start_degC = self.setpoint_degC(t_ns)
        slope = np.copysign(rate_degC_min / 60.0, target_degC - start_degC)
        ramp_s = abs(target_degC - start_degC) / abs(slope)
        self._begin(t_ns, start_degC, float(slope), AIR_LAG_S)
        self._begin(t_ns + round(ramp_s * NS), target_degC, 0.0, AIR_LAG_S)

    def hold(self, t_ns: int) -> None:
        """Freeze the set-point where the ramp is now."""
        self._begin(t_ns, self.setpoint_degC(t_ns), 0.0, AIR_LAG_S)

    def stop(self, t_ns: int) -> None:
        """Switch heating and cooling off: the air drifts to the laboratory's temperature."""
        self._begin(t_ns, LAB_DEGC, 0.0, IDLE_LAG_S)

    def setpoint_degC(self, t_ns: int) -> float:
        """Present set-point of the ramp, degC; the air temperature itself while the chamber is off."""
        segment = self._at(t_ns)
        if segment.air_lag_s == IDLE_LAG_S:
            return float(self.air_degC(t_ns))
        return segment.setpoint_degC + segment.slope_degC_s * (t_ns - segment.start_ns) / NS

    def air_degC(self, t_ns: int | np.ndarray) -> np.ndarray:
        """Chamber air at ``t_ns`` (bench clock, scalar or any shape), degC."""
        t_s, (slope, lag, line, decay, _, _, _) = self._elapsed(t_ns)
        return line + slope * t_s + decay * np.exp(-t_s / lag)

    def unit_degC(self, t_ns: int | np.ndarray) -> np.ndarray:
        """Unit under test at ``t_ns`` (bench clock, scalar or any shape), degC."""
        t_s, (slope, lag, _, _, line, fast, slow) = self._elapsed(t_ns)
        return line + slope * t_s + fast * np.exp(-t_s / lag) + slow * np.exp(-t_s / UNIT_LAG_S)

    @staticmethod
    def lab_degC(t_ns: int | np.ndarray) -> np.ndarray:
        """Laboratory air: 23 degC with a daily swing of 0.3 degC."""
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
            self._segments = [*kept, _Segment(t_ns, setpoint_degC, slope_degC_s, air_lag_s, air, unit)]
            self._tables = self._tabulate()

    def _tabulate(self) -> tuple[np.ndarray, np.ndarray]:
        rows = np.array([segment.coefficients() for segment in self._segments])
        return np.array([s.start_ns for s in self._segments], np.int64), rows[:, 1:].T.copy()

    def _elapsed(self, t_ns: int | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        starts, columns = self._tables
        t_ns = np.asarray(t_ns, np.int64)
        index = np.maximum(np.searchsorted(starts, t_ns, side="right") - 1, 0)
        return (t_ns - starts[index]) / NS, columns[:, index]
