"""Points of 0.1 s on their way to a browser: the last minute of them, and the binary batch they travel in.

Layout: docs/live-protocol.md.
"""

from __future__ import annotations

import struct
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

KEPT = 600  # points: one minute
MISSING_BEFORE = 1  # flag of a batch: points before it are gone
_ROUNDING = 1e-6  # of a step: times like 0.3 s are not quite a multiple of 0.1 s
_HEAD = struct.Struct("<IHH")


@dataclass(frozen=True)
class Points:
    """Points in a row. ``first``: number of the first one; ``t_utc_s`` (n,), ``pairs`` (n, signals, 2): min and max."""

    first: int
    t_utc_s: NDArray[np.float64]
    pairs: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.t_utc_s)

    @property
    def stop(self) -> int:
        """Number of the point that follows."""
        return self.first + len(self)

    def batch(self, flags: int = 0) -> bytes:
        """Return the binary message of these points."""
        head = _HEAD.pack(self.first & 0xFFFFFFFF, len(self), flags)
        return head + self.t_utc_s.astype("<f8").tobytes() + self.pairs.astype("<f4").tobytes()

    def between(self, after_utc_s: float, until_utc_s: float) -> Points:
        """Return those after one time and not after another, which may be none."""
        start, stop = np.searchsorted(self.t_utc_s, (after_utc_s, until_utc_s), side="right")
        return Points(self.first + int(start), self.t_utc_s[start:stop], self.pairs[start:stop])

    def last(self, count: int) -> Points:
        """Return at most ``count`` of them, the newest."""
        skipped = max(0, len(self) - count)
        return Points(self.first + skipped, self.t_utc_s[skipped:], self.pairs[skipped:])


def no_points(signals: int) -> Points:
    """None, of so many signals."""
    return Points(0, np.zeros(0), np.zeros((0, signals, 2), dtype=np.float32))


def binned(t_utc_s: NDArray[np.float64], low: NDArray[np.float32], high: NDArray[np.float32], width_s: float) -> Points:
    """Return least and greatest value of each signal in steps of ``width_s``, numbered from 0; NaN where nothing came.

    Args: t_utc_s: (n,), ascending. low, high: (n, signals); rows of NaN are gaps. A point's time: the end of its step.
    """
    if not len(t_utc_s):
        return no_points(low.shape[1])
    steps = np.floor(t_utc_s / width_s + _ROUNDING).astype(np.int64)
    first = np.flatnonzero(np.concatenate(([True], steps[1:] != steps[:-1])))
    pairs = np.stack([np.fmin.reduceat(low, first, axis=0), np.fmax.reduceat(high, first, axis=0)], axis=-1)
    return Points(0, (steps[first] + 1).astype(np.float64) * width_s, pairs.astype(np.float32))


class LastPoints:
    """The newest points of a run, as many as a page shows when it opens; of constant size."""

    def __init__(self, signals: int) -> None:
        self.signals = signals
        self._blocks: deque[Points] = deque()
        self._count = 0

    def add(self, points: Points) -> None:
        """Put newer points behind; points that do not follow the last one start anew."""
        if self._blocks and points.first != self._blocks[-1].stop:
            self._blocks.clear()
            self._count = 0
        self._blocks.append(points)
        self._count += len(points)
        while self._count - len(self._blocks[0]) >= KEPT:
            self._count -= len(self._blocks.popleft())

    def all(self) -> Points:
        """Return at most ``KEPT`` points in a row."""
        if not self._blocks:
            return no_points(self.signals)
        times = np.concatenate([block.t_utc_s for block in self._blocks])
        pairs = np.concatenate([block.pairs for block in self._blocks])
        return Points(self._blocks[0].first, times, pairs).last(KEPT)
