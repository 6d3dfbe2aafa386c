"""Counts that a unit only ever adds up: increments from frame to frame, modulo the width, never across a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.frame.batch import MessageBatch


@dataclass(frozen=True)
class Increments:
    """Increment of each frame over the one before it: (n,) or (n, count) int64, and (n,) bool where it is valid."""

    value: NDArray[np.int64]
    valid: NDArray[np.bool_]


class CumulativeCount:
    """Follows one ``per: cumulative`` field of up to 48 bits through the batches of a link.

    The first frame of all, a frame behind a gap, a repeated and a suspect frame have no valid increment (value 0).
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._count: NDArray[np.int64] | None = None
        self._counter = 0

    def feed(self, batch: MessageBatch) -> Increments:
        """Increments of the next frames; the batch must carry unwrapped counters.

        Raises: ValueError if the message has no counter or the field is wider than 48 bits.
        """
        item = batch.message.by_name[self._name]
        if batch.counter is None or item.size > 6:
            raise ValueError(f"{self._name!r} needs a counter in its message and at most 48 bits")
        counts = batch.raw(self._name).astype(np.int64)
        value, valid = np.zeros_like(counts), np.zeros(len(batch), np.bool_)
        kept = np.flatnonzero(~batch.suspect)
        if not len(kept):
            return Increments(value, valid)
        before, counter_before = counts[kept][:-1], batch.counter[kept][:-1]
        if self._count is not None:
            before = np.concatenate((self._count[np.newaxis], before))
            counter_before = np.concatenate(([self._counter], counter_before))
        now = kept[len(kept) - len(before) :]
        follows = batch.counter[now] - counter_before == 1
        value[now[follows]] = (counts[now] - before)[follows] % (1 << (8 * item.size))
        valid[now] = follows
        self._count, self._counter = counts[kept[-1]], int(batch.counter[kept[-1]])
        return Increments(value, valid)
