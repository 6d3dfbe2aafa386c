"""Rows of a trend: how they lie on the disk (docs/session-format.md, Trend), and how frames become one a second."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame import BENCH, Block, FrameDefinition, LinkBatch, MessageBatch, Signal, blocks, means
from bench.model.arrays import Array, Column, Indices, Integers
from bench.model.clock import NS

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
