"""Temperatures of the bench as a trend: a reading or a set-point stands until the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bench.frame import BENCH_FIELDS
from bench.model.clock import NS
from bench.model.events import Environment, Event, Reentry
from bench.record.trend_format import HELD_S
from bench.record.trend_rows import TrendRows

_AIR, _UNIT, _SETPOINT = range(len(BENCH_FIELDS))


class BenchRows:
    """Rows of the bench, one a second of UTC, from what happens on it. Times are UTC in ns."""

    def __init__(self) -> None:
        self._next_s = -1  # start of the bucket that is open, -1 before anything is known
        self._values = [math.nan] * len(BENCH_FIELDS)
        self._until_s = [math.inf] * len(BENCH_FIELDS)
        self._low = np.full(len(BENCH_FIELDS), np.nan, np.float32)
        self._high = self._low.copy()

    def event(self, event: Event, t_utc_ns: int) -> TrendRows | None:
        """Something happened; rows that are complete before it."""
        if isinstance(event, Environment):
            readings = {_AIR: event.air_degC, _UNIT: event.unit_degC}
            known = {column: value for column, value in readings.items() if value is not None}
            return self._set(t_utc_ns, known, HELD_S) if known else None
        if isinstance(event, Reentry) and event.target_degC is not None:
            return self.setpoint(t_utc_ns, event.target_degC)
        return None

    def setpoint(self, t_utc_ns: int, value_degC: float) -> TrendRows | None:
        """The chamber has been given another temperature; rows that are complete before it."""
        return self._set(t_utc_ns, {_SETPOINT: value_degC}, math.inf)

    def advance(self, t_utc_ns: int) -> TrendRows | None:
        """Rows of all seconds that are over."""
        second = (t_utc_ns - 1) // NS
        if self._next_s < 0 or second <= self._next_s:
            return None
        start_s = np.arange(self._next_s, second)
        low = np.empty((len(start_s), len(self._values)), np.float32)
        for column, value in enumerate(self._values):
            low[:, column] = np.where(start_s <= self._until_s[column], value, np.nan)
        high = low.copy()
        low[0], high[0] = self._low, self._high
        held = np.where(second <= np.array(self._until_s), self._values, np.nan).astype(np.float32)
        self._next_s, self._low, self._high = second, held, held.copy()
        return TrendRows(start_s, low, high)

    def end(self, t_utc_ns: int) -> TrendRows | None:
        """All rows up to now, the second that is not over included."""
        return self.advance(t_utc_ns + NS)

    def _set(self, t_utc_ns: int, values: Mapping[int, float], stands_s: float) -> TrendRows | None:
        rows = self.advance(t_utc_ns)
        self._next_s = (t_utc_ns - 1) // NS if self._next_s < 0 else self._next_s
        for column, value in values.items():
            self._values[column] = value
            self._until_s[column] = self._next_s + stands_s
            self._low[column] = np.fmin(self._low[column], np.float32(value))
            self._high[column] = np.fmax(self._high[column], np.float32(value))
        return rows
