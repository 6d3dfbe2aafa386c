"""Time stamps of samples: even, forward, at the nominal rate, and in step with the bench clock.

Source: median of the increments per counted sample as the rate (robust against stamps that are off); the smallest delay
at both ends of a record bounds the ratio of two clocks, because a delay is never negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]
JITTER = 0.1  # of the interval between samples: a stamp further from its place is irregular
RATE_OFF = 0.01  # rate beside the nominal one, relative: a crystal is off by 1e-4 at most
CLOCKS_APART = 1e-3  # ratio of both clocks, relative
_LEAST_s = 10.0  # a record shorter than this says nothing about a clock against the bench clock
IRREGULAR, BACKWARDS, BURST, RATE, CLOCK = "irregular", "backwards", "burst", "rate", "clock"


@dataclass(frozen=True)
class TickFindings:
    """Result for the stamps of one record.

    Attributes:
        interval_s: median time per counted sample, by the stamps.   rate_error: of the stamps' rate against the
            nominal one, relative, positive = faster.   worst_jitter_s: largest distance of an increment from its due.
        clock_error: device clock against bench clock, relative, positive = device runs fast; NaN where the record
            is too short or has no receive times.   clock_bound: largest error of it that delays can explain.
        faults: (kind, count, first, sentence) of what is wrong.
    """

    interval_s: float
    rate_error: float
    worst_jitter_s: float
    clock_error: float
    clock_bound: float
    faults: tuple[tuple[str, int, int, str], ...]


def unwrapped_ticks_s(tick: Int64, bits: int = 32, tick_s: float = 1e-6) -> Array:
    """Seconds from a counter of fixed width that starts again at 0.

    Args:    tick: (n,), as transmitted.   bits: width.   tick_s: of one step.
    Returns: (n,), seconds from the first; a step backwards of less than half the width stays one.
    """
    span = 1 << bits
    steps = np.mod(np.diff(np.asarray(tick, np.int64)) + span // 2, span) - span // 2
    return np.concatenate(([0.0], np.cumsum(steps) * tick_s))


def check_ticks(tick_s: Array, counter: Int64, interval_s: float, received_s: Array | None = None) -> TickFindings:
    """Look at every increment of the time stamps.

    Args:    tick_s: (n,), n >= 2, unwrapped.   counter: (n,).   interval_s: nominal.   received_s: (n,), bench clock.
    Returns: TickFindings.
    Source:  see the head of this file.
    """
    steps = np.diff(counter)
    increments = np.diff(np.asarray(tick_s, np.float64))
    counted = steps > 0
    per_sample = increments[counted] / steps[counted]
    median_s = float(np.median(per_sample)) if per_sample.size else float("nan")
    off_s = increments - steps * median_s
    rate_error = interval_s / median_s - 1.0 if median_s > 0.0 else float("inf")
    clock_error, clock_bound = _clock(tick_s, received_s)
    faults = [
        *_backwards(increments, counted),
        *_uneven(increments, off_s, median_s, counted),
        *_rate(rate_error, interval_s, median_s),
        *_against_the_bench(clock_error, clock_bound),
    ]
    worst_s = float(np.abs(off_s).max()) if off_s.size else 0.0
    return TickFindings(median_s, rate_error, worst_s, clock_error, clock_bound, tuple(faults))


def _backwards(increments: Array, counted: NDArray[np.bool_]) -> list[tuple[str, int, int, str]]:
    bad = counted & (increments <= 0.0)
    if not bad.any():
        return []
    count, first = int(bad.sum()), int(np.argmax(bad)) + 1
    return [(BACKWARDS, count, first, f"{count} time stamps do not go forward, first at sample {first}")]


def _uneven(
    increments: Array, off_s: Array, median_s: float, counted: NDArray[np.bool_]
) -> list[tuple[str, int, int, str]]:
    """Increments beside their due; those of less than half of it come in bursts."""
    limit_s = JITTER * abs(median_s)
    bad = counted & (increments > 0.0) & (np.abs(off_s) > limit_s)
    if not bad.any():
        return []
    count, first = int(bad.sum()), int(np.argmax(bad)) + 1
    text = (
        f"{count} time stamps are more than {limit_s * 1e3:.3g} ms beside their place, first at sample {first}, "
        f"the worst by {float(np.abs(off_s[bad]).max()) * 1e3:.3g} ms"
    )
    faults = [(IRREGULAR, count, first, text)]
    crowded = bad & (increments < 0.5 * median_s)
    if crowded.any():
        count, first = int(crowded.sum()), int(np.argmax(crowded)) + 1
        text = f"{count} samples come in bursts, stamped less than half an interval apart, first at {first}"
        faults.append((BURST, count, first, text))
    return faults


def _rate(rate_error: float, interval_s: float, median_s: float) -> list[tuple[str, int, int, str]]:
    if abs(rate_error) <= RATE_OFF:
        return []
    text = f"samples come every {median_s * 1e3:.4g} ms by their time stamps, {interval_s * 1e3:.4g} ms are nominal"
    return [(RATE, 1, 0, text)]


def _clock(tick_s: Array, received_s: Array | None) -> tuple[float, float]:
    """Relative error of the device clock and what delays can make of it, from the smallest delays of both halves."""
    if received_s is None or tick_s.size < 4 or received_s[-1] - received_s[0] < _LEAST_s:
        return float("nan"), float("nan")
    delay = np.asarray(received_s, np.float64) - tick_s
    half = tick_s.size // 2
    ends = [int(np.argmin(delay[:half])), half + int(np.argmin(delay[half:]))]
    device = float(tick_s[ends[1]] - tick_s[ends[0]])
    bench = float(received_s[ends[1]] - received_s[ends[0]])
    if device <= 0.0 or bench <= 0.0:
        return float("nan"), float("nan")
    line = np.interp(tick_s, tick_s[ends], delay[ends])
    return device / bench - 1.0, float(np.median(np.abs(delay - line))) / bench


def _against_the_bench(clock_error: float, clock_bound: float) -> list[tuple[str, int, int, str]]:
    if not abs(clock_error) > max(CLOCKS_APART, 3.0 * clock_bound):
        return []
    text = f"the unit's clock is off by {clock_error:.2e} against the bench clock (limit {CLOCKS_APART:g})"
    return [(CLOCK, 1, 0, text)]
