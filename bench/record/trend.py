"""The trend of a session while it grows: rows of 1 s, and of those rows of 10 s and 100 s, appended to files.

Links bring rows of their frames; of the bench a reading or a set-point of a temperature stands until the next one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench.frame import BENCH_FIELDS
from bench.model.clock import NS
from bench.model.events import Environment, Event, Reentry
from bench.record.files import AppendFile, Files, OsFiles, write_all
from bench.record.trend_rows import (
    FOLDER,
    HEAD,
    HELD_S,
    LEVELS_S,
    TrendHead,
    TrendRows,
    TrendSource,
    concatenated,
    read_head,
    rows_of,
    write_head,
)

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
        if isinstance(event, Environment) and event.uut is None:
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


def to_bytes(rows: TrendRows, source: TrendSource) -> bytes:
    """Rows as they lie in a file."""
    block = np.empty(len(rows), source.row_type)
    block["t_utc_s"] = rows.start_s
    block["span"][:, :, 0] = rows.low
    block["span"][:, :, 1] = rows.high
    return block.tobytes()


class _Level:
    """Rows of one length of bucket of one source; the newest stays open until a later one begins."""

    def __init__(self, path: Path, source: TrendSource, period_s: int, files: Files) -> None:
        self.above: _Level | None = None
        self._path = path
        self._source = source
        self._period_s = period_s
        self._open: TrendRows | None = None
        size = path.stat().st_size if path.exists() else 0
        self._pending: list[bytes] = []
        self._file: AppendFile = files.append(path)
        if torn := size % source.row_type.itemsize:
            self._file.truncate(size - torn)

    def last_s(self) -> int | None:
        """Start of the newest bucket in the file."""
        rows = self._source.stored(self._path)
        return int(rows["t_utc_s"][-1]) if len(rows) else None

    def since(self, start_s: int) -> TrendRows:
        """Return rows of the file from a time on."""
        rows = self._source.stored(self._path)
        return rows_of(rows[np.searchsorted(rows["t_utc_s"], start_s) :])

    def feed(self, rows: TrendRows) -> None:
        """Take rows of the level below; those of the newest bucket wait for more."""
        merged = (rows if self._open is None else concatenated((self._open, rows))).merged(self._period_s)
        self._open = merged.cut(len(merged) - 1)
        if len(merged) > 1:
            self._emit(merged.cut(0, len(merged) - 1))

    def end(self) -> None:
        """Nothing more comes: the open bucket counts as it is."""
        if self._open is not None:
            self._emit(self._open)
            self._open = None
        if self.above is not None:
            self.above.end()

    def take(self) -> bytes:
        """Return what waits to be written; it is the caller's now."""
        block = b"".join(self._pending)
        self._pending.clear()
        return block

    def write(self, block: bytes) -> None:
        """Hand rows to the operating system. Raises: OSError."""
        write_all(self._file, block)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _emit(self, rows: TrendRows) -> None:
        self._pending.append(to_bytes(rows, self._source))
        if self.above is not None:
            self.above.feed(rows)


class TrendWriter:
    """Writes the trend of one part of a session into ``folder``/trend; going on behind what is there.

    Rows never go backwards: where UTC is behind the last row, ``offset_ns`` puts this part behind it.

    One thread may add while another one hands over.

    Args:   folder: of the session, or of a cache.   sources: what to write; a trend that is there keeps its own.
            t_mono_ns, t_utc_ns: begin of this part by both clocks.
    Raises: OSError if the disk refuses.
    """

    def __init__(
        self, folder: Path, sources: Sequence[TrendSource], t_mono_ns: int, t_utc_ns: int, files: Files | None = None
    ) -> None:
        self._folder = folder / FOLDER
        self._folder.mkdir(parents=True, exist_ok=True)
        before = read_head(self._folder)
        self.sources = {source.name: source for source in (before.sources if before else sources)}
        if before is None:
            for path in self._folder.glob("*s"):  # of a trend that was given up
                path.unlink()
        self._waiting: dict[str, list[TrendRows]] = {name: [] for name in self.sources}
        used = files or OsFiles()
        self._levels = {name: self._opened(source, used) for name, source in self.sources.items()}
        last_s = max((level[0].last_s() or 0 for level in self._levels.values()), default=0)
        self.offset_ns = max(t_utc_ns, last_s * NS + 1) - t_mono_ns
        offsets_ns = (*(before.offsets_ns if before else ()), self.offset_ns)
        write_head(self._folder, TrendHead(tuple(self.sources.values()), offsets_ns))

    def _opened(self, source: TrendSource, files: Files) -> list[_Level]:
        """Levels of one source, finest first; a coarse one that is behind is made complete from the finer one."""
        levels = [_Level(source.path(self._folder, period_s), source, period_s, files) for period_s in LEVELS_S]
        for finer, level, period_s in zip(levels[:-1], levels[1:], LEVELS_S[1:], strict=True):
            last_s = level.last_s()
            rows = finer.since(0 if last_s is None else last_s + period_s)
            if len(rows):
                level.feed(rows)
                level.write(level.take())
        for finer, level in pairwise(levels):
            finer.above = level
        return levels

    def add(self, source: str, rows: TrendRows | None) -> None:
        """Take the next rows of a source, one a second."""
        if rows is not None and len(rows):
            self._waiting[source].append(rows)

    def take(self) -> list[tuple[_Level, bytes]]:
        """Return what is complete, for ``hand_over``; quick, unlike that."""
        self._feed()
        return [(level, block) for levels in self._levels.values() for level in levels if (block := level.take())]

    def hand_over(self, taken: Sequence[tuple[_Level, bytes]]) -> None:
        """Hand rows to the operating system, which may take long; ``add`` may go on meanwhile. Raises: OSError."""
        for level, block in taken:
            level.write(block)

    def close(self) -> None:
        """Write everything, buckets that are open too. Raises: OSError."""
        self._feed()
        for levels in self._levels.values():
            levels[0].end()
        self.hand_over(self.take())
        self._close_files()

    def give_up(self) -> None:
        """Leave no trend behind that is not whole: without its head it counts as none and can be made again."""
        with suppress(OSError):
            (self._folder / HEAD).unlink()
        with suppress(OSError):
            self._close_files()

    def _feed(self) -> None:
        for name, waiting in self._waiting.items():
            if waiting:
                self._levels[name][0].feed(concatenated(waiting))
                waiting.clear()

    def _close_files(self) -> None:
        for levels in self._levels.values():
            for level in levels:
                level.close()
