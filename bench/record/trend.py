"""The trend of a session while it grows: rows of 1 s, and of those rows of 10 s and 100 s, appended to files
(docs/session-format.md, Trend).

Links bring rows of their frames; of the bench a reading or a set-point of a temperature stands until the next one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame import BENCH, BENCH_FIELDS, Block, FrameDefinition, LinkBatch, MessageBatch, Signal, blocks, means
from bench.model.arrays import Array, Column, Indices, Integers
from bench.model.clock import NS
from bench.model.events import Environment, Event, Reentry
from bench.record.layout import AppendFile, Files, OsFiles, write_all

VERSION = 2  # 1 had no rates
FOLDER = "trend"
HEAD = "trend.json"
LEVELS_S = (1, 10, 100)
HELD_S = 90.0  # how long a temperature of the bench stands that is read once a minute


@dataclass(frozen=True)
class TrendSource:
    """A link or the bench with its signals; ``period_s`` is the time between two of its frames or readings."""

    name: str
    signals: tuple[Signal, ...]
    period_s: float

    @property
    def row_type(self) -> np.dtype[np.void]:
        """One row of its files: start of the bucket in UTC, then least and greatest value of each signal."""
        return np.dtype([("t_utc_s", "<f8"), ("span", "<f4", (len(self.signals), 2))])

    def path(self, folder: Path, level_s: int) -> Path:
        """File of one level in the folder of the trend."""
        return folder / f"{self.name}.{level_s:03d}s"

    def stored(self, path: Path) -> NDArray[np.void]:
        """Whole rows of one file, as they are on the disk now; a torn last one does not count. Raises: OSError."""
        count = path.stat().st_size // self.row_type.itemsize if path.exists() else 0
        return np.memmap(path, self.row_type, "r", shape=(count,)) if count else np.empty(0, self.row_type)


@dataclass(frozen=True)
class TrendHead:
    """Head of a trend: its sources, and UTC minus monotonic time of each part of the session, ns."""

    sources: tuple[TrendSource, ...]
    offsets_ns: tuple[int, ...]

    @property
    def signals(self) -> tuple[Signal, ...]:
        """All signals, source by source."""
        return tuple(signal for source in self.sources for signal in source.signals)


def sources_of(signals: Sequence[Signal], frames: Mapping[str, FrameDefinition]) -> tuple[TrendSource, ...]:
    """Links in the order of their first signal; a link whose frames name no rate counts as one of each second."""
    found = []
    for link in dict.fromkeys(signal.link for signal in signals):
        rate_Hz = 1.0 if link == BENCH else frames[link].rate_Hz or 1.0
        own = tuple(signal for signal in signals if signal.link == link)
        found.append(TrendSource(link, own, 1.0 / rate_Hz))
    return tuple(found)


def write_head(folder: Path, head: TrendHead) -> None:
    """Write the head in one piece. Raises: OSError."""
    content: dict[str, Any] = {
        "version": VERSION,
        "levels_s": list(LEVELS_S),
        "offsets_ns": list(head.offsets_ns),
        "sources": [asdict(source) for source in head.sources],
    }
    fresh = folder / f"{HEAD}.new"
    fresh.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    fresh.replace(folder / HEAD)


def read_head(folder: Path) -> TrendHead | None:
    """The head of a trend; None if there is none, or it is damaged or of another version: it can be made again."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        content = json.loads((folder / HEAD).read_text(encoding="utf-8"))
        if content["version"] == VERSION and content["levels_s"] == list(LEVELS_S):
            sources = tuple(_source(source) for source in content["sources"])
            return TrendHead(sources, tuple(int(offset_ns) for offset_ns in content["offsets_ns"]))
    return None


def _source(content: Mapping[str, Any]) -> TrendSource:
    signals = tuple(Signal(**signal) for signal in content["signals"])
    return TrendSource(str(content["name"]), signals, float(content["period_s"]))


def seconds_of(t_utc_ns: Integers) -> Integers:
    """Bucket of 1 s of each time, by its start; a time on the border belongs to the bucket that ends there.

    Under the virtual clock a link is read on the second: what came before it belongs together.
    """
    seconds: Integers = (t_utc_ns - 1) // NS
    return seconds


@dataclass(frozen=True)
class TrendRows:
    """``start_s``: starts of the buckets, UTC, (m,), never falling; ``low``, ``high``: (m, k), NaN: nothing came."""

    start_s: Integers
    low: NDArray[np.float32]
    high: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.start_s)

    def merged(self, period_s: int) -> TrendRows:
        """Return one row for each bucket of a longer period."""
        if not len(self):
            return self
        start_s = np.maximum.accumulate(self.start_s // period_s * period_s)
        first = _changes(start_s)
        if len(first) == len(self):
            return TrendRows(start_s, self.low, self.high)
        return TrendRows(
            start_s[first], np.fmin.reduceat(self.low, first, axis=0), np.fmax.reduceat(self.high, first, axis=0)
        )

    def cut(self, start: int, stop: int | None = None) -> TrendRows:
        """Some of the rows."""
        return TrendRows(self.start_s[start:stop], self.low[start:stop], self.high[start:stop])


def rows_of(block: NDArray[np.void], columns: slice | list[int] = slice(None)) -> TrendRows:
    """Return rows of a file with some of its columns."""
    span = block["span"][:, columns]
    return TrendRows(block["t_utc_s"].astype(np.int64), span[:, :, 0].copy(), span[:, :, 1].copy())


def concatenated(parts: Sequence[TrendRows]) -> TrendRows:
    """Return rows of several parts, one behind the other; at least one is needed."""
    if len(parts) == 1:
        return parts[0]
    return TrendRows(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("start_s", "low", "high")))


def _changes(values: Integers) -> Indices:
    """Return where a value differs from the one before it; 0 is always among them."""
    first = np.flatnonzero(values[1:] != values[:-1])
    first += 1
    return np.concatenate((np.zeros(1, np.intp), first))


def spread_ns(stamps_ns: Integers, period_ns: int, before_ns: int) -> Integers:
    """Return times of frames from the receive stamps of the chunks they came in, (n,) ns.

    Frames of one chunk carry one stamp; they are laid back from it by the frame period, or closer where they would
    come before the chunk in front of it. Times never fall.

    Args: stamps_ns: (n,), never falling.   before_ns: stamp in front of the first one.
    """
    first = _changes(stamps_ns)
    count = np.diff(first, append=len(stamps_ns))
    last_ns = stamps_ns[first]
    room_ns = np.diff(last_ns, prepend=min(before_ns, int(last_ns[0])))
    step_ns = np.minimum(period_ns, room_ns // count)
    start_ns = last_ns - step_ns * (first + count - 1)  # as if frame 0 were of this chunk
    spread: Integers = np.arange(len(stamps_ns)) * np.repeat(step_ns, count)
    spread += np.repeat(start_ns, count)
    return spread


class FrameTimes:
    """Times of the frames of one link, batch by batch."""

    def __init__(self, definition: FrameDefinition) -> None:
        self._period_ns = round(NS / (definition.rate_Hz or 1.0))
        self._before_ns: dict[str, int] = {}

    def of(self, name: str, t_ns: Integers) -> Integers:
        """Monotonic times of the next frames of a message, (n,) ns, from their receive stamps."""
        stamps_ns = np.maximum.accumulate(t_ns)
        times_ns = spread_ns(stamps_ns, self._period_ns, self._before_ns.get(name, int(stamps_ns[0]) - 3600 * NS))
        self._before_ns[name] = int(stamps_ns[-1])
        return times_ns


class _Together:
    """Batches of one message as one; columns that somebody has cut out already are not cut out again."""

    def __init__(self, parts: Sequence[MessageBatch]) -> None:
        self._parts = parts
        self._columns: dict[str, Array] = {}
        self._values: dict[tuple[str, str, bytes], Column] = {}
        self.message = parts[0].message
        self.t_ns = np.concatenate([part.t_ns for part in parts if part.t_ns is not None])

    def raw(self, name: str) -> Array:
        """Raw values of a field."""
        if name not in self._columns:
            parts = [part.raw(name) for part in self._parts]
            column = np.empty((len(self.t_ns), *parts[0].shape[1:]), parts[0].dtype, order="F")  # quick along time
            self._columns[name] = np.concatenate(parts, out=column)
        return self._columns[name]

    def of(self, block: Block) -> Column:
        """Raw values of a block; a count and its rate have the same."""
        key = block.field, block.minus, block.elements.tobytes()
        if key not in self._values:
            self._values[key] = block.values(self)
        return self._values[key]


class LinkReduction:
    """Makes rows of one link's batches; many at once cost little more than one. One thread at a time."""

    def __init__(self, source: TrendSource, definition: FrameDefinition) -> None:
        self._times = FrameTimes(definition)
        self._width = len(source.signals)
        self._waiting: dict[str, list[MessageBatch]] = {}
        self.frames = 0  # waiting
        self._messages: Mapping[str, tuple[Indices, tuple[Block, ...]]] = {
            message: _blocks_of(source, message) for message in {signal.message: None for signal in source.signals}
        }

    def push(self, batch: LinkBatch) -> None:
        """Queue a batch; this is quick."""
        for message in self._messages:
            frames = batch.messages[message]
            if len(frames.offset):
                self._waiting.setdefault(message, []).append(frames)
                self.frames += len(frames.offset)

    def rows(self, offset_ns: int) -> TrendRows | None:
        """Rows of what was queued, one a second; None if it was nothing. ``offset_ns``: UTC minus monotonic time."""
        waiting, self._waiting, self.frames = self._waiting, {}, 0
        found = [self._reduced(_Together(parts), *self._messages[name], offset_ns) for name, parts in waiting.items()]
        if len(found) < 2:
            return found[0] if found else None
        both = concatenated(found)
        order = np.argsort(both.start_s, kind="stable")
        return TrendRows(both.start_s[order], both.low[order], both.high[order]).merged(1)

    def _reduced(self, frames: _Together, places: Indices, parts: tuple[Block, ...], offset_ns: int) -> TrendRows:
        seconds = seconds_of(self._times.of(frames.message.name, frames.t_ns) + offset_ns)
        first = _changes(seconds)
        low = np.full((len(first), self._width), np.nan, np.float32)
        high = low.copy()
        counts = np.diff(first, append=len(seconds))[:, None]
        for block in parts:
            values = frames.of(block)
            if block.rate_Hz:
                sums = block.in_unit(np.add.reduceat(values, first, axis=0, dtype=np.float64), frames.message)
                low[:, places[block.places]] = high[:, places[block.places]] = means(sums, counts, block.rate_Hz)
                continue
            least, most = (np.fmin, np.fmax) if values.dtype.kind == "f" else (np.minimum, np.maximum)
            ends = [block.in_unit(end.reduceat(values, first, axis=0), frames.message) for end in (least, most)]
            at = places[block.places]
            low[:, at], high[:, at] = np.fmin(*ends), np.fmax(*ends)  # a negative scale turns them round
        return TrendRows(seconds[first], low, high)


def _blocks_of(source: TrendSource, message: str) -> tuple[Indices, tuple[Block, ...]]:
    places = [place for place, signal in enumerate(source.signals) if signal.message == message]
    return np.array(places), blocks([source.signals[place] for place in places])


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
