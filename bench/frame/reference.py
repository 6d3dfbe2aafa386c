"""The reference engine: one byte at a time, plain Python. It is the oracle of the vectorised engine.

At each position: no sync -> one byte on; sync but not all bytes there -> wait, unless the line has been silent since;
check, length or type wrong -> count one rejected candidate, one byte on; else accept the frame and go on behind it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame.batch import Extract, FrameBatch, FrameCounts, MessageBatch
from bench.frame.layout import Field, Layout, Message, read_element, read_part
from bench.frame.parts import rows_of_parts, unpacked, wire_length


def read_column(rows: NDArray[np.uint8], item: Field) -> NDArray[Any]:
    """Raw values of a field, frame by frame; same shapes, types and, of floats that are no numbers, bits as others."""
    frames = [row.tobytes() for row in rows]
    if item.kind == "f":
        begins = [item.place(element)[0] for element in range(1 if item.count is None else item.count)]
        floats = b"".join(frame[at : at + item.size] for frame in frames for at in begins)
        column = np.frombuffer(floats, f"{'>' if item.big else '<'}{item.dtype}").astype(item.dtype)
        return column if item.count is None else column.reshape(len(frames), item.count)
    if item.count is None:
        return np.array([read_element(frame, item) for frame in frames], item.dtype)
    values = [[read_element(frame, item, element) for element in range(item.count)] for frame in frames]
    return np.array(values, item.dtype).reshape(len(frames), item.count)


class ReferenceDecoder:
    """Byte-at-a-time decoder; same interface and results as ``NumpyDecoder``; ``extract`` cuts the fields out."""

    def __init__(self, layout: Layout, extract: Extract = read_column) -> None:
        self._layout = layout
        self._extract = extract
        self._tail = b""
        self._position = 0
        self.counts = FrameCounts()

    def feed(self, chunk: bytes) -> FrameBatch:
        """Decode what can be decided; the undecided tail waits for the next feed."""
        self.counts.bytes += len(chunk)
        return self._run(self._tail + chunk, final=False)

    def finish(self) -> FrameBatch:
        """End of the stream: candidates whose bytes never came are no frames."""
        return self._run(self._tail, final=True)

    def give_up(self, before: int) -> FrameBatch:
        """Reject what was begun before the stream offset ``before`` and is not whole yet, byte by byte."""
        return self._run(self._tail, final=False, before=before)

    def _run(self, stream: bytes, final: bool, before: int = 0) -> FrameBatch:
        found: dict[str, list[tuple[int, bytes]]] = {message.name: [] for message in self._layout.kinds}
        bad: list[int] = []
        at = 0
        pattern = self._layout.pattern
        while at < len(stream):
            may_wait = not final and self._position + at >= before
            if len(stream) - at < self._layout.sync_at + len(pattern) and may_wait:
                break
            if not stream.startswith(pattern, at + self._layout.sync_at):
                at += 1
                self.counts.skipped_bytes += 1
                continue
            length, message = self._measure(stream, at)
            if length is None or at + length > len(stream):
                if may_wait:
                    break
                if not final:
                    bad.append(self._position + at)
            elif message is not None and self._passes(stream[at : at + length], message):
                found[message.name].append((at, stream[at : at + length]))
                at += length
                continue
            else:
                bad.append(self._position + at)
            at += 1
            self.counts.skipped_bytes += 1
        batch = self._batch(found, bad, at)
        self._tail = stream[at:]
        return batch

    def _measure(self, stream: bytes, at: int) -> tuple[int | None, Message | None]:
        """Length and message of the candidate at ``at``; None: not known yet. Implausible ones have length 0."""
        layout = self._layout
        if at + layout.header > len(stream):
            return None, None
        head = stream[at : at + layout.header]
        message: Message | None = layout.messages[0]
        if layout.type_field is not None:
            value = read_part(head, layout.type_field, layout.type_bits)
            message = next((m for m in layout.messages if m.type_value == value), layout.unlisted)
        if message is None:
            return 0, None
        length = message.length
        if layout.says_its_length:
            fields = wire_length(message, head)
            return (fields + layout.tail, message) if fields else (0, None)
        if layout.length_field is not None:
            stated = read_part(head, layout.length_field, layout.length_bits)
            length = stated * layout.length_times + layout.length_plus
            if length < message.least + layout.tail or length > layout.max_length:
                return 0, None
            if message.length not in (0, length):
                return 0, None
        return length, message

    def _passes(self, frame: bytes, message: Message) -> bool:
        right = frame.endswith(self._layout.trailer) and checks_of(self._layout, message, frame)[0]
        if not right or not message.parts:
            return right
        return not isinstance(unpacked(message, frame, len(frame) - self._layout.tail), str)

    def _batch(self, found: dict[str, list[tuple[int, bytes]]], bad: list[int], consumed: int) -> FrameBatch:
        messages = {}
        for message in self._layout.told:
            frames = found[message.name]
            offset = np.array([self._position + at for at, _ in frames], np.int64)
            if message.parts:
                rows, rest = rows_of_parts(message, (frame for _, frame in frames), self._layout.tail)
            else:
                rows = np.frombuffer(b"".join(frame[: message.body] for _, frame in frames), np.uint8)
                tail = self._layout.tail
                rest = (
                    None if message.rest is None else [frame[message.body : len(frame) - tail] for _, frame in frames]
                )
            batch = MessageBatch(message, offset, rows.reshape(len(frames), message.body), rest, self._extract)
            if message.parts or message is self._layout.unlisted:
                batch.ends = offset + np.array([len(frame) for _, frame in frames], np.int64)
            messages[message.name] = batch
        for message in self._layout.messages:
            number = len(found[message.name])
            self.counts.frames += number
            self.counts.by_message[message.name] = self.counts.by_message.get(message.name, 0) + number
        self.counts.other += 0 if self._layout.unlisted is None else len(found[self._layout.unlisted.name])
        self.counts.bad += len(bad)
        self._position += consumed
        return FrameBatch(messages, np.array(bad, np.int64), self._position)


def checks_of(layout: Layout, message: Message, frame: bytes) -> tuple[bool, int, int]:
    """Return whether the check of a frame is right, the one computed and the one that it holds."""
    size, end = layout.check.size, len(frame) - layout.tail
    at = end if layout.check_field is None else layout.check_field.offset
    stop = end if message.cover_stop is None else message.cover_stop
    blank = frame if layout.check_field is None else frame[:at] + bytes(size) + frame[at + size :]
    computed = layout.check.of(blank[message.cover_start : stop] + message.extra)
    stored = int.from_bytes(frame[at : at + size], "big" if layout.stored_big else "little")
    return computed == stored, computed, stored
