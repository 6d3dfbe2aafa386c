"""One link: queued chunks in, frames with receive stamps and unwrapped counters out.

Rates of what frames count: the mean over ``MEAN_S``. A mean that lacks half of its frames or more is NaN: a gap.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.frame.batch import FrameBatch, MessageBatch
from bench.frame.counter import CounterUnwrapper
from bench.frame.definition import Engine, FrameDefinition
from bench.frame.layout import Field
from bench.frame.signals import MEAN_S, Signal
from bench.model.clock import NS

_Chunk = tuple[int, bytes]  # receive stamp in ns, bytes
Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinkCounts:
    """Running totals of a link.

    bytes: decoded so far; frames: accepted; bad: sync found, check failed, not inside an accepted frame; lost and
    duplicate: by the counter; suspect: check passed, but a constant or the counter is out of line; skipped_bytes: in no
    accepted frame; other: check right, of a type that the definition does not list.
    """

    bytes: int = 0
    frames: int = 0
    bad: int = 0
    lost: int = 0
    duplicate: int = 0
    skipped_bytes: int = 0
    suspect: int = 0
    other: int = 0


class LinkBatch(NamedTuple):
    """Frames of one flush by message name, the rejected candidates (m,) with stream offset and receive stamp.

    ``lost`` and ``duplicate`` count what the counters of this batch revealed.
    """

    messages: Mapping[str, MessageBatch]
    bad_offset: NDArray[np.int64]
    bad_t_ns: NDArray[np.int64]
    lost: int
    duplicate: int


class LinkDecoder:
    """Decoder of one link. ``push`` only queues and may be called from the reading thread; ``flush`` decodes.

    Where the definition states a ``silence``, a frame that was begun before a longer pause between two chunks, and
    that the chunk behind the pause does not complete, is given up: a false length cannot keep the decoder waiting.
    Only the stamps of the chunks count, so the same chunks give the same frames later, however they are flushed.
    """

    def __init__(self, definition: FrameDefinition, engine: Engine = "numpy") -> None:
        self.definition = definition
        self._ends, self._stamps = array("q"), array("q")  # of chunks that are not decided: offset behind, stamp
        self._decoder = definition.decoder(engine)
        silence_s = definition.layout.silence_s
        self._silence_ns = None if silence_s is None else round(silence_s * NS)
        self._heard_ns: int | None = None  # stamp of the last chunk that held bytes
        self._queue: deque[_Chunk] = deque()
        self._pushed = 0
        self._taken = 0
        self._decided = 0
        self._lost = self._duplicate = self._suspect = 0
        self._counters: dict[str, CounterUnwrapper] = {}

    def push(self, t_mono_ns: int, chunk: bytes) -> None:
        """Queue a received chunk; ``t_mono_ns`` is the time its last byte was read."""
        self._queue.append((t_mono_ns, chunk))
        self._pushed += len(chunk)

    def push_all(self, chunks: Sequence[tuple[int, bytes]]) -> None:
        """Queue received chunks, each with its time."""
        self._queue.extend(chunks)
        self._pushed += sum(len(chunk) for _, chunk in chunks)

    @property
    def pending_bytes(self) -> int:
        """Bytes queued and not yet decoded."""
        return self._pushed - self._taken

    @property
    def undecided_bytes(self) -> int:
        """Bytes of a frame that has begun and is not complete."""
        return self._taken - self._decided

    @property
    def counts(self) -> LinkCounts:
        """Totals of everything flushed so far."""
        seen = self._decoder.counts
        return LinkCounts(
            seen.bytes,
            seen.frames,
            seen.bad,
            self._lost,
            self._duplicate,
            seen.skipped_bytes,
            self._suspect,
            seen.other,
        )

    def flush(self) -> LinkBatch:
        """Decode all queued chunks; an unfinished frame waits for the next flush."""
        queue = self._queue
        queued = [queue.popleft()] if len(queue) == 1 else [queue.popleft() for _ in range(len(queue))]
        if self._silence_ns is None:
            return self._accounted(self._fed(queued))
        batches = []
        for chunks, silent_until in self._between_silences(queued, self._silence_ns):
            found = self._fed(chunks)
            batches.append(self._accounted(found))
            if silent_until is not None and found.position < silent_until:
                batches.append(self._accounted(self._decoder.give_up(silent_until)))
        return _joined(batches)

    def finish(self) -> LinkBatch:
        """Decode all queued chunks and the tail: nothing will follow."""
        batch = self.flush()
        tail = self._accounted(self._decoder.finish())
        if not any(len(part) for part in tail.messages.values()) and not len(tail.bad_offset):
            return batch
        return _joined([batch, tail])

    def _between_silences(self, queued: list[_Chunk], silence_ns: int) -> list[tuple[list[_Chunk], int | None]]:
        """Chunks to be decoded together, with the stream offset at which a silence ended.

        The chunk that ended the silence is the last one of its group: it may still complete the frame before it.
        """
        groups: list[tuple[list[_Chunk], int | None]] = []
        group: list[_Chunk] = []
        at = self._taken
        for stamp, chunk in queued:
            group.append((stamp, chunk))
            if chunk and self._heard_ns is not None and stamp - self._heard_ns > silence_ns:
                groups.append((group, at))
                group = []
            at += len(chunk)
            self._heard_ns = stamp if chunk else self._heard_ns
        return groups if groups and not group else [*groups, (group, None)]

    def _fed(self, chunks: list[_Chunk]) -> FrameBatch:
        for stamp, chunk in chunks:
            self._taken += len(chunk)
            self._ends.append(self._taken)
            self._stamps.append(stamp)
        return self._decoder.feed(chunks[0][1] if len(chunks) == 1 else b"".join([chunk for _, chunk in chunks]))

    def _accounted(self, found: FrameBatch) -> LinkBatch:
        """Give frames their stamps and counters, count what these reveal, let go of the chunks behind."""
        messages, bad_offset, position = found
        for batch in messages.values():
            batch.t_ns = self._stamps_of(batch)
        lost, duplicate = self._count(messages)
        bad_t_ns = bad_offset
        if len(bad_offset):
            bad_t_ns = np.array(self._stamps)[np.searchsorted(self._ends, bad_offset, side="right")]
        self._lost += lost
        self._duplicate += duplicate
        self._suspect += sum(int(np.count_nonzero(batch.suspect)) for batch in messages.values())
        self._decided = position
        decided = bisect_right(self._ends, position)
        del self._ends[:decided], self._stamps[:decided]
        return LinkBatch(messages, bad_offset, bad_t_ns, lost, duplicate)

    def _stamps_of(self, batch: MessageBatch) -> NDArray[np.int64]:
        """Stamp of the chunk with the last byte of each frame; few chunks, many frames: count frames per chunk."""
        if not len(batch):
            return np.empty(0, np.int64)
        ends, first, last = self._ends, 0, 0
        if len(ends) > 1:
            first, last = bisect_left(ends, self._end_of(batch, 0)), bisect_left(ends, self._end_of(batch, -1))
        if first == last:
            stamps = np.empty(len(batch), np.int64)
            stamps.fill(self._stamps[first])
            return stamps
        behind = batch.offset + batch.message.length
        if batch.ends is not None:
            behind = batch.ends
        elif batch.rest is not None:
            extra = np.fromiter(map(len, batch.rest), np.int64, len(batch))
            behind = batch.offset + batch.message.body + self.definition.layout.tail + extra
        complete = np.searchsorted(behind, ends[first : last + 1], side="right")
        complete[1:] -= complete[:-1].copy()
        return np.repeat(np.array(self._stamps[first : last + 1]), complete)

    def _end_of(self, batch: MessageBatch, index: int) -> int:
        """Return the stream offset behind one frame."""
        if batch.ends is not None:
            return int(batch.ends[index])
        if batch.rest is None:
            return int(batch.offset[index]) + batch.message.length
        tail = self.definition.layout.tail + len(batch.rest[index])
        return int(batch.offset[index]) + batch.message.body + tail

    def _count(self, messages: Mapping[str, MessageBatch]) -> tuple[int, int]:
        lost = duplicate = 0
        counting = []
        for batch in messages.values():
            if batch.message.counter is not None and len(batch):
                counting.append(batch)
            elif batch.message.counter is not None:
                batch.counter = np.empty(0, np.int64)
        groups = [counting] if self.definition.layout.shared_counter else [[batch] for batch in counting]
        for group in groups if counting else ():
            more_lost, more_duplicate = self._unwrap(group)
            lost += more_lost
            duplicate += more_duplicate
        return lost, duplicate

    def _unwrap(self, group: list[MessageBatch]) -> tuple[int, int]:
        """Unwrap the counter that the messages of a group share, in stream order."""
        field = group[0].message.counter
        assert field is not None
        key = "" if self.definition.layout.shared_counter else group[0].message.name
        unwrapper = self._counters.get(key)
        if unwrapper is None:
            wrap = field.wrap or 1 << field.width
            unwrapper = self._counters[key] = CounterUnwrapper(wrap, self.definition.rate_Hz)
        if len(group) == 1:
            batch = group[0]
            result = unwrapper.feed(_counted(batch, field), batch.t_ns)
            batch.counter = result.counter
            if result.doubtful:
                batch.suspect = batch.suspect | result.suspect
            return result.lost, result.duplicate
        offset = np.concatenate([batch.offset for batch in group])
        order = np.argsort(offset, kind="stable")
        raw = np.concatenate([_counted(batch, field) for batch in group])
        stamps = np.concatenate([batch.t_ns for batch in group if batch.t_ns is not None])
        result = unwrapper.feed(raw[order], stamps[order])
        counter, suspect = np.empty_like(result.counter), np.empty_like(result.suspect)
        counter[order], suspect[order] = result.counter, result.suspect
        at = 0
        for batch in group:
            batch.counter = counter[at : at + len(batch)]
            batch.suspect = batch.suspect | suspect[at : at + len(batch)]
            at += len(batch)
        return result.lost, result.duplicate


def _counted(batch: MessageBatch, field: Field) -> NDArray[np.int64]:
    """Return the counters of a batch as sent, without bits of the field that do not count."""
    raw = batch.raw(field.name).astype(np.int64)
    return raw & (field.wrap - 1) if field.wrap and field.bits else raw


def _joined(parts: list[LinkBatch]) -> LinkBatch:
    """Batches that follow each other in the stream, as one."""
    if len(parts) == 1:
        return parts[0]
    messages = {name: MessageBatch.join([part.messages[name] for part in parts]) for name in parts[0].messages}
    return LinkBatch(
        messages,
        np.concatenate([part.bad_offset for part in parts]),
        np.concatenate([part.bad_t_ns for part in parts]),
        sum(part.lost for part in parts),
        sum(part.duplicate for part in parts),
    )


def means(sums: Array, counts: NDArray[np.intp], rate_Hz: Array | float) -> Array:
    """Return sums over ``MEAN_S`` as means, (m, k); NaN where not more than half of the frames came.

    Args: sums: (m, k).   counts: of the frames in each sum, (m, k) or (m, 1).   rate_Hz: of the frames, (k,) or one.
    """
    enough = counts * 2 > np.asarray(rate_Hz) * MEAN_S
    found: Array = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=enough)
    return found


def trailing_means(t_ns: NDArray[np.int64], signals: Sequence[Signal], values: Array) -> Array:
    """Return values of frames with those of rates replaced by their mean over ``MEAN_S`` up to each frame, (n, k).

    Args: t_ns: of the frames, (n,), never falling.   signals: (k,).   values: as ``columns`` gives them, (n, k).
    """
    places = rates_among(signals)
    if not len(places) or not len(t_ns):
        return values
    first = np.searchsorted(t_ns, t_ns - round(MEAN_S * NS), side="right")
    total = np.concatenate((np.zeros((1, len(places))), np.cumsum(values[:, places], axis=0)))
    sums = total[1:] - total[first]
    found = values.copy()
    found[:, places] = means(sums, (np.arange(1, len(t_ns) + 1) - first)[:, None], rates_Hz(signals)[places])
    return found


def rates_among(signals: Sequence[Signal]) -> NDArray[np.intp]:
    """Return places of the rates among signals."""
    return np.flatnonzero(rates_Hz(signals))


def rates_Hz(signals: Sequence[Signal]) -> Array:
    """Return ``rate_Hz`` of each signal, (k,)."""
    return np.array([signal.rate_Hz for signal in signals], np.float64)
