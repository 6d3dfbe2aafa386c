"""The vectorised engine: same offsets, counts and fields as the reference engine, on any damage and any chunking.

Two ways through a block: the lattice (rows on the stride of a fixed length, all with sync and check right), and behind
any damage the scan (all sync candidates of a window, their checks in bulk, then first come first served).
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bench.frame.batch import FrameBatch, FrameCounts, MessageBatch
from bench.frame.extract import extract_column
from bench.frame.layout import Layout, Message
from bench.frame.scan import Found, Scanner, stored_value

_BLOCK_ROWS = 4096
_NONE = np.empty(0, np.int64)
_WINDOW_BYTES = 1 << 18

Run = tuple[int, int]  # first byte, number of rows


class NumpyDecoder:
    """Vectorised decoder; feed it blocks of up to a few megabytes."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._scanner = Scanner(layout)
        self._tail = b""
        self._position = 0
        self._damaged = False
        self.counts = FrameCounts()

    def feed(self, chunk: bytes) -> FrameBatch:
        """Decode what can be decided; the undecided tail waits for the next feed."""
        self.counts.bytes += len(chunk)
        return self._run(self._tail + chunk if self._tail else chunk, final=False)

    def finish(self) -> FrameBatch:
        """End of the stream: candidates whose bytes never came are no frames."""
        return self._run(self._tail, final=True)

    def give_up(self, before: int) -> FrameBatch:
        """Reject what was begun before the stream offset ``before`` and is not whole yet, byte by byte."""
        return self._run(self._tail, final=False, before=before - self._position)

    def _run(self, stream: bytes, final: bool, before: int = 0) -> FrameBatch:
        buffer = np.frombuffer(stream, np.uint8)
        layout = self._layout
        window = max(_WINDOW_BYTES, 4 * layout.max_length)
        found: list[Run | Found] = []
        bad: list[NDArray[np.int64]] = []
        at, waiting = 0, False
        while at < len(buffer) and not waiting:
            if layout.fixed and not self._damaged:
                good, rows = self._lattice(buffer, at)
                if good:
                    found.append((at, good))
                    at += good * layout.messages[0].length
                if rows and good == rows:
                    continue
            stop = min(len(buffer), at + window)
            part = self._scanner.scan(buffer, at, stop, final and stop == len(buffer), before - at)
            self._damaged = len(part.bad) > 0
            found.append(part)
            bad.append(part.bad)
            waiting = stop == len(buffer)
            at = part.position
        return self._batch(stream, buffer, found, np.concatenate([_NONE, *bad]), at)

    def _lattice(self, buffer: NDArray[np.uint8], at: int) -> Run:
        """Return number of good rows from ``at`` on before the first bad one, and number of rows looked at."""
        message = self._layout.messages[0]
        rows = min((len(buffer) - at) // message.length, _BLOCK_ROWS)
        block = buffer[at : at + rows * message.length].reshape(rows, message.length)
        pattern = self._layout.pattern
        good = np.ones(rows, np.bool_)
        for index, byte in enumerate(pattern):
            good &= block[:, index] == byte
        leading = _leading(good)
        block = block[:leading]
        size = self._layout.check.size
        stop = message.length - size if message.cover_stop is None else message.cover_stop
        values = self._layout.check.of_rows(block[:, message.cover_start : stop])
        return _leading(values == stored_value(block[:, -size:], self._layout.stored_big)), rows

    def _batch(self, stream: bytes, buffer: NDArray[np.uint8], found: list[Run | Found], bad: NDArray[np.int64],
               consumed: int) -> FrameBatch:  # fmt: skip
        messages = {}
        accepted = 0
        for index, message in enumerate(self._layout.messages):
            starts, lengths = _starts(found, index, message.length)
            rows = _rows(buffer, starts, message)
            rest = None
            if message.rest is not None:
                size = self._layout.check.size
                bounds = zip(starts.tolist(), lengths.tolist(), strict=True)
                rest = [stream[start + message.body : start + length - size] for start, length in bounds]
            messages[message.name] = MessageBatch(message, starts + self._position, rows, rest, extract_column)
            self.counts.frames += len(starts)
            self.counts.by_message[message.name] = self.counts.by_message.get(message.name, 0) + len(starts)
            accepted += int(lengths.sum())
        self.counts.bad += len(bad)
        self.counts.skipped_bytes += consumed - accepted
        bad = bad + self._position
        self._tail = stream[consumed:]
        self._position += consumed
        return FrameBatch(messages, bad, self._position)


def _leading(good: NDArray[np.bool_]) -> int:
    """Return number of True before the first False."""
    first = int(good.argmin()) if len(good) else 0
    return len(good) if not len(good) or good[first] else first


def _starts(found: list[Run | Found], index: int, length: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Starts and lengths of the accepted frames of one message, in stream order."""
    starts: list[NDArray[np.int64]] = []
    lengths: list[NDArray[np.int64]] = []
    for part in found:
        if isinstance(part, Found):
            mine = part.message == index
            starts.append(part.start[mine])
            lengths.append(part.length[mine])
        else:
            first, rows = part
            starts.append(np.arange(first, first + rows * length, length, dtype=np.int64))
            lengths.append(np.full(rows, length, np.int64))
    if len(starts) == 1:
        return starts[0], lengths[0]
    return np.concatenate([_NONE, *starts]), np.concatenate([_NONE, *lengths])


def _rows(buffer: NDArray[np.uint8], starts: NDArray[np.int64], message: Message) -> NDArray[np.uint8]:
    """Return frame bytes (n, body): a view of the stream where it is one unbroken lattice, else gathered."""
    if not len(starts):
        return np.empty((0, message.body), np.uint8)
    first, last = int(starts[0]), int(starts[-1])
    if message.length and last - first == (len(starts) - 1) * message.length:
        return np.lib.stride_tricks.as_strided(
            buffer[first:], (len(starts), message.body), (message.length, 1), writeable=False
        )
    return sliding_window_view(buffer, message.body)[starts]
