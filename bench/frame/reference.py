"""The reference engine: one byte at a time, plain Python. It is the oracle of the vectorised engine.

At each position: no sync -> one byte on; sync but not all bytes there -> wait, unless the line has been silent since;
check, length or type wrong -> count one rejected candidate, one byte on; else accept the frame and go on behind it.
"""

from __future__ import annotations

import numpy as np

from bench.frame.batch import FrameBatch, FrameCounts, MessageBatch, rows_of_frames
from bench.frame.layout import Layout
from bench.frame.refusal import Refusal, measured, why_none


class ReferenceDecoder:
    """Byte-at-a-time decoder; same interface and results as ``NumpyDecoder``."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
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
            head = stream[at : at + self._layout.header]
            read = measured(self._layout, head) if len(head) == self._layout.header else None
            if read is None or (not isinstance(read, Refusal) and at + read[1] > len(stream)):
                if may_wait:
                    break
                if not final:
                    bad.append(self._position + at)
            elif not isinstance(read, Refusal) and why_none(self._layout, read[0], stream[at : at + read[1]]) is None:
                found[read[0].name].append((at, stream[at : at + read[1]]))
                at += read[1]
                continue
            else:
                bad.append(self._position + at)
            at += 1
            self.counts.skipped_bytes += 1
        batch = self._batch(found, bad, at)
        self._tail = stream[at:]
        return batch

    def _batch(self, found: dict[str, list[tuple[int, bytes]]], bad: list[int], consumed: int) -> FrameBatch:
        messages = {}
        for message in self._layout.told:
            frames = found[message.name]
            offset = np.array([self._position + at for at, _ in frames], np.int64)
            rows, rest = rows_of_frames(message, (frame for _, frame in frames), self._layout.tail)
            batch = MessageBatch(message, offset, rows, rest)
            batch.ends = offset + np.array([len(frame) for _, frame in frames], np.int64)
            messages[message.name] = batch
        numbers = [len(found[message.name]) for message in self._layout.kinds]
        listed = len(self._layout.messages)
        self.counts.frames += sum(numbers[:listed])
        self.counts.other += sum(numbers[listed:])
        self.counts.bad += len(bad)
        self._position += consumed
        return FrameBatch(messages, np.array(bad, np.int64), self._position)
