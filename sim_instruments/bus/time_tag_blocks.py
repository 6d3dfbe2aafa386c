"""Blocks of time stamps as a tagger keeps them: cut from a stream of events by its own clock, in a memory that ends.

The layout is that of frames/time_tags.yaml, written out here a second time, so that a mistake in either shows.
"""

from __future__ import annotations

import struct
import zlib
from collections import deque

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Integers

SYNC = b"\xa5\x5a\xc3\x3c"
MOST_EVENTS = 6000  # of a block
BLOCKS_PER_S = 100
MEMORY_BLOCKS = 300  # 3 s
_HEAD = struct.Struct("<HIQIIH")  # length, counter, tick, clock, dropped, edges
_TRAILER = 4  # crc-32 over everything behind the sync word
_WORD = 4
_WRAP = 1 << 32

Words = NDArray[np.uint32]


class TagBlocks:
    """The stream from one start to its stop, and the memory, which outlives both.

    ``dropped``: events lost since the start, because there were too many for a block or no room for one.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._counter = 0
        self._memory: deque[bytes] = deque()
        self._clock_Hz = self._tick = self._length = 0
        self._ticks: Integers = np.empty(0, np.int64)  # of events in the block that is not complete
        self._words: Words = np.empty(0, np.uint32)

    def clear(self) -> None:
        """Forget what is in the memory; blocks are counted on."""
        self._memory.clear()

    def start(self, clock_Hz: int, tick: int) -> None:
        """Begin a block at this tick of the clock; nothing is lost so far."""
        self._clock_Hz, self._tick, self._length = clock_Hz, tick, clock_Hz // BLOCKS_PER_S
        self._ticks, self._words = self._ticks[:0], self._words[:0]
        self.dropped = 0

    def add(self, ticks: Integers, flags: Words) -> None:
        """Events in order of time, not before those added already: ticks of the clock, bits 0 to 2 of the event."""
        self._ticks = np.concatenate([self._ticks, ticks])
        self._words = np.concatenate([self._words, flags])

    def close_until(self, tick: int) -> None:
        """Close every block that ends at this tick or before."""
        blocks = (tick - self._tick) // self._length
        if blocks <= 0:
            return
        index = (self._ticks - self._tick) // self._length
        words = ((self._ticks - self._tick - index * self._length) << 3).astype(np.uint32) | self._words
        ends = np.searchsorted(index, np.arange(blocks + 1))
        for number in range(blocks):
            self._close(words[ends[number] : ends[number + 1]])
        self._ticks, self._words = self._ticks[ends[-1] :], self._words[ends[-1] :]

    def take(self, most_bytes: int) -> bytes:
        """Return the oldest whole blocks, at most so many bytes; they leave the memory."""
        blocks: list[bytes] = []
        while self._memory and len(self._memory[0]) <= most_bytes:
            blocks.append(self._memory.popleft())
            most_bytes -= len(blocks[-1])
        return b"".join(blocks)

    def _close(self, words: Words) -> None:
        full = len(self._memory) >= MEMORY_BLOCKS
        kept = words[: 0 if full else MOST_EVENTS]
        self.dropped += len(words) - len(kept)
        if not full:
            self._memory.append(self._block(kept))
        self._counter = (self._counter + 1) % _WRAP
        self._tick += self._length

    def _block(self, words: Words) -> bytes:
        length = len(SYNC) + _HEAD.size + _WORD * len(words) + _TRAILER
        dropped = self.dropped % _WRAP
        head = _HEAD.pack(length, self._counter, self._tick, self._clock_Hz, dropped, len(words))
        body = head + words.astype("<u4").tobytes()
        return SYNC + body + struct.pack("<I", zlib.crc32(body))
