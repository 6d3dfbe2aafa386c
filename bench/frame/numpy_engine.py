"""The vectorised engine: same offsets, counts and fields as the reference engine, on any damage and any chunking.

Two ways through a block: the lattice (rows on the stride of frames that are all of one message and length, each with
its check right), and behind anything else the scan (all sync candidates of a window, their checks in bulk, then first
come first served).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bench.frame.batch import Decoder, FrameBatch, MessageBatch, are_right, extract_column, rows_of_frames
from bench.frame.layout import Layout, Message, part_of
from bench.frame.parts import unpacked, wire_length
from bench.model.arrays import Flags, Integers, Octets

_UNKNOWN = -1  # all bytes of the header are not there yet
_WRONG = 0  # length or type makes no sense
_BLOCK_ROWS = 4096
_WINDOW_BYTES = 1 << 18
_GATHERED_BYTES = 1 << 24  # of candidates that are checked at once


class Found(NamedTuple):
    """Accepted frames in order, rejected candidates, first undecided byte. All in buffer offsets."""

    start: Integers
    length: Integers
    message: Integers
    bad: Integers
    position: int


_NONE = np.empty(0, np.int64)


class Alike(NamedTuple):
    """Number of a message and length of frames of it, and by their places the bytes that say so."""

    message: int
    length: int
    head: dict[int, int]


class Scanner:
    """Finds, measures and checks all candidates of a window at once."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._sync_end = layout.sync_at + len(layout.pattern)

    def scan(self, buffer: Octets, at: int, stop: int, final: bool, before: int = 0) -> Found:
        """Decode buffer[at:stop] as the reference engine would; ``final``: nothing will follow.

        What begins among the first ``before`` bytes and is not whole is rejected: a tail, shorter than a frame, is due.
        """
        window = buffer[at:stop]
        candidates = _find(window[self._layout.sync_at :], self._layout.pattern)
        length, message = self._measure(window, candidates)
        complete = (length > 0) & (candidates + length <= len(window))
        valid = np.zeros(len(candidates), np.bool_)
        for index, item in enumerate(self._layout.kinds):
            self._check(window, candidates, length, complete & (message == index), item, valid)
        waiting = ((length == _UNKNOWN) | ((length > 0) & ~complete)) & (candidates >= before)
        last = len(window) if final else max(len(window) - self._sync_end + 1, min(before, len(window)), 0)
        events = np.flatnonzero(valid if final else valid | waiting)
        taken, position = _serve(candidates, length, waiting, events, last)
        accepted = candidates[taken]
        rejected = candidates[~valid & ~waiting]
        rejected = _outside(rejected[rejected < position], accepted, length[taken])
        return Found(accepted + at, length[taken], message[taken], rejected + at, at + position)

    def alike(self, buffer: Octets, found: Found) -> Alike | None:
        """Return what frames have in common if those of a scan are of one message and length; None if they are not."""
        layout, start, length, message = self._layout, found.start, found.length, found.message
        if (length != length[0]).any() or (message != message[0]).any() or layout.kinds[message[0]].parts:
            return None
        places = list(range(layout.sync_at, self._sync_end))
        for item in (layout.length_field, layout.type_field):
            places += [] if item is None else range(item.offset, item.end)
        first = int(start[0])
        return Alike(int(message[0]), int(length[0]), {place: int(buffer[first + place]) for place in places})

    def _measure(self, window: Octets, at: Integers) -> tuple[Integers, Integers]:
        layout = self._layout
        length = np.full(len(at), layout.messages[0].length, np.int64)
        message = np.zeros(len(at), np.int64)
        if layout.says_its_length:
            for index, begin in enumerate(at.tolist()):
                length[index] = self._said(window[begin : begin + layout.header].tobytes())
            return length, message
        if layout.length_field is None and layout.type_field is None:
            return length, message
        there = at + layout.header <= len(window)
        head = sliding_window_view(window, layout.header)[at[there]] if there.any() else np.empty((0, layout.header))
        head = head.astype(np.uint8, copy=False)
        kind = np.zeros(len(head), np.int64)
        if layout.type_field is not None:
            value = part_of(extract_column(head, layout.type_field), layout.type_bits)
            kind = np.full(len(head), -1 if layout.unlisted is None else len(layout.messages), np.int64)
            for index, item in enumerate(layout.messages):
                kind[value == item.type_value] = index
        body = np.array([item.least + layout.tail for item in layout.kinds])[kind]
        fixed = np.array([item.length for item in layout.kinds])[kind]
        size = fixed.copy()
        if layout.length_field is not None:
            stated = part_of(extract_column(head, layout.length_field).astype(np.int64), layout.length_bits)
            size = stated * layout.length_times + layout.length_plus
            size[(size < body) | (size > layout.max_length) | ((fixed > 0) & (size != fixed))] = _WRONG
        size[kind < 0] = _WRONG
        length[:] = _UNKNOWN
        length[there] = size
        message[there] = kind
        return length, message

    def _said(self, head: bytes) -> int:
        """Return the length of a frame whose head says it."""
        if len(head) < self._layout.header:
            return _UNKNOWN
        fields = wire_length(self._layout.messages[0], head)
        return fields + self._layout.tail if fields else _WRONG

    def _check(self, window: Octets, at: Integers, length: Integers,
               chosen: Flags, message: Message, valid: Flags) -> None:  # fmt: skip
        """Set ``valid`` for the chosen candidates whose check passes; those of one length are checked together."""
        places = np.flatnonzero(chosen)
        places = places[np.argsort(length[places], kind="stable")]
        for which in np.split(places, np.flatnonzero(np.diff(length[places])) + 1) if len(places) else ():
            total = int(length[which[0]])
            frames, step = sliding_window_view(window, total), max(1, _GATHERED_BYTES // total)
            parts = [at[which[low : low + step]] for low in range(0, len(which), step)]
            right = np.concatenate([are_right(self._layout, message, frames[begins]) for begins in parts])
            for index in np.flatnonzero(right).tolist() if message.parts else ():
                begin = int(at[which[index]])
                contents = unpacked(message, window[begin : begin + total].tobytes(), total - self._layout.tail)
                right[index] = not isinstance(contents, str)
            valid[which] = right


def _find(window: Octets, pattern: bytes) -> Integers:
    """Return offsets of the whole pattern, ascending."""
    ends = len(window) - len(pattern) + 1
    if ends <= 0:
        return np.empty(0, np.int64)
    at = np.flatnonzero(window[:ends] == pattern[0])
    for index in range(1, len(pattern)):
        at = at[window[at + index] == pattern[index]]
    return at.astype(np.int64, copy=False)


def _serve(at: Integers, length: Integers, waiting: Flags, events: Integers,
           last: int) -> tuple[Integers, int]:  # fmt: skip
    """First come, first served: accepted candidates, and the position where the search must wait for more bytes.

    ``events`` are the candidates that are valid or must wait. Without overlap and waiting nothing is decided in order.
    """
    starts, ends = at[events], at[events] + length[events]
    if not waiting[events].any() and not (starts[1:] < ends[:-1]).any():
        return events, max(int(ends[-1]) if len(ends) else 0, last)
    taken: list[int] = []
    free = 0
    for event, start, end, must_wait in zip(
        events.tolist(), starts.tolist(), ends.tolist(), waiting[events].tolist(), strict=True
    ):
        if start < free:
            continue
        if must_wait:
            return np.array(taken, np.int64), start
        taken.append(event)
        free = end
    return np.array(taken, np.int64), max(free, last)


def _outside(at: Integers, start: Integers, length: Integers) -> Integers:
    """Those of ``at`` that lie in none of the intervals [start, start + length), which are sorted."""
    if not len(start) or not len(at):
        return at
    before = np.searchsorted(start, at, side="right") - 1
    inside = (before >= 0) & (at < (start + length)[before])
    return at[~inside]


class NumpyDecoder(Decoder):
    """Vectorised decoder; feed it blocks of up to a few megabytes."""

    def __init__(self, layout: Layout) -> None:
        super().__init__(layout)
        self._scanner = Scanner(layout)
        self._alike: Alike | None = None  # while nothing is damaged
        if layout.fixed:
            self._alike = Alike(0, layout.messages[0].length, dict(enumerate(layout.pattern, layout.sync_at)))
        self._none = [
            MessageBatch(message, _NONE, np.empty((0, message.body), np.uint8), None if message.rest is None else [])
            for message in layout.told
        ]  # fmt: skip

    def feed(self, chunk: bytes, final: bool = False, before: int = 0) -> FrameBatch:
        self.counts.bytes += len(chunk)
        stream = self._tail + chunk
        before -= self._position
        buffer = np.frombuffer(stream, np.uint8)
        window = max(_WINDOW_BYTES, 4 * self._layout.max_length)
        found: list[Found] = []
        at, waiting = 0, False
        while at < len(buffer) and not waiting:
            if self._alike is not None:
                run, rows = self._lattice(buffer, at, self._alike)
                found.append(run)
                at = run.position
                if rows and len(run.start) == rows:
                    continue
                if not (rows or final or at < before) and self._begins(buffer[at:], self._alike):
                    break
            stop = min(len(buffer), at + window)
            part = self._scanner.scan(buffer, at, stop, final and stop == len(buffer), before - at)
            if len(part.bad):
                self._alike = None
            elif len(part.start):
                self._alike = self._scanner.alike(buffer, part)
            found.append(part)
            waiting = stop == len(buffer)
            at = part.position
        return self._batch(stream, buffer, found, at)

    def _lattice(self, buffer: Octets, at: int, alike: Alike) -> tuple[Found, int]:
        """Return the good rows from ``at`` on before the first bad one, and number of rows looked at."""
        number, length, head = alike
        rows = min((len(buffer) - at) // length, _BLOCK_ROWS)
        block = buffer[at : at + rows * length].reshape(rows, length)
        good = np.ones(rows, np.bool_)
        for place, byte in head.items():
            good &= block[:, place] == byte
        good = are_right(self._layout, self._layout.kinds[number], block[: _leading(good)])
        count = _leading(good)
        stop = at + count * length
        starts = np.arange(at, stop, length)
        return Found(starts, np.full(count, length), np.full(count, number), _NONE, stop), rows

    def _begins(self, rest: Octets, alike: Alike) -> bool:
        """Return whether the bytes may be the beginning of one more frame of the same kind."""
        return all(rest[place] == byte for place, byte in alike.head.items() if place < len(rest))

    def _batch(self, stream: bytes, buffer: Octets, found: list[Found], consumed: int) -> FrameBatch:
        start, length, kind, bad, _ = found[0] if len(found) == 1 else _joined(found)
        numbers = np.bincount(kind, minlength=len(self._layout.kinds)).tolist()
        self.counts.skipped_bytes += consumed - int(length.sum())
        messages = {}
        for index, message in enumerate(self._layout.told):
            number = numbers[index]
            if not number:
                messages[message.name] = self._none[index]
                continue
            mine = slice(number) if number == len(start) else np.flatnonzero(kind == index)
            starts, lengths = start[mine], length[mine]
            rows, rest = self._rows(stream, buffer, starts, lengths, message)
            messages[message.name] = MessageBatch(message, starts + self._position, rows, rest)
            messages[message.name].ends = starts + lengths + self._position
        return self._decided(messages, numbers, bad + self._position, stream, consumed)

    def _rows(self, stream: bytes, buffer: Octets, starts: Integers, lengths: Integers,
              message: Message) -> tuple[Octets, list[bytes] | None]:  # fmt: skip
        tail = self._layout.tail
        if not message.parts and message.rest is None:
            return rows_of(buffer, starts, message), None
        bounds = zip(starts.tolist(), lengths.tolist(), strict=True)
        return rows_of_frames(message, (stream[start : start + length] for start, length in bounds), tail)


def _joined(found: list[Found]) -> Found:
    """Return what was found in parts of a stream that follow each other, as one."""
    *columns, positions = zip(Found(_NONE, _NONE, _NONE, _NONE, 0), *found, strict=True)
    return Found._make([*map(np.concatenate, columns), positions[-1]])


def _leading(good: Flags) -> int:
    """Return number of True before the first False."""
    first = int(good.argmin()) if len(good) else 0
    return len(good) if not len(good) or good[first] else first


def rows_of(buffer: Octets, starts: Integers, message: Message) -> Octets:
    """Return frame bytes (n, body): a view of the stream where it is one unbroken lattice, else gathered."""
    first = int(starts[0])
    if message.length and starts[-1] - first == (len(starts) - 1) * message.length:
        frames = buffer[first : first + len(starts) * message.length].reshape(len(starts), message.length)
        return frames[:, : message.body]
    return sliding_window_view(buffer, message.body)[starts]
