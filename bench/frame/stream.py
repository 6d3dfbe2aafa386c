"""One link: queued chunks in, frames with receive stamps and unwrapped counters out.

Counters are without wrap, and tell lost and repeated frames.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from itertools import accumulate
from operator import add
from typing import NamedTuple

import numpy as np

from bench.frame.batch import FrameBatch, MessageBatch
from bench.frame.definition import Engine, FrameDefinition
from bench.frame.layout import Field
from bench.model.arrays import Flags, Floats, Integers
from bench.model.clock import NS

_Chunk = tuple[int, bytes]  # receive stamp in ns, bytes
Contents = Callable[[int], list[bytes]]  # the bytes of frames, from that one on
_START = np.zeros(1, np.int64)
REPEAT_REACH = 64  # frames; a serial line repeats at most the tail of a buffer
_FARTHEST = 1 << 14  # frames; a counter farther ahead was restarted or damaged sooner than that many were lost


@dataclass(frozen=True)
class LinkCounts:
    """Running totals of a link.

    bytes: decoded so far; frames: accepted; bad: sync found, check failed, not inside an accepted frame; lost and
    duplicate: by the counter; suspect: check passed, but a constant or the counter is out of line; skipped_bytes: in no
    accepted frame; other: check right, of a type that the definition does not list; jumps: places where a counter went
    on elsewhere, so that nobody knows how many frames are missing there: none of them is among the lost.
    """

    bytes: int = 0
    frames: int = 0
    bad: int = 0
    lost: int = 0
    duplicate: int = 0
    skipped_bytes: int = 0
    suspect: int = 0
    other: int = 0
    jumps: int = 0

    def __add__(self, more: LinkCounts) -> LinkCounts:
        """Return the totals of both."""
        return LinkCounts(*map(add, astuple(self), astuple(more)))

    @property
    def totals(self) -> dict[str, int]:
        """Frames good, bad and lost, and jumps, as the sessions name them."""
        return {"frames": self.frames, "frames_bad": self.bad, "frames_lost": self.lost, "jumps": self.jumps}


class LinkBatch(NamedTuple):
    """Frames of one flush by message name, the rejected candidates (m,) with stream offset and receive stamp."""

    messages: Mapping[str, MessageBatch]
    bad_offset: Integers
    bad_t_ns: Integers


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
        self._lost = self._duplicate = self._suspect = self._jumps = 0
        self._counters: dict[str, CounterUnwrapper] = {}

    def push(self, t_mono_ns: int, chunk: bytes) -> None:
        """Queue a received chunk; ``t_mono_ns`` is the time its last byte was read."""
        self.push_all([(t_mono_ns, chunk)])

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
        mine = {"lost": self._lost, "duplicate": self._duplicate, "suspect": self._suspect, "jumps": self._jumps}
        return LinkCounts(**vars(self._decoder.counts), **mine)

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
        return _joined([self.flush(), self._accounted(self._decoder.finish())])

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
        pieces = [chunk for _, chunk in chunks]
        ends = list(accumulate(map(len, pieces), initial=self._taken))
        self._taken = ends[-1]
        self._ends.extend(ends[1:])
        self._stamps.extend([stamp for stamp, _ in chunks])
        return self._decoder.feed(pieces[0] if len(pieces) == 1 else b"".join(pieces))

    def _accounted(self, found: FrameBatch) -> LinkBatch:
        """Give frames their stamps and counters, count what these reveal, let go of the chunks behind."""
        messages, bad_offset, position = found
        for batch in messages.values():
            batch.t_ns = self._stamps_of(batch)
        self._count(messages)
        messages = {message.name: messages[message.name] for message in self.definition.layout.messages}
        bad_t_ns = bad_offset
        if len(bad_offset):
            bad_t_ns = np.array(self._stamps)[np.searchsorted(self._ends, bad_offset, side="right")]
        self._suspect += sum(int(np.count_nonzero(batch.suspect)) for batch in messages.values())
        self._decided = position
        decided = bisect_right(self._ends, position)
        del self._ends[:decided], self._stamps[:decided]
        return LinkBatch(messages, bad_offset, bad_t_ns)

    def _stamps_of(self, batch: MessageBatch) -> Integers:
        """Stamp of the chunk with the last byte of each frame; few chunks, many frames: count frames per chunk."""
        if not len(batch.offset):
            return np.empty(0, np.int64)
        first, last = (bisect_left(self._ends, int(batch.ends[at])) for at in (0, -1))
        if first == last:
            return np.full(len(batch.offset), self._stamps[first], np.int64)
        complete = np.searchsorted(batch.ends, self._ends[first : last + 1], side="right")
        complete[1:] -= complete[:-1].copy()
        return np.repeat(np.array(self._stamps[first : last + 1]), complete)

    def _count(self, messages: Mapping[str, MessageBatch]) -> None:
        counting = []
        for batch in messages.values():
            if batch.message.counter is not None and len(batch.offset):
                counting.append(batch)
            elif batch.message.counter is not None:
                batch.counter = np.empty(0, np.int64)
        groups = [counting] if self.definition.layout.shared_counter else [[batch] for batch in counting]
        for group in groups if counting else ():
            self._unwrap(group)

    def _unwrap(self, group: list[MessageBatch]) -> None:
        """Unwrap the counter that the messages of a group share, in stream order."""
        field = group[0].message.counter
        assert field is not None
        key = "" if self.definition.layout.shared_counter else group[0].message.name
        unwrapper = self._counters.get(key)
        if unwrapper is None:
            wrap = field.wrap or 1 << field.width
            unwrapper = self._counters[key] = CounterUnwrapper(wrap, self.definition.rate_Hz)
        offset = np.concatenate([batch.offset for batch in group])
        order = np.argsort(offset, kind="stable")
        raw = np.concatenate([_counted(batch, field) for batch in group])
        stamps = np.concatenate([batch.t_ns for batch in group if batch.t_ns is not None])

        def contents(first: int) -> list[bytes]:
            if len(group) == 1:
                return _bytes_of(group[0], first)
            frames = [frame for batch in group for frame in _bytes_of(batch, 0)]
            return [frames[at] for at in order[first:].tolist()]

        result = unwrapper.feed(raw[order], stamps[order], contents)
        self._lost += result.lost
        self._duplicate += result.duplicate
        self._jumps += result.jumps
        counter, suspect = np.empty_like(result.counter), np.empty_like(result.suspect)
        counter[order], suspect[order] = result.counter, result.suspect
        at = 0
        for batch in group:
            batch.counter = counter[at : at + len(batch.offset)]
            batch.suspect = batch.suspect | suspect[at : at + len(batch.offset)]
            at += len(batch.offset)


def _counted(batch: MessageBatch, field: Field) -> Integers:
    """Return the counters of a batch as sent, without bits of the field that do not count."""
    raw = batch.raw(field.name).astype(np.int64)
    return raw & (field.wrap - 1) if field.wrap and field.bits else raw


def _bytes_of(batch: MessageBatch, first: int) -> list[bytes]:
    """Return the bytes of the frames of a batch, from one of them on, without their checks."""
    width, flat = batch.message.body, batch.rows[first:].tobytes()
    frames = [flat[at : at + width] for at in range(0, len(flat), width)]
    return frames if batch.rest is None else list(map(add, frames, batch.rest[first:]))


def _joined(parts: list[LinkBatch]) -> LinkBatch:
    """Batches that follow each other in the stream, as one."""
    if len(parts) == 1:
        return parts[0]
    messages = {name: MessageBatch.join([part.messages[name] for part in parts]) for name in parts[0].messages}
    return LinkBatch(
        messages,
        np.concatenate([part.bad_offset for part in parts]),
        np.concatenate([part.bad_t_ns for part in parts]),
    )


class Unwrapped(NamedTuple):
    """Counters (n,) int64 without wrap, suspect marks (n,) bool; numbers of lost, repeated, suspect frames, jumps."""

    counter: Integers
    suspect: Flags
    lost: int
    duplicate: int
    doubtful: int = 0
    jumps: int = 0


class CounterUnwrapper:
    """Follows one counter of ``wrap`` values through a stream.

    A step is the one, modulo the wrap, that is nearest to what the receive times and the rate predict; so gaps longer
    than a wrap are resolved. A step back by at most 64 is a repeated frame, if one may have been there and none with
    that counter had other contents. A step that is a quarter of a wrap or 16,384 frames ahead of the prediction, or
    further back, is implausible: that frame is suspect and carries the last counter. If the next frame goes on from it,
    the unit has restarted its counter, or more frames are lost than it tells: counting goes on as the time predicts;
    without times that is a jump, of which nobody knows how long it was.
    """

    def __init__(self, wrap: int, rate_Hz: float | None) -> None:
        self._wrap = wrap
        self._rate_Hz = rate_Hz
        self._reach, self._ahead = min(REPEAT_REACH, wrap // 4), min(_FARTHEST, wrap / 4)
        self._started = False
        self._raw = 0  # counter as sent of the last trusted frame
        self._last = 0  # its unwrapped counter
        self._highest = self._first = 0
        self._t_ns = 0
        self._begun_ns: int | None = None  # stamp of the first frame: until another one comes, nobody knows the time
        self._recent: dict[int, bytes] = {}  # contents of the last frames by counter
        self._rejected: int | None = None  # counter as sent of a suspect frame, if that was the last one
        self._missed = 0.0  # frames that time has predicted since the last trusted one

    def feed(self, raw: Integers, t_ns: Integers, contents: Contents) -> Unwrapped:
        """Unwrap the counters of the next frames.

        Args:
            raw: (n,) counters as sent.
            t_ns: (n,) receive stamps of their chunks, all alike without times.
            contents: gives the bytes of the frames from that one on.
        """
        if not len(raw):
            return Unwrapped(np.empty(0, np.int64), np.empty(0, np.bool_), 0, 0)
        if not self._started:
            self._started = True
            self._raw = self._last = self._highest = self._first = int(raw[0]) - 1
            self._t_ns = int(t_ns[0])
            self._begun_ns = None if self._rate_Hz is None else self._t_ns
        expected, before_ns = self._expected(len(raw), t_ns), self._t_ns
        self._t_ns = int(t_ns[-1])
        step = np.empty(len(raw), np.int64)
        step[0] = raw[0] - self._raw
        np.subtract(raw[1:], raw[:-1], out=step[1:])
        step &= self._wrap - 1
        steady = self._rejected is None and self._last == self._highest
        if steady and isinstance(expected, float) and (step == 1).all():
            result = self._advance(len(raw), int(raw[-1]))
        else:
            result = self._resolved(raw, step, expected, t_ns, before_ns, contents)
        self._keep(result, contents)
        return result

    def _advance(self, count: int, raw: int) -> Unwrapped:
        """Return nothing lost, nothing repeated."""
        counter = np.arange(self._last + 1, self._last + 1 + count, dtype=np.int64)
        self._raw, self._last = raw, self._last + count
        self._highest = self._last
        return Unwrapped(counter, np.zeros(count, np.bool_), 0, 0)

    def _resolved(self, raw: Integers, step: Integers, expected: Floats | float,
                  t_ns: Integers, before_ns: int, contents: Contents) -> Unwrapped:  # fmt: skip
        step += self._wrap * np.rint((expected - step) / self._wrap).astype(np.int64)
        counter = self._last + np.cumsum(step)
        odd = (step < -self._reach) | (step - expected > self._ahead)
        if self._rejected is not None or odd.any() or self._differs(counter, contents):
            return self._account(*self._one_by_one(raw, expected, t_ns, before_ns, contents))
        self._raw, self._last = int(raw[-1]), int(counter[-1])
        return self._account(counter, np.zeros(len(raw), np.bool_), [])

    def _differs(self, counter: Integers, contents: Contents) -> bool:
        """Return whether frames with the same counter differ."""
        if counter[0] > self._highest and (counter[1:] > counter[:-1]).all():
            return False
        if counter.min() <= max(self._first, self._highest - 2 * REPEAT_REACH):
            return True
        recent = dict(self._recent)
        frames = zip(counter.tolist(), contents(0), strict=True)
        return any(recent.setdefault(value, content) != content for value, content in frames)

    def _keep(self, result: Unwrapped, contents: Contents) -> None:
        """Keep what may be repeated yet."""
        oldest = self._highest - 2 * REPEAT_REACH
        first = int(np.argmax(result.counter > oldest))
        frames = zip(result.counter[first:].tolist(), contents(first), result.suspect[first:].tolist(), strict=True)
        self._recent |= {value: content for value, content, suspect in frames if not suspect}
        if next(iter(self._recent), oldest) <= oldest:
            self._recent = {value: content for value, content in self._recent.items() if value > oldest}

    def _expected(self, count: int, t_ns: Integers) -> Floats | float:
        """Predicted step of each frame: 1 inside a chunk; at its start the time since the last one, less its frames.

        A plain 1.0 means 1 for all.
        """
        if self._rate_Hz is None:
            return 1.0
        per_ns = self._rate_Hz / NS
        if t_ns[0] == t_ns[-1]:  # one chunk
            behind_ns = int(t_ns[0]) - self._t_ns
            late_one = behind_ns * per_ns - (count - 1) if behind_ns else 0.0
            return 1.0 if late_one < 1.5 else np.concatenate(([late_one], np.ones(count - 1)))
        changed = np.flatnonzero(t_ns[1:] != t_ns[:-1]) + 1
        first = np.concatenate((_START, changed)) if t_ns[0] != self._t_ns else changed
        if not len(first):
            return 1.0
        before = t_ns[first - 1]
        if first[0] == 0:
            before[0] = self._t_ns
        frames = np.concatenate((first[1:], [count])) - first
        late = (t_ns[first] - before) * per_ns - (frames - 1)
        if late.max() < 1.5:
            return 1.0
        expected = np.ones(count)
        expected[first] = np.where(late < 1.5, 1.0, late)  # the same for a chunk whatever else is in the batch
        return expected

    def _one_by_one(self, raw: Integers, expected: Floats | float,
                    t_ns: Integers, before_ns: int,
                    contents: Contents) -> tuple[Integers, Flags, list[int]]:  # fmt: skip
        """Return counters, suspect marks, and the frames that are the first ones behind a jump."""
        counter = np.empty(len(raw), np.int64)
        suspect = np.zeros(len(raw), np.bool_)
        jumps: list[int] = []
        highest, before, recent = self._highest, self._last, dict(self._recent)
        frames = contents(0)
        due_each = np.broadcast_to(expected, len(raw)).tolist()
        for index, (value, due) in enumerate(zip(raw.tolist(), due_each, strict=True)):
            timed = self._begun_ns is not None and t_ns[index] != self._begun_ns
            due += self._missed if timed else min(self._missed, self._ahead)
            forward = (value - self._raw) % self._wrap
            step = forward + self._wrap * round((due - forward) / self._wrap)
            at = self._last + step
            again = at > max(self._first, highest - 2 * REPEAT_REACH) and recent.get(at, frames[index]) == frames[index]
            stands = self._rejected in (value, (value + 1) % self._wrap)  # or it counts down
            same = (step > 0 or again) and not stands
            if -self._reach <= step <= due + self._ahead and same:
                self._last = at
            elif self._rejected is not None and 0 < (value - self._rejected) % self._wrap <= self._reach:
                self._last = highest + max(1, round(due))
                if not timed:
                    jumps.append(index)
                else:
                    first, stop = (int(np.searchsorted(t_ns, t_ns[index], side)) for side in ("left", "right"))
                    since, since_ns = (counter[first - 1], t_ns[first - 1]) if first else (before, before_ns)
                    predicted = since + (t_ns[index] - since_ns) * (self._rate_Hz or 0.0) / NS - (stop - 1 - index)
                    self._last = max(self._last, round(float(predicted)))
            else:
                suspect[index], counter[index] = True, self._last
                self._rejected, self._missed = value, due
                continue
            self._raw, self._rejected, self._missed = value, None, 0.0
            counter[index] = self._last
            highest = max(highest, self._last)
            recent.setdefault(self._last, frames[index])
        return counter, suspect, jumps

    def _account(self, counter: Integers, suspect: Flags, jumps: list[int]) -> Unwrapped:
        highest = np.maximum.accumulate(np.concatenate(([self._highest], np.where(suspect, self._highest, counter))))
        steps = highest[1:] - highest[:-1]
        self._highest = int(highest[-1])
        new, doubtful = np.count_nonzero(steps), np.count_nonzero(suspect)
        lost = int(steps.sum() - new - (steps[jumps] - 1).sum())
        return Unwrapped(counter, suspect, lost, int(len(counter) - doubtful - new), int(doubtful), len(jumps))
