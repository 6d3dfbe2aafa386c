"""Cuts records out of a stream of frames: by the unwrapped counter, never by arrival; keeps them in little memory."""

from __future__ import annotations

import pickle
import tempfile
import weakref
import zlib
from bisect import insort
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import IO, Any, Generic, TypeVar

import numpy as np

from bench.frame import FrameDefinition, LinkBatch, MessageBatch, Signal
from bench.model.arrays import Column, Flags, Integers
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from bench.model.posix import read_at, write_at
from bench.record.samples import (
    PER_SAMPLE,
    BesideKeeper,
    SampleKeeper,
    Samples,
    SignalKeeper,
    counting_message,
    sample_scales,
)
from bench.record.window import OpenWindow, RecordRow, Rows, kept_ns

OVER_RANGE_BITS = "over_range"


class RecordCutter:
    """Sums the per-frame counts of one link over the windows opened on it, or keeps its samples.

    The result depends on the bytes and their receive stamps only, not on how the stream was cut into batches, so a
    replay gives the same rows. Feed housekeeping (``feed_context``) before the measurement frames of the same time.
    Raises: InputError B-REC-020 if the frame definition has neither per-frame counts nor samples, or no counter.
    """

    def __init__(self, definition: FrameDefinition) -> None:
        message = counting_message(definition)
        if message is None:
            raise InputError(
                "B-REC-020",
                f"{definition.name} has no message with a counter and counts per frame, or samples",
                where=definition.name,
                next_step="declare 'role: counter' and 'per: frame', or 'per: sample', in the frame file",
            )
        self._message = message.name
        self._length = message.length
        fields = [field for field in message.fields if field.per == "frame"]
        self._shapes = {field.name: (() if field.count is None else (field.count,)) for field in fields}
        self._scales = sample_scales(message)
        flagged = [field.name for field in message.fields if OVER_RANGE_BITS in field.bits]
        self._period_ns = round(NS / definition.rate_Hz) if definition.rate_Hz else 1
        self._over_range = f"{flagged[0]}.{OVER_RANGE_BITS}" if flagged else ""
        self._open: list[OpenWindow] = []  # by first counter
        self._highest = -1
        self._previous = (-1, 0)  # counter and stream offset of the newest good frame

    def open(
        self, window: RecordWindow, *, until_ns: int | None = None, timed: bool = False, sampled: bool = False,
        chained: bool = False, signals: Sequence[Signal] = (),
    ) -> None:  # fmt: skip
        """Cut this record too. Its frames must not have been fed before.

        ``until_ns``: frames received later do not count (in a replay: when the run gave the record up).
        ``timed``: keep when in the record the pulses came (``RecordRow.timing``).   ``sampled``: keep the samples,
        and those of other links.   ``chained``: it follows another record without a gap.   ``signals``: to be kept.
        """
        keeper = SampleKeeper(self._scales) if sampled and self._scales else None
        span_ns = kept_ns(window, chained)
        beside = BesideKeeper(*span_ns) if keeper is not None else None
        kept = SignalKeeper(signals, *span_ns) if signals else None
        item = OpenWindow(window, until_ns, self._shapes, timed, self._period_ns, keeper, beside, kept)
        insort(self._open, item, key=lambda item: item.first)

    def feed(self, batch: LinkBatch) -> None:
        """Take the next frames of the link."""
        frames = batch.messages[self._message]
        for item in self._open:
            if item.signals is not None:
                for other in batch.messages.values():
                    if other is not frames:
                        item.signals.add_beside(item.window.link, other)
        if len(batch.bad_offset):
            self._take_bad(batch, frames)
        if len(frames.offset):
            self._take(frames)

    def feed_context(self, batch: LinkBatch, link: str = "") -> None:
        """Take the next frames of another link, called ``link``.

        Samples are kept for records that keep theirs; every other field with a unit is averaged over each record.
        """
        for frames in batch.messages.values():
            t_ns = frames.t_ns
            if t_ns is None or not len(t_ns):
                continue
            for item in self._open:
                if item.beside is not None:
                    item.beside.add(link, frames)
                if item.signals is not None:
                    item.signals.add_beside(link, frames)
            first, last = int(t_ns[0]), int(t_ns[-1])
            waiting = [item for item in self._open if item.window.t_start_ns <= last and item.window.t_end_ns >= first]
            averaged = [field for field in frames.message.fields if field.unit and field.per != PER_SAMPLE]
            units = {field.name: field.unit for field in averaged}
            if waiting and units:
                values = {f"{name} {unit}": frames.scaled(name) for name, unit in units.items()}
                for item in waiting:
                    item.add_context(t_ns, values)

    def finished(self) -> list[RecordRow]:
        """Rows of the windows that are complete, in order of their counters; they are forgotten here."""
        done = [item for item in self._open if item.complete]
        if done:
            self._open = [item for item in self._open if not item.complete]
        return [item.row() for item in done]

    def close(self, number: int) -> RecordRow:
        """Row of record ``number`` as it stands, complete or not; it is forgotten here."""
        for index, item in enumerate(self._open):
            if item.window.number == number:
                del self._open[index]
                return item.row()
        raise KeyError(f"record {number} is not open")

    def close_all(self) -> list[RecordRow]:
        """Return rows of all windows, complete or not: nothing will follow."""
        rows = [item.row() for item in self._open]
        self._open = []
        return rows

    def _take(self, frames: MessageBatch) -> None:
        assert frames.counter is not None
        counter = frames.counter
        fresh: Integers | None = None
        rises = counter[0] > self._highest and (counter[1:] > counter[:-1]).all()
        if frames.suspect.any() or not rises:
            trusted = np.where(frames.suspect, -1, counter)
            before = np.maximum.accumulate(np.concatenate(([self._highest], trusted)))[:-1]
            fresh = np.flatnonzero(trusted > before)
            self._take_duplicates(counter, before, ~frames.suspect & (counter <= before))
        kept = counter if fresh is None else counter[fresh]
        if not len(kept):
            return
        for item in self._open:
            if item.first > kept[-1]:
                break
            if not item.complete:
                self._take_into(item, frames, kept, fresh)
        self._highest = int(kept[-1])
        last = -1 if fresh is None else int(fresh[-1])
        self._previous = (int(kept[-1]), int(frames.offset[last]))

    def _take_into(self, item: OpenWindow, frames: MessageBatch, kept: Integers, fresh: Integers | None) -> None:
        assert frames.t_ns is not None
        first, stop = (int(value) for value in np.searchsorted(kept, (item.first, item.stop)))
        given_up = False
        if item.until_ns is not None:
            in_time = int(np.searchsorted(frames.t_ns, item.until_ns, side="right"))
            in_time = in_time if fresh is None else int(np.searchsorted(fresh, in_time))
            stop = min(stop, in_time)
            given_up = in_time < len(kept)
        if first < stop:
            rows: Rows = slice(first, stop) if fresh is None else fresh[first:stop]
            columns = {name: frames.raw(name) for name in self._shapes}
            early = int(np.searchsorted(kept[first:stop], item.middle))
            item.add(columns, rows, frames.t_ns, early, self._is_over_range(frames, rows, item.window))
            if item.signals is not None:
                item.signals.add(item.window.link, frames, rows)
            if item.keeper is not None:
                sampled = {name: frames.raw(name)[rows] for name in self._scales}
                item.keeper.add(kept[first:stop], frames.t_ns[rows], sampled)
        if given_up or kept[-1] >= item.stop - 1:
            item.settle()

    def _is_over_range(self, frames: MessageBatch, rows: Rows, window: RecordWindow) -> bool:
        """Over-range bit of the record's own channel (bit 0 = channel 1); of any channel if it names none."""
        if not self._over_range:
            return False
        bits = int(np.bitwise_or.reduce(frames.raw(self._over_range)[rows]))
        channel: Any = window.conditions.get("channel")
        return bool(bits >> (channel - 1) & 1) if isinstance(channel, int) and channel > 0 else bits != 0

    def _take_duplicates(self, counter: Integers, before: Integers, repeated: Flags) -> None:
        if not repeated.any():
            return
        counters, highest = counter[repeated], before[repeated]
        for item in self._open:
            if not item.complete:
                inside = (counters >= item.first) & (counters < item.stop) & (highest < item.stop - 1)
                item.duplicate += int(np.count_nonzero(inside))

    def _take_bad(self, batch: LinkBatch, frames: MessageBatch) -> None:
        """Give each rejected candidate the counter its place in the stream suggests."""
        assert frames.counter is not None or not len(frames)
        trusted = ~frames.suspect
        offsets = np.concatenate(([self._previous[1]], frames.offset[trusted]))
        counters = np.concatenate(([self._previous[0]], frames.counter[trusted] if frames.counter is not None else []))
        before = np.searchsorted(offsets[1:], batch.bad_offset)
        known = counters[before] >= 0
        steps = np.ones(len(before), np.int64)
        if self._length:
            steps = np.maximum(1, np.rint((batch.bad_offset - offsets[before]) / self._length).astype(np.int64))
        guesses = (counters[before] + steps)[known]
        stamps = batch.bad_t_ns[known]
        for item in self._open:
            if not item.complete:
                inside = (guesses >= item.first) & (guesses < item.stop)
                if item.until_ns is not None:
                    inside &= stamps <= item.until_ns
                item.bad_counters.update(guesses[inside].astype(np.int64).tolist())


Item = TypeVar("Item")

BLOCK = 64
_LEVEL = 6
_DICTIONARY_BYTES = 1 << 15  # as far back as the compression looks
LARGE_BYTES = 1_000_000  # of a column; smaller ones stay in memory


class PackedRows(MutableMapping[int, RecordRow]):
    """Records by number. Each is packed for itself, with the first one as the dictionary of the compression.

    One with large samples is kept as it is, and these in a file.
    """

    def __init__(self) -> None:
        self._dictionary = b""
        self._packed: dict[int, bytes | RecordRow] = {}
        self._store = SampleStore()

    def __setitem__(self, number: int, row: RecordRow) -> None:
        stored = self._store.kept(row)
        if stored is not row:
            self._packed[number] = stored
            return
        plain = pickle.dumps(row, pickle.HIGHEST_PROTOCOL)
        self._dictionary = self._dictionary or plain[-_DICTIONARY_BYTES:]
        packer = zlib.compressobj(_LEVEL, zdict=self._dictionary)
        self._packed[number] = packer.compress(plain) + packer.flush()

    def __getitem__(self, number: int) -> RecordRow:
        packed = self._packed[number]
        if isinstance(packed, RecordRow):
            return packed
        row: RecordRow = pickle.loads(zlib.decompressobj(zdict=self._dictionary).decompress(packed))
        return row

    def __delitem__(self, number: int) -> None:
        del self._packed[number]

    def __iter__(self) -> Iterator[int]:
        return iter(self._packed)

    def __len__(self) -> int:
        return len(self._packed)


class PackedList(Generic[Item]):
    """A list that only grows; full blocks of it are packed."""

    def __init__(self) -> None:
        self._blocks: list[bytes] = []
        self._newest: list[Item] = []

    def append(self, item: Item) -> None:
        """Add one item; it must not be changed afterwards."""
        self._newest.append(item)
        if len(self._newest) == BLOCK:
            self._blocks.append(zlib.compress(pickle.dumps(self._newest, pickle.HIGHEST_PROTOCOL), _LEVEL))
            self._newest = []

    def __iter__(self) -> Iterator[Item]:
        for block in self._blocks:
            unpacked: list[Any] = pickle.loads(zlib.decompress(block))
            yield from unpacked
        yield from self._newest


class SampleStore:
    """A file without a name that large columns go to; where it cannot be written they stay in memory."""

    def __init__(self) -> None:
        self._file: IO[bytes] | None = None
        self._end = 0

    def kept(self, row: RecordRow) -> RecordRow:
        """Return a record whose large columns are read when they are asked for; the same one if none is large."""
        sampled = [*row.beside.values(), *([] if row.samples is None else [row.samples])]
        if not any(_bytes_of(column) >= LARGE_BYTES for samples in sampled for column in samples.columns.values()):
            return row
        samples = None if row.samples is None else self._stored(row.samples)
        return replace(row, samples=samples, beside={link: self._stored(sent) for link, sent in row.beside.items()})

    def _stored(self, samples: Samples) -> Samples:
        return replace(samples, columns=StoredColumns(self, samples.columns))

    def write(self, column: Column) -> tuple[int, int] | None:
        """Return where a column stands now, (offset, bytes), None if it is small or there is no room for it."""
        if _bytes_of(column) < LARGE_BYTES:
            return None
        content = memoryview(pickle.dumps(column, pickle.HIGHEST_PROTOCOL))
        with suppress(OSError):
            opened, written = self._opened(), 0
            while written < len(content):
                written += write_at(opened.fileno(), content[written:], self._end + written)
            self._end += len(content)
            return self._end - len(content), len(content)
        return None

    def _opened(self) -> IO[bytes]:
        if self._file is None:
            self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - closed with the store
            weakref.finalize(self, self._file.close)
        return self._file

    def read(self, at: int, count: int) -> Column:
        """Return the column that stands there. Raises: OSError."""
        assert self._file is not None
        content = bytearray()
        while len(content) < count:
            piece = read_at(self._file.fileno(), count - len(content), at + len(content))
            if not piece:
                raise OSError("the file of the samples is shorter than it was")
            content += piece
        column: Column = pickle.loads(content)
        return column


class StoredColumns(Mapping[str, Column]):
    """Columns of samples by name; one that stands in a file is read each time it is asked for."""

    def __init__(self, store: SampleStore, columns: Mapping[str, Column]) -> None:
        self._store = store
        self._places = {name: store.write(column) for name, column in columns.items()}
        self._here = {name: column for name, column in columns.items() if self._places[name] is None}

    def __getitem__(self, name: str) -> Column:
        place = self._places[name]
        return self._here[name] if place is None else self._store.read(*place)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


def _bytes_of(column: Column) -> int:
    return sum(map(len, column.tolist())) if column.dtype == object else column.nbytes
