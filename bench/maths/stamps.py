"""Time stamps of samples, before anybody fits them: of a record, even, forward, at the nominal rate, in step with the
bench clock; of a log, evenly, with gaps, or in bursts; the noise of stamps, a clock that was set, the least delays.

Source: median of the increments per counted sample as the rate (robust against stamps that are off); the smallest delay
at both ends of a record bounds the ratio of two clocks, because a delay is never negative; rectangular bounds, JCGM
100:2008 section 4.3.7. A crystal keeps its rate within 1e-4, so increments of a log far from the usual one are the
recorder's, not the sensor's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Flags, Floats, Integers
from bench.maths.samples import Finding, finding_at, scatter
from bench.model.errors import FitError

JITTER = 0.1  # of the interval between samples: a stamp further from its place is irregular
RATE_OFF = 0.01  # rate beside the nominal one, relative: a crystal is off by 1e-4 at most
CLOCKS_APART = 1e-3  # ratio of both clocks, relative
_WRAP_us = 1 << 32
_LEAST_s = 10.0  # a record shorter than this says nothing about a clock against the bench clock
IRREGULAR, BACKWARDS, BURST, RATE, CLOCK = "irregular", "backwards", "burst", "rate", "clock"
_CROWDED = 0.5  # of the mean interval around: stamped closer than this, samples come in a burst
_BURSTY = 0.01  # share of crowded samples from which the stamps are no times of samples
_AROUND = 64  # rows that tell the mean interval around them: one pause of an hour is in one such part only
_RUN, _EVEN = 16, 0.1  # steps on end from which even ones are the sensor's; scatter of even ones, of a step
_FEW_STEPS, _MOSTLY, _NEARLY = 10.0, 0.6, 0.95  # intervals; shares of the steps
_ALIKE = 0.5  # quartiles of the long steps apart, of their median: bursts come regularly, pauses do not
_GAP = 1.5  # of the usual interval
_STEP = 0.02  # of the interval: a clock that jumps by more was set, or started again
_SCATTERS = 10.0


@dataclass(frozen=True)
class TickFindings:
    """Result for the stamps of one record.

    Attributes:
        interval_s: median time per counted sample, by the stamps.   worst_jitter_s: largest distance of an
            increment from its due.
        clock_error: device clock against bench clock, relative, positive = device runs fast; NaN where the record
            is too short or has no receive times.   clock_bound: largest error of it that delays can explain.
        faults: what is wrong with them.
    """

    interval_s: float
    worst_jitter_s: float
    clock_error: float
    clock_bound: float
    faults: tuple[Finding, ...]


def unwrapped_ticks_s(tick_us: Integers) -> Floats:
    """Return seconds since the first sample from a 32-bit microsecond counter that starts again at 0.

    Args:    tick_us: (n,), as transmitted, in order of the samples, less than 35 minutes from one to the next.
    Returns: (n,) s; a step backwards of less than that stays one.
    """
    steps = np.mod(np.diff(tick_us) + _WRAP_us // 2, _WRAP_us) - _WRAP_us // 2
    return np.concatenate(([0.0], np.cumsum(steps) * 1e-6))


def check_ticks(tick_s: Floats, counter: Integers, interval_s: float, received_s: Floats | None = None) -> TickFindings:
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
        *_flagged(increments, off_s, median_s, counted),
        *_of_all(RATE, tick_s.size, abs(rate_error) > RATE_OFF, every=median_s * 1e3, nominal=interval_s * 1e3),
        *_of_all(CLOCK, tick_s.size, abs(clock_error) > max(CLOCKS_APART, 3.0 * clock_bound), error=clock_error,
                 limit=CLOCKS_APART),
    ]  # fmt: skip
    worst_s = float(np.abs(off_s).max()) if off_s.size else 0.0
    return TickFindings(median_s, worst_s, clock_error, clock_bound, tuple(faults))


def _flagged(increments: Floats, off_s: Floats, median_s: float, counted: Flags) -> Iterator[Finding]:
    """Stamps that go backwards, and increments beside their due; those of less than half of it come in bursts."""
    limit_s = JITTER * abs(median_s)
    irregular = counted & (increments > 0.0) & (np.abs(off_s) > limit_s)
    worst_s = float(np.abs(off_s[irregular]).max(initial=0.0))
    for kind, bad, figures in (
        (BACKWARDS, counted & (increments <= 0.0), {}),
        (IRREGULAR, irregular, {"limit": limit_s * 1e3, "worst": worst_s * 1e3}),
        (BURST, irregular & (increments < 0.5 * median_s), {}),
    ):
        if bad.any():
            yield finding_at(kind, "", np.concatenate(([False], bad)), **figures)


def _of_all(kind: str, samples: int, wrong: bool, **figures: float) -> list[Finding]:
    return [Finding(kind, "", 1, samples, 0, figures)] if wrong else []


def _clock(tick_s: Floats, received_s: Floats | None) -> tuple[float, float]:
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


@dataclass(frozen=True)
class SampleStamps:
    """``rate_Hz`` of the samples.   ``breaks`` (k,): samples in front of which others are missing.   ``missing``: how
    many, by the stamps.   ``crowded``: share of samples stamped less than half an interval behind the one before.
    ``sure``: whether the stamps tell the rate at all.
    """

    rate_Hz: float
    breaks: Integers
    missing: int
    crowded: float
    worst_s: float
    sure: bool

    @property
    def bursty(self) -> bool:
        """Whether the samples have to be counted, because the stamps are not their times."""
        return self.crowded > _BURSTY

    def counter(self, t_s: Floats) -> Integers:
        """Return the places of samples in time, (n,), from 0, by their stamps (n,)."""
        steps = np.ones(len(t_s), np.int64)
        steps[0] = 0
        steps[self.breaks] = np.rint(np.diff(t_s)[self.breaks - 1] * self.rate_Hz).astype(np.int64)
        return np.cumsum(steps)


def sample_stamps(t_s: Floats) -> SampleStamps:
    """Return rate and gaps from the stamps of a log.

    Where the usual step is much shorter than the mean one around it, samples are stamped when they arrive, in bursts;
    or there are many pauses, between which the steps are even. Bursts have steps that scatter or few samples, and come
    regularly: the samples are counted then, at the mean rate around the middle of the log, and one more or less cannot
    be told. Neither is told as a rate that is not sure.

    Args:    t_s: (n,) stamps in order, n >= 3.
    Returns: SampleStamps.
    Raises:  FitError B-FIT-141 if all stamps are the same or there are fewer than three.
    Source:  see the head of this file.
    """
    if len(t_s) < 3 or not t_s[-1] > t_s[0]:
        raise FitError(
            "B-FIT-141",
            f"{len(t_s)} time stamps over {float(t_s[-1] - t_s[0]) if len(t_s) else 0.0:g} s tell no rate",
            next_step="map the column that says when a row was taken, or 'format: rows' with the rate of the recorder",
        )
    increments = np.diff(t_s)
    usual, around = _usual(increments), _usual_around(increments)
    crowded = float(np.mean(increments < _CROWDED * around))
    if crowded > _BURSTY and not (_whole_steps(increments, usual) or _even_between_pauses(increments, usual)):
        return _in_bursts(t_s, increments, around, crowded)
    gap = increments > _GAP * usual
    usual = float(np.mean(increments[~gap]))
    missing = int(np.rint(increments[gap] / usual - 1.0).sum())
    worst = float(np.abs(np.cumsum(np.where(gap, 0.0, increments - usual))).max())
    breaks = np.flatnonzero(gap).astype(np.int64) + 1
    return SampleStamps(1.0 / usual, breaks, missing, 0.0, worst, True)


def _usual(increments: Floats) -> float:
    """Return the interval of the sensor: the median step, or the least one of which all are multiples."""
    usual, least = float(np.median(increments)), float(np.percentile(increments, 1.0))
    if float(np.mean(np.abs(increments - usual) < _EVEN * usual)) < _MOSTLY and _whole_steps(increments, least):
        return float(np.median(increments[increments < _GAP * least]))
    return usual


def _whole_steps(increments: Floats, interval_s: float) -> bool:
    """Return whether nearly all steps are few whole intervals, as where rows are missing here and there."""
    if not interval_s > 0.0:
        return False
    steps = increments / interval_s
    few_steps = steps < _FEW_STEPS
    off = np.abs(steps - np.rint(steps))[few_steps]
    return float(few_steps.mean()) > _NEARLY and float(np.mean(off < _EVEN)) > _NEARLY


def _usual_around(increments: Floats) -> float:
    """Return the median of the mean steps of successive parts of a log."""
    parts = max(1, increments.size // _AROUND)
    ends = np.linspace(0, increments.size, parts + 1).astype(np.int64)
    return float(np.median(np.add.reduceat(increments, ends[:-1]) / np.diff(ends)))


def _even_between_pauses(increments: Floats, usual: float) -> bool:
    """Return whether the short steps are those of the sensor: even ones, many on end."""
    long = increments > _GAP * usual
    if not usual > 0.0 or (~long).sum() < _RUN * (long.sum() + 1):
        return False
    return float(scatter(increments[~long] - usual)) < _EVEN * usual


def _in_bursts(t_s: Floats, increments: Floats, around_s: float, crowded: float) -> SampleStamps:
    """Return the samples counted; a pause is what is far longer than the time between bursts."""
    long = increments[increments > _GAP * around_s]
    low, usual, high = np.percentile(long, (25, 50, 75)) if long.size else (0.0, around_s, 0.0)
    pause = increments > 4.0 * usual
    interval_s = float(increments[~pause].mean())
    even = t_s[0] + interval_s * np.arange(len(t_s)) + np.concatenate(([0.0], np.cumsum(increments * pause)))
    worst = float(np.abs(t_s - even).max())
    breaks = np.flatnonzero(pause).astype(np.int64) + 1
    missing = int(np.rint(increments[pause] / interval_s - 1.0).sum())
    sure = bool(high - low <= _ALIKE * usual)
    return SampleStamps(1.0 / interval_s, breaks, missing, crowded, worst, sure)


def tag_noise_s(device_s: Floats, counter: Integers) -> float:
    """White noise of time tags, standard deviation, second.

    Args:    device_s: (n,).   counter: (n,); only frames right behind one another count.
    Returns: 0 for fewer than three of them in a row.
    Source:  second differences of white noise have six times its variance; median absolute deviation.
    """
    in_row = (np.diff(counter)[1:] == 1) & (np.diff(counter)[:-1] == 1)
    second_s = np.diff(device_s, 2)[in_row]
    if not second_s.size:
        return 0.0
    return float(scatter(second_s)) / math.sqrt(6.0)


def first_step(device_s: Floats, counter: Integers) -> int | None:
    """Place of the first frame whose time tag does not follow from the one before: a clock set or started again.

    Args:    device_s: (n,).   counter: (n,), rising.
    Returns: its index, None if the clock runs on.
    Source:  median interval per counted frame; ten times the scatter, at least 2 % of the interval.
    """
    if device_s.size < 3:
        return None
    increments, steps = np.diff(device_s), np.diff(counter).astype(np.float64)
    interval_s = float(np.median(increments / steps))
    off_s = np.abs(increments - steps * interval_s)
    drifted_s = 1e-3 * interval_s * (steps - 1.0)  # clocks may differ by as much over a gap
    wrong = off_s > max(_SCATTERS * float(scatter(off_s)), _STEP * abs(interval_s)) + drifted_s
    return int(np.argmax(wrong)) + 1 if wrong.any() else None


def lower_hull(at_s: Floats, delay_s: Floats, parts: int) -> list[int]:
    """Return the places on the lower convex hull of delays, in order of time.

    Args:    at_s, delay_s: (n,).   parts: of the time, of each of which the least delay is taken, so that hours of
             frames cost nothing.
    Source:  Moon, Skelly, Towsley, Estimation and Removal of Clock Skew from Network Delay Measurements, INFOCOM 1999.
    """
    part = np.minimum(((at_s - at_s[0]) / (at_s[-1] - at_s[0]) * parts).astype(np.int64), parts - 1)
    order = np.lexsort((delay_s, part))
    hull: list[int] = []
    for new in order[np.unique(part[order], return_index=True)[1]].tolist():
        while len(hull) > 1 and _turns_up(*((float(at_s[k]), float(delay_s[k])) for k in (*hull[-2:], new))):
            hull.pop()
        hull.append(new)
    return hull


def _turns_up(first: tuple[float, float], second: tuple[float, float], new: tuple[float, float]) -> bool:
    return (second[1] - first[1]) * (new[0] - first[0]) >= (new[1] - first[1]) * (second[0] - first[0])
