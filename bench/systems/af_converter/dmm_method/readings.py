"""Readings of the current meter, sorted to the records they stand beside, to its zeros, and to the drift check.

A range that is set begins a new set of readings. What a set is for, the names of its loops say: ``zero_range`` a zero
with nothing connected, ``check_level`` the check of the calibrator before and after a campaign, neither a record.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import Reading
from bench.systems.af_converter.estimators.dmm_method import Meter
from bench.systems.af_converter.register import METER

if TYPE_CHECKING:
    from bench.record import RecordRow

CONFIGURE, MEASURE = "configure_current", "measure_current"
ZERO, CHECK = "zero_range_A", "check_level_A"
DISPLAY_PART = 1e-8  # of the range: a digit of the meter; readings that all agree are not without noise


@dataclass
class ReadingSet:
    """Readings on one range without a change of it; values in ampere."""

    range_A: float
    conditions: Mapping[str, Any]
    begin_s: float
    end_s: float
    values_A: list[float] = field(default_factory=list)

    @property
    def mean_A(self) -> float:
        """Mean of the readings."""
        return float(np.mean(self.values_A))

    @property
    def std_A(self) -> float:
        """Standard uncertainty of the mean by the scatter of the readings, at least a digit of the display."""
        digit_A = DISPLAY_PART * self.range_A
        scatter_A = float(np.std(self.values_A, ddof=1)) if len(self.values_A) > 1 else digit_A
        return max(scatter_A, digit_A) / math.sqrt(len(self.values_A))


def reading_sets(readings: Iterable[Reading]) -> list[ReadingSet]:
    """Sets in the order of time; a reading that was flagged (no value) is left out, an empty set too."""
    sets: list[ReadingSet] = []
    for reading in sorted(readings, key=lambda reading: reading.t_s):
        if reading.role != METER or not isinstance(reading.value, (int, float)) or not math.isfinite(reading.value):
            continue
        if reading.name == CONFIGURE:
            sets.append(ReadingSet(float(reading.value), dict(reading.conditions), reading.t_s, reading.t_s))
        elif reading.name == MEASURE and sets:
            sets[-1].values_A.append(float(reading.value))
            sets[-1].end_s = reading.t_s
    return [reading_set for reading_set in sets if reading_set.values_A]


class MeterLog:
    """Readings by record number. A record owns the last set taken between the end of the record before it and itself.

    So a record that was taken again owns the readings of the attempt that counts.
    """

    def __init__(self, rows: Sequence[RecordRow], readings: Iterable[Reading]) -> None:
        sets = reading_sets(readings)
        self._zeros = [reading_set for reading_set in sets if ZERO in reading_set.conditions]
        points = [reading_set for reading_set in sets if not {ZERO, CHECK} & reading_set.conditions.keys()]
        self._of: dict[int, ReadingSet] = {}
        before_s = -np.inf
        for row in sorted(rows, key=lambda row: row.window.t_start_ns):
            begin_s = 1e-9 * row.window.t_start_ns
            own = [point for point in points if before_s <= point.begin_s and point.end_s <= begin_s]
            if own:
                self._of[row.window.number] = own[-1]
            before_s = 1e-9 * row.window.t_end_ns

    def meter(self, numbers: Sequence[int]) -> Meter:
        """Return readings beside these records, minus the zero of their range; NaN for a record without any."""
        rows = [self._row(self._of.get(number)) for number in numbers]
        current_A, std_A, zero_std_A, range_A = np.array(rows, dtype=np.float64).reshape(-1, 4).T
        return Meter(current_A=current_A, std_A=std_A, zero_std_A=zero_std_A, range_A=range_A)

    def _row(self, own: ReadingSet | None) -> tuple[float, float, float, float]:
        if own is None:
            return (np.nan,) * 4
        zero = self._zero(own)
        if zero is None:
            return own.mean_A, own.std_A, np.nan, own.range_A
        return own.mean_A - zero.mean_A, own.std_A, zero.std_A, own.range_A

    def _zero(self, own: ReadingSet) -> ReadingSet | None:
        """Return the zero of a range last measured before a set, else the first after it."""
        same = [zero for zero in self._zeros if abs(zero.range_A - own.range_A) <= 1e-6 * own.range_A]
        earlier = [zero for zero in same if zero.end_s <= own.begin_s]
        return earlier[-1] if earlier else next(iter(same), None)

    @property
    def zeros_A(self) -> dict[float, tuple[float, float]]:
        """Last zero of each range with its standard uncertainty, ampere, for the report."""
        return {zero.range_A: (zero.mean_A, zero.std_A) for zero in self._zeros}
