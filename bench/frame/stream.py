"""One link: queued chunks in, frames with receive stamps and unwrapped counters out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.frame.batch import FrameBatch, MessageBatch
from bench.frame.counter import CounterUnwrapper
from bench.frame.definition import Engine, FrameDefinition
from bench.model.clock import NS

_Chunk = tuple[int, bytes]  # receive stamp in ns, bytes


@dataclass(frozen=True)
class LinkCounts:
    """Running totals of a link.

    bytes: decoded so far; frames: accepted; bad: sync found, check failed, not inside an accepted frame; lost and
    duplicate: by the counter; suspect: check passed, but a constant or the counter is out of line; skipped_bytes: in no
    accepted frame.
    """

    bytes: int = 0
    frames: int = 0
    bad: int = 0
    lost: int = 0
    duplicate: int = 0
    skipped_bytes: int = 0
    suspect: int = 0


@dataclass(frozen=True)
class LinkBatch:
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
        self._decoder = definition.decoder(engine)
        silence_s = definition.layout.silence_s
        self._silence_ns = None if silence_s is None else round(silence_s * NS)
        self._heard_ns: int | None = None  # stamp of the last chunk that held bytes
        self._queue: deque[_Chunk] = deque()
        self._pushed = 0
        self._taken = 0
        self._ends = np.empty(0, np.int64)  # stream offset behind each chunk that is not decided to its end
        self._stamps = np.empty(0, np.int64)
        self._lost = self._duplicate = self._suspect = 0
        self._counters: dict[str, CounterUnwrapper] = {}

    def push(self, t_mono_ns: int, chunk: bytes) -> None:
        """Queue a received chunk; ``t_mono_ns`` is the time its last byte was read."""
        self._queue.append((t_mono_ns, chunk))
        self._pushed += len(chunk)

    @property
    def pending_bytes(self) -> int:
        """Bytes queued and not yet decoded."""
        return self._pushed - self._taken

    @property
    def counts(self) -> LinkCounts:
        """Totals of everything flushed so far."""
        seen = self._decoder.counts
        return LinkCounts(
            seen.bytes, seen.frames, seen.bad, self._lost, self._duplicate, seen.skipped_bytes, self._suspect
        )

    def flush(self) -> LinkBatch:
        """Decode all queued chunks; an unfinished frame waits for the next flush."""
        queued = []
        while self._queue:
            queued.append(self._queue.popleft())
        batches = []
        for chunks, silent_until in self._between_silences(queued):
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

    def _between_silences(self, queued: list[_Chunk]) -> list[tuple[list[_Chunk], int | None]]:
        """Chunks to be decoded together, with the stream offset at which a silence ended.

        The chunk that ended the silence is the last one of its group: it may still complete the frame before it.
        """
        if self._silence_ns is None:
            return [(queued, None)]
        groups: list[tuple[list[_Chunk], int | None]] = []
        group: list[_Chunk] = []
        at = self._taken
        for stamp, chunk in queued:
            group.append((stamp, chunk))
            if chunk and self._heard_ns is not None and stamp - self._heard_ns > self._silence_ns:
                groups.append((group, at))
                group = []
            at += len(chunk)
            self._heard_ns = stamp if chunk else self._heard_ns
        return groups if groups and not group else [*groups, (group, None)]

    def _fed(self, chunks: list[_Chunk]) -> FrameBatch:
        sizes = np.fromiter((len(chunk) for _, chunk in chunks), np.int64, len(chunks))
        stamps = np.fromiter((stamp for stamp, _ in chunks), np.int64, len(chunks))
        self._ends = np.concatenate((self._ends, self._taken + np.cumsum(sizes)))
        self._stamps = np.concatenate((self._stamps, stamps))
        self._taken += int(sizes.sum())
        return self._decoder.feed(b"".join(chunk for _, chunk in chunks))

    def _accounted(self, found: FrameBatch) -> LinkBatch:
        """Give frames their stamps and counters, and let go of the chunks behind."""
        for batch in found.messages.values():
            batch.t_ns = self._stamps_of(batch)
        lost, duplicate = self._count(found.messages)
        self._lost += lost
        self._duplicate += duplicate
        self._suspect += sum(int(np.count_nonzero(batch.suspect)) for batch in found.messages.values())
        bad_t_ns = self._stamps[np.searchsorted(self._ends, found.bad_offset, side="right")]
        decided = int(np.searchsorted(self._ends, found.position, side="right"))
        self._ends, self._stamps = self._ends[decided:], self._stamps[decided:]
        return LinkBatch(found.messages, found.bad_offset, bad_t_ns, lost, duplicate)

    def _stamps_of(self, batch: MessageBatch) -> NDArray[np.int64]:
        """Stamp of the chunk with the last byte of each frame; few chunks, many frames: count frames per chunk."""
        if batch.rest is None:
            behind = batch.offset + batch.message.length
        else:
            extra = np.fromiter(map(len, batch.rest), np.int64, len(batch))
            behind = batch.offset + batch.message.body + self.definition.layout.check.size + extra
        complete = np.searchsorted(behind, self._ends, side="right")
        complete[1:] -= complete[:-1].copy()
        return np.repeat(self._stamps, complete)

    def _count(self, messages: Mapping[str, MessageBatch]) -> tuple[int, int]:
        counting = [batch for batch in messages.values() if batch.message.counter is not None]
        for batch in counting:
            batch.counter = np.empty(0, np.int64)
        counting = [batch for batch in counting if len(batch)]
        groups = [counting] if self.definition.layout.shared_counter else [[batch] for batch in counting]
        lost = duplicate = 0
        for group in groups:
            if not group:
                continue
            more_lost, more_duplicate = self._unwrap(group)
            lost += more_lost
            duplicate += more_duplicate
        return lost, duplicate

    def _unwrap(self, group: list[MessageBatch]) -> tuple[int, int]:
        """Unwrap the counter that the messages of a group share, in stream order."""
        field = group[0].message.counter
        assert field is not None
        key = "" if self.definition.layout.shared_counter else group[0].message.name
        if key not in self._counters:
            self._counters[key] = CounterUnwrapper(field.wrap or 1 << (8 * field.size), self.definition.rate_Hz)
        if len(group) == 1:
            batch = group[0]
            result = self._counters[key].feed(batch.raw(field.name).astype(np.int64), batch.t_ns)
            batch.counter = result.counter
            batch.suspect = batch.suspect | result.suspect
            return result.lost, result.duplicate
        offset = np.concatenate([batch.offset for batch in group])
        order = np.argsort(offset, kind="stable")
        raw = np.concatenate([batch.raw(field.name).astype(np.int64) for batch in group])
        stamps = np.concatenate([batch.t_ns for batch in group if batch.t_ns is not None])
        result = self._counters[key].feed(raw[order], stamps[order])
        counter, suspect = np.empty_like(result.counter), np.empty_like(result.suspect)
        counter[order], suspect[order] = result.counter, result.suspect
        at = 0
        for batch in group:
            batch.counter = counter[at : at + len(batch)]
            batch.suspect = batch.suspect | suspect[at : at + len(batch)]
            at += len(batch)
        return result.lost, result.duplicate


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
