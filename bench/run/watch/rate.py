"""Whether the pulse rate jumped inside a record: the difference of its two halves, in hertz."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from bench.frame import LinkBatch
from bench.record import RecordRow

KEPT_FRAMES = 200_000  # of the newest frames: more than any record that pulses are timed in has
COUNTS = ("npp", "ppp")


class RateStep:
    """Feed it with every batch of the measurement link, then ask for a record that has just ended.

    Args: rate_Hz: frames per second of the link.
    """

    def __init__(self, rate_Hz: float) -> None:
        self._rate_Hz = rate_Hz
        self._kept: deque[tuple[NDArray[np.int64], NDArray[np.int64]]] = deque()
        self._frames = 0

    def feed(self, batch: LinkBatch) -> None:
        """Keep the net counts of frames with a counter and counts of both polarities."""
        for frames in batch.messages.values():
            if not len(frames) or frames.counter is None or not set(COUNTS) <= set(frames.message.by_name):
                continue
            net = frames.raw("npp").astype(np.int64) - frames.raw("ppp")
            self._kept.append((frames.counter, net))
            self._frames += len(frames)
        while self._frames > KEPT_FRAMES and len(self._kept) > 1:
            self._frames -= len(self._kept.popleft()[0])

    def of(self, row: RecordRow) -> float:
        """Return mean net rate of the record's channel in its second half minus that in its first, absolute, hertz.

        NaN if the record names no channel or a half of it has no frames.
        """
        channel, first = row.window.conditions.get("channel"), row.window.first_counter
        middle, stop = first + row.window.frames // 2, first + row.window.frames
        if not isinstance(channel, int) or not self._kept:
            return math.nan
        counters = np.concatenate([one for one, _ in self._kept])
        counts = np.concatenate([net for _, net in self._kept])[:, channel - 1]
        halves = [counts[(counters >= a) & (counters < b)] for a, b in ((first, middle), (middle, stop))]
        if not all(len(half) for half in halves):
            return math.nan
        return abs(float(halves[1].mean() - halves[0].mean())) * self._rate_Hz
