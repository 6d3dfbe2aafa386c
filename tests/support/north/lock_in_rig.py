"""A lock-in amplifier on a world of its own: a table with exact index pulses and a signal written down as a formula."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_instruments.synchronous_detection import SAMPLE_NS, LockIn

MS = SAMPLE_NS
Signal = Callable[[NDArray[np.float64]], NDArray[np.float64]]


class Turning:
    """A table at ``rate_Hz`` from 0 s on; pulse "a" where its angle is 0, "b" a quarter of a turn earlier.

    ``stops_s``: no pulses from then on.   ``signal``: volt of the angle in turns.   ``noise_V``: white, per sample.
    """

    def __init__(self, signal: Signal, rate_Hz: float = 1.0, noise_V: float = 0.0, stops_s: float = 1e9) -> None:
        self.signal, self.rate_Hz, self.noise_V, self.stops_s = signal, rate_Hz, noise_V, stops_s
        self.asked: list[tuple[int, int]] = []

    def waveform(self, first: int, last: int) -> NDArray[np.float64]:
        """Volt of samples [first, last)."""
        self.asked.append((first, last))
        found = self.signal((np.arange(first, last) + 0.5) * 1e-3 * self.rate_Hz)
        if not self.noise_V:
            return found
        noise = [np.random.default_rng([7, second]).normal(0.0, 1.0, 1000) for second in self._seconds(first, last)]
        start = first - first // 1000 * 1000
        return found + self.noise_V * np.concatenate(noise)[start : start + last - first]

    @staticmethod
    def _seconds(first: int, last: int) -> range:
        return range(first // 1000, (last - 1) // 1000 + 1)

    def pulses(self, index: str, t0_ns: int, t1_ns: int) -> NDArray[np.int64]:
        """Nanoseconds of the pulses in [t0, t1)."""
        period_ns = 1e9 / self.rate_Hz
        shift = 0.0 if index == "a" else 0.75
        turns = np.arange(max(0, int(t0_ns / period_ns - 2)), int(t1_ns / period_ns + 2))
        times_ns = np.round((turns + shift) * period_ns).astype(np.int64)
        inside = (times_ns >= t0_ns) & (times_ns < t1_ns) & (times_ns < self.stops_s * 1e9)
        return times_ns[inside]


def amplifier(world: Turning, index: str = "a", **settings: Any) -> LockIn:
    """A lock-in amplifier on that world, its reference one of the pulses."""
    made = LockIn(world.waveform, lambda t0_ns, t1_ns: world.pulses(index, t0_ns, t1_ns))
    made.change(**settings)
    return made


def trace(made: LockIn, last: int) -> NDArray[np.float64]:
    """X and Y behind the filters, (2, n), of each sample from the first one not yet processed to ``last``."""
    found = made._process(made._done, last)
    made._done = last
    return found
