"""Reads a trend: least and greatest values over any window of a session, in as many points as a figure has room for."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.frame import Signal
from bench.model.arrays import Floats
from bench.model.errors import InputError
from bench.record.trend import (
    FOLDER,
    HEAD,
    LEVELS_S,
    TrendHead,
    TrendRows,
    TrendSource,
    concatenated,
    read_head,
    rows_of,
)

_GAP = 1.5  # of the time between two points


@dataclass(frozen=True)
class TrendWindow:
    """Points of some signals over a window, a row of NaN in each gap.

    ``t_utc_s``: (m,), starts of the buckets, or times of single readings where ``bucket_s`` is 0.
    ``low``, ``high``: (m, k), least and greatest value in the bucket, in the unit of each signal.
    """

    t_utc_s: Floats
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    bucket_s: float

    def to_bytes(self) -> bytes:
        """As the history endpoint sends it (docs/live-protocol.md)."""
        count, width = self.low.shape
        head = np.array([count, width], "<u4").tobytes() + np.array([self.bucket_s], "<f8").tobytes()
        span = np.stack((self.low, self.high), axis=2).astype("<f4")
        return head + self.t_utc_s.astype("<f8").tobytes() + span.tobytes()


class TrendReader:
    """The trend of a session; may be read while it is written.

    Args:   folder: of the session, or of the cache its trend was made in.
    Raises: InputError B-REC-030 if there is no trend.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / FOLDER
        head = read_head(self._folder)
        if head is None:
            raise InputError(
                "B-REC-030",
                "there is no trend of this session",
                where=str(self._folder / HEAD),
                next_step="'python -m bench.replay.build_trend SESSION FOLDER' makes one",
            )
        self.head: TrendHead = head
        self._place = {
            signal.name: (source, column) for source in head.sources for column, signal in enumerate(source.signals)
        }

    @property
    def signals(self) -> tuple[Signal, ...]:
        """All signals there are."""
        return self.head.signals

    def span_s(self) -> tuple[float, float] | None:
        """Begin of the first and end of the last second, UTC; None while there is nothing."""
        ends = []
        for source in self.head.sources:
            rows = self._rows(source, LEVELS_S[0])
            if len(rows):
                ends += [float(rows["t_utc_s"][0]), float(rows["t_utc_s"][-1]) + LEVELS_S[0]]
        return (min(ends), max(ends)) if ends else None

    def window(self, names: Sequence[str], t0_utc_s: float, t1_utc_s: float, n: int) -> TrendWindow:
        """The finest level that has at most ``n`` points in the window, or whole groups of the coarsest one.

        A source that comes less often than the others stands until its next row. Where nothing came, one row of NaN.
        Raises: InputError B-FRAME-024 for a signal that is not there.
        """
        columns: dict[TrendSource, list[tuple[int, int]]] = {}
        for place, name in enumerate(names):
            source, column = self._find(name)
            columns.setdefault(source, []).append((place, column))
        level_s = next((s for s in LEVELS_S if self._most(columns, s, t0_utc_s, t1_utc_s) <= n), LEVELS_S[-1])
        groups = -(-self._most(columns, level_s, t0_utc_s, t1_utc_s) // max(1, n)) if level_s == LEVELS_S[-1] else 1
        bucket_s = float(level_s * max(1, groups))
        parts = []
        for source, pairs in columns.items():
            rows = self._taken(source, [column for _, column in pairs], level_s, t0_utc_s, t1_utc_s)
            stands_s = max(bucket_s, _GAP * source.period_s if source.period_s > bucket_s else 0.0)
            parts.append(Part([place for place, _ in pairs], rows.merged(round(bucket_s)), stands_s))
        often_s = min((max(source.period_s, bucket_s) for source in columns), default=bucket_s)
        return joined(parts, len(names), bucket_s, _GAP * often_s)

    def _find(self, name: str) -> tuple[TrendSource, int]:
        if name not in self._place:
            raise InputError(
                "B-FRAME-024",
                f"there is no signal {name!r} in the trend of this session",
                where=str(self._folder),
                next_step=f"use one of: {', '.join(self._place)}",
            )
        return self._place[name]

    def _rows(self, source: TrendSource, level_s: int) -> NDArray[np.void]:
        return source.stored(source.path(self._folder, level_s))

    def _most(self, sources: dict[TrendSource, list[tuple[int, int]]], level_s: int, t0: float, t1: float) -> int:
        """Points that the fullest source has in a window."""
        between = (_between(self._rows(source, level_s), level_s, t0, t1) for source in sources)
        return max((each.stop - each.start for each in between), default=0)

    def _taken(self, source: TrendSource, columns: list[int], level_s: int, t0: float, t1: float) -> TrendRows:
        """Rows of one level; what it lacks at its end because a bucket is still open comes from the finest one."""
        block = self._rows(source, level_s)
        rows = rows_of(block[_between(block, level_s, t0, t1)], columns)
        if level_s == LEVELS_S[0]:
            return rows
        fine = self._rows(source, LEVELS_S[0])
        behind_s = float(block["t_utc_s"][-1]) + level_s if len(block) else t0
        if behind_s >= t1:
            return rows
        tail = rows_of(fine[_between(fine, 0, max(behind_s, t0 // level_s * level_s), t1)], columns)
        return concatenated((rows, tail.merged(level_s)))


def _between(rows: NDArray[np.void], level_s: float, t0: float, t1: float) -> slice:
    """Rows that have something of the window; few rows are touched."""
    start_s = rows["t_utc_s"]
    return slice(bisect_left(start_s, t0 - level_s + 1e-9), bisect_left(start_s, t1))


@dataclass(frozen=True)
class Part:
    """Rows of one source in a window: ``places`` of its columns, how long a row stands where others go on, second."""

    places: list[int]
    rows: TrendRows
    stands_s: float


def joined(parts: Sequence[Part], width: int, bucket_s: float, gap_s: float, ticks_s: int = 1) -> TrendWindow:
    """Rows of several sources on one axis, a row of NaN behind each row that nothing follows for ``gap_s``.

    ``ticks_s``: in how many parts of a second the starts of the rows are counted.
    """
    start = np.unique(np.concatenate([part.rows.start_s for part in parts] or [np.empty(0, np.int64)]))
    low = np.full((len(start), width), np.nan, np.float32)
    high = low.copy()
    for part in parts:
        if not len(part.rows):
            continue
        newest = np.searchsorted(part.rows.start_s, start, side="right") - 1
        age_s = (start - part.rows.start_s[np.maximum(newest, 0)]) / ticks_s
        stands = np.flatnonzero((newest >= 0) & (age_s < part.stands_s))
        at = np.ix_(stands, np.array(part.places))
        low[at], high[at] = part.rows.low[newest[stands]], part.rows.high[newest[stands]]
    t_utc_s = start / ticks_s
    gaps = np.flatnonzero(np.diff(t_utc_s) > gap_s) + 1
    between_s = t_utc_s[gaps - 1] + min(bucket_s or gap_s / 2, gap_s)
    blank = np.float32(np.nan)
    return TrendWindow(
        np.insert(t_utc_s, gaps, between_s),
        np.insert(low, gaps, blank, axis=0),
        np.insert(high, gaps, blank, axis=0),
        bucket_s,
    )
