"""Frame counters without wrap, and what they say about lost and repeated frames."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS

_START = np.zeros(1, np.int64)
REPEAT_REACH = 64  # frames; a serial line repeats at most the tail of a buffer


class Unwrapped(NamedTuple):
    """Counters (n,) int64 without wrap, suspect marks (n,) bool, numbers of lost, repeated and suspect frames."""

    counter: NDArray[np.int64]
    suspect: NDArray[np.bool_]
    lost: int
    duplicate: int
    doubtful: int = 0


class CounterUnwrapper:
    """Follows one counter of ``wrap`` values through a stream.

    A step is the one, modulo the wrap, that is nearest to what the receive times and the rate predict; so gaps longer
    than a wrap are resolved. A step back by at most 64 is a repeated frame. A step that is a quarter of a wrap away
    from the prediction, or further back, is implausible: that frame is suspect and carries the last counter. If the
    next frame goes on from it, the unit has restarted its counter: counting goes on as the time predicts.
    """

    def __init__(self, wrap: int, rate_Hz: float | None) -> None:
        self._wrap = wrap
        self._rate_Hz = rate_Hz
        self._reach = min(REPEAT_REACH, wrap // 4)
        self._started = False
        self._raw = 0  # counter as sent of the last trusted frame
        self._last = 0  # its unwrapped counter
        self._highest = 0
        self._t_ns = 0
        self._rejected: int | None = None  # counter as sent of a suspect frame, if that was the last one
        self._missed = 0.0  # frames that time has predicted since the last trusted one

    def feed(self, raw: NDArray[np.int64], t_ns: NDArray[np.int64] | None) -> Unwrapped:
        """Unwrap the counters of the next frames.

        Args: raw: (n,) counters as sent; t_ns: (n,) receive stamps of their chunks, or None without times.
        """
        if not len(raw):
            return Unwrapped(np.empty(0, np.int64), np.empty(0, np.bool_), 0, 0)
        if not self._started:
            self._started = True
            self._raw = self._last = self._highest = int(raw[0]) - 1
            self._t_ns = int(t_ns[0]) if t_ns is not None else 0
        expected = self._expected(len(raw), t_ns)
        if t_ns is not None:
            self._t_ns = int(t_ns[-1])
        step = np.empty(len(raw), np.int64)
        step[0] = raw[0] - self._raw
        np.subtract(raw[1:], raw[:-1], out=step[1:])
        step &= self._wrap - 1
        if isinstance(expected, float) and self._steady and (step == 1).all():
            return self._advance(len(raw), int(raw[-1]))
        step = self._resolve(step, expected)
        if self._rejected is None and not self._implausible(step, expected).any():
            counter = self._last + np.cumsum(step)
            suspect = np.zeros(len(raw), np.bool_)
            self._raw, self._last = int(raw[-1]), int(counter[-1])
        else:
            counter, suspect = self._one_by_one(raw, expected)
        return self._account(counter, suspect)

    @property
    def _steady(self) -> bool:
        return self._rejected is None and self._last == self._highest

    def _advance(self, count: int, raw: int) -> Unwrapped:
        """Return nothing lost, nothing repeated."""
        counter = np.arange(self._last + 1, self._last + 1 + count, dtype=np.int64)
        self._raw, self._last = raw, self._last + count
        self._highest = self._last
        return Unwrapped(counter, np.zeros(count, np.bool_), 0, 0)

    def _expected(self, count: int, t_ns: NDArray[np.int64] | None) -> NDArray[np.float64] | float:
        """Predicted step of each frame: 1 inside a chunk; at its start the time since the last one, less its frames.

        A plain 1.0 means 1 for all.
        """
        if t_ns is None or self._rate_Hz is None:
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

    def _resolve(self, step: NDArray[np.int64], expected: NDArray[np.float64] | float) -> NDArray[np.int64]:
        turns = np.rint((expected - step) / self._wrap)
        return step + self._wrap * turns.astype(np.int64)

    def _implausible(self, step: NDArray[np.int64], expected: NDArray[np.float64] | float) -> NDArray[np.bool_]:
        return np.asarray((step < -self._reach) | (step - expected > self._wrap / 4))

    def _one_by_one(
        self, raw: NDArray[np.int64], expected: NDArray[np.float64] | float
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        counter = np.empty(len(raw), np.int64)
        suspect = np.zeros(len(raw), np.bool_)
        highest = self._highest
        due_each = np.broadcast_to(expected, len(raw)).tolist()
        for index, (value, due) in enumerate(zip(raw.tolist(), due_each, strict=True)):
            due += self._missed
            forward = (value - self._raw) % self._wrap
            step = forward + self._wrap * round((due - forward) / self._wrap)
            if -self._reach <= step <= due + self._wrap / 4:
                self._last += step
            elif self._rejected is not None and 0 < (value - self._rejected) % self._wrap <= self._reach:
                self._last = highest + max(1, round(due))
            else:
                suspect[index], counter[index] = True, self._last
                self._rejected, self._missed = value, due
                continue
            self._raw, self._rejected, self._missed = value, None, 0.0
            counter[index] = self._last
            highest = max(highest, self._last)
        return counter, suspect

    def _account(self, counter: NDArray[np.int64], suspect: NDArray[np.bool_]) -> Unwrapped:
        trusted = counter if not suspect.any() else counter[~suspect]
        highest = np.maximum.accumulate(np.concatenate(([self._highest], trusted)))
        steps = highest[1:] - highest[:-1]
        new = steps > 0
        self._highest = int(highest[-1])
        return Unwrapped(counter, suspect, int(steps.sum() - new.sum()), int(len(trusted) - new.sum()),
                         len(counter) - len(trusted))  # fmt: skip
