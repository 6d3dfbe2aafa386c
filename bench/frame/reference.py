"""The reference engine: one byte at a time, plain Python. It is the oracle of the vectorised engine.

At each position: no sync -> one byte on; sync but not all bytes there -> wait, unless the line has been silent since;
check, length or type wrong -> count one rejected candidate, one byte on; else accept the frame and go on behind it.
"""

from __future__ import annotations

import numpy as np

from bench.frame.batch import Decoder, FrameBatch, MessageBatch, rows_of_frames
from bench.frame.refusal import Refusal, measured, why_none

Pieces = dict[str, list[tuple[int, bytes]]]
"""By message the frames of a stream, each with its offset there."""


class ReferenceDecoder(Decoder):
    """Byte-at-a-time decoder; same interface and results as ``NumpyDecoder``."""

    def feed(self, chunk: bytes, final: bool = False, before: int = 0) -> FrameBatch:
        self.counts.bytes += len(chunk)
        stream = self._tail + chunk
        found: Pieces = {message.name: [] for message in self._layout.kinds}
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
        return self._batch(found, bad, stream, at)

    def _batch(self, found: Pieces, bad: list[int], stream: bytes, consumed: int) -> FrameBatch:
        numbers = [len(found[message.name]) for message in self._layout.kinds]
        messages = {}
        for message in self._layout.told:
            frames = found[message.name]
            offset = np.array([self._position + at for at, _ in frames], np.int64)
            rows, rest = rows_of_frames(message, (frame for _, frame in frames), self._layout.tail)
            batch = MessageBatch(message, offset, rows, rest)
            batch.ends = offset + np.array([len(frame) for _, frame in frames], np.int64)
            messages[message.name] = batch
        return self._decided(messages, numbers, np.array(bad, np.int64), stream, consumed)
