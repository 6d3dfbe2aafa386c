"""Time stamps of samples: of a record, even, forward, at the nominal rate and in step with the bench clock; of a
session, the unit's own clock against the bench clock; of a log, evenly, with gaps, or in bursts.

An integral of rate is taken with the unit's time stamps, and a turn by the bench's: a crystal that is 20 ppm fast makes
every scale factor 20 ppm too large. A frame is received behind its sample, never before it, so a line below all delays
that rests on two of them has the slope of the two clocks; at either end it may be off by the time between samples.

Source: median of the increments per counted sample as the rate (robust against stamps that are off); the smallest delay
at both ends of a record bounds the ratio of two clocks, because a delay is never negative; Moon, Skelly, Towsley,
Estimation and Removal of Clock Skew from Network Delay Measurements, INFOCOM 1999 (line below the delays); rectangular
bounds, JCGM 100:2008 section 4.3.7. A crystal keeps its rate within 1e-4, so increments of a log far from the usual one
are the recorder's, not the sensor's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.maths.arrays import Flags, Floats, Integers
from bench.model.errors import FitError
from bench.systems.gnc.estimators.earth_rate import tick_seconds
from bench.systems.gnc.wording import say

JITTER = 0.1  # of the interval between samples: a stamp further from its place is irregular
RATE_OFF = 0.01  # rate beside the nominal one, relative: a crystal is off by 1e-4 at most
CLOCKS_APART = 1e-3  # ratio of both clocks, relative
_LEAST_s = 10.0  # a record shorter than this says nothing about a clock against the bench clock
IRREGULAR, BACKWARDS, BURST, RATE, CLOCK = "irregular", "backwards", "burst", "rate", "clock"
UNKNOWN_STD = 5e-5 / math.sqrt(3.0)  # a common crystal is within 50 ppm
_WRAP_S = (1 << 32) * 1e-6
_SAME_s, _SAME = 2.5, 1e-3  # chunks may come a second late; clocks differ by less than that
_APART = 1e-3  # of the slope: beyond it the stamps are not of one clock
_CROWDED = 0.5  # of the mean interval: stamped closer than this, samples come in a burst
_BURSTY = 0.01  # share of crowded samples from which the stamps are no times of samples
_GAP = 1.5  # of the usual interval


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


def unwrapped_ticks_s(tick: Integers, bits: int = 32, tick_s: float = 1e-6) -> Floats:
    """Seconds from a counter of fixed width that starts again at 0.

    Args:    tick: (n,), as transmitted.   bits: width.   tick_s: of one step.
    Returns: (n,), seconds from the first; a step backwards of less than half the width stays one.
    """
    span = 1 << bits
    steps = np.mod(np.diff(np.asarray(tick, np.int64)) + span // 2, span) - span // 2
    return np.concatenate(([0.0], np.cumsum(steps) * tick_s))


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
        *_backwards(increments, counted),
        *_uneven(increments, off_s, median_s, counted),
        *_rate(rate_error, interval_s, median_s),
        *_against_the_bench(clock_error, clock_bound),
    ]
    worst_s = float(np.abs(off_s).max()) if off_s.size else 0.0
    return TickFindings(median_s, rate_error, worst_s, clock_error, clock_bound, tuple(faults))


def _backwards(increments: Floats, counted: Flags) -> list[tuple[str, int, int, str]]:
    bad = counted & (increments <= 0.0)
    if not bad.any():
        return []
    count, first = int(bad.sum()), int(np.argmax(bad)) + 1
    return [(BACKWARDS, count, first, say("check.backwards", count=count, first=first))]


def _uneven(increments: Floats, off_s: Floats, median_s: float, counted: Flags) -> list[tuple[str, int, int, str]]:
    """Increments beside their due; those of less than half of it come in bursts."""
    limit_s = JITTER * abs(median_s)
    bad = counted & (increments > 0.0) & (np.abs(off_s) > limit_s)
    if not bad.any():
        return []
    count, first = int(bad.sum()), int(np.argmax(bad)) + 1
    worst_ms = float(np.abs(off_s[bad]).max()) * 1e3
    text = say("check.irregular", count=count, limit=limit_s * 1e3, first=first, worst=worst_ms)
    faults = [(IRREGULAR, count, first, text)]
    crowded = bad & (increments < 0.5 * median_s)
    if crowded.any():
        count, first = int(crowded.sum()), int(np.argmax(crowded)) + 1
        text = say("check.burst", count=count, first=first)
        faults.append((BURST, count, first, text))
    return faults


def _rate(rate_error: float, interval_s: float, median_s: float) -> list[tuple[str, int, int, str]]:
    text = say("check.rate", every=median_s * 1e3, nominal=interval_s * 1e3)
    return [(RATE, 1, 0, text)] if abs(rate_error) > RATE_OFF else []


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


def _against_the_bench(clock_error: float, clock_bound: float) -> list[tuple[str, int, int, str]]:
    if not abs(clock_error) > max(CLOCKS_APART, 3.0 * clock_bound):
        return []
    text = say("check.clock", error=clock_error, limit=CLOCKS_APART)
    return [(CLOCK, 1, 0, text)]


@dataclass(frozen=True)
class UnitClock:
    """``error``: relative, positive = the unit's clock is fast.   ``std``: its standard uncertainty.
    ``span_s``: over which it was seen. An error that is known no better than crystals in general is taken as zero.
    """

    error: float = 0.0
    std: float = UNKNOWN_STD
    span_s: float = 0.0


def unit_clock(records: Sequence[tuple[Integers, Floats]], interval_s: float) -> UnitClock:
    """Ratio of both clocks from the longest stretch of records in which the unit was not restarted.

    Args:    records: (time stamps in us, 32 bits, and receive times of the bench in s) of each, in order.
             interval_s: between samples.
    Returns: UnitClock; the bench clock is taken as right.
    Raises:  nothing.
    Source:  see the head of this file.
    """
    clocks = [_slope([(unit_s, received_s) for _, unit_s, received_s in stretch], interval_s)
             for stretch in _stretches(records)]  # fmt: skip
    known = [clock for clock in clocks if clock.std < UNKNOWN_STD and abs(clock.error) < _APART]
    return min(known, key=lambda clock: clock.std, default=UnitClock())


def power_ons(records: Sequence[tuple[Integers, Floats]]) -> list[list[int]]:
    """Places of the records between two restarts of the unit's clock, that is, of one power-on each.

    Args:    records: as ``unit_clock``.
    Returns: places from 0, in their order.
    Raises:  nothing.
    Source:  stamps count from the power-on.
    """
    return [[place for place, _, _ in stretch] for stretch in _stretches(records)]


def _stretches(records: Sequence[tuple[Integers, Floats]]) -> list[list[tuple[int, Floats, Floats]]]:
    """Place, stamps and receive times of records whose stamps follow on one another."""
    stretches: list[list[tuple[int, Floats, Floats]]] = []
    for place, (tick_us, received_s) in enumerate(records):
        unit_s = tick_seconds(tick_us) + float(tick_us[0]) * 1e-6
        if stretches:
            last_unit_s, last_s = float(stretches[-1][-1][1][-1]), float(stretches[-1][-1][2][-1])
            between_s = float(received_s[0]) - last_s
            turns = round((last_unit_s + between_s - float(unit_s[0])) / _WRAP_S)
            unit_s = unit_s + turns * _WRAP_S
            if abs(float(unit_s[0]) - last_unit_s - between_s) < _SAME_s + _SAME * between_s:
                stretches[-1].append((place, unit_s, received_s))
                continue
        stretches.append([(place, unit_s, received_s)])
    return stretches


def _slope(stretch: Sequence[tuple[Floats, Floats]], interval_s: float) -> UnitClock:
    at_s, delay_s = _least_delays(stretch)
    span_s = float(at_s[-1] - at_s[0])
    if span_s <= 0.0:
        return UnitClock()
    first, last = _line_below(at_s, delay_s)
    slope, base_s = _slope_between(at_s, delay_s, first, last), float(at_s[last] - at_s[first])
    above = delay_s - slope * at_s
    least_s = max(interval_s, float(np.median(above) - above.min()))
    return UnitClock(error=-slope, std=least_s / base_s / math.sqrt(6.0), span_s=span_s)


def _least_delays(stretch: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Of each chunk that was received, its last sample: (k,) unit's time and delay, from the first one on."""
    unit_s, received_s = (np.concatenate(column) for column in zip(*stretch, strict=True))
    last = np.concatenate([np.diff(received_s) > 0.0, [True]])
    at_s = unit_s[last]
    return at_s - at_s[0], received_s[last] - at_s


def _line_below(at_s: Floats, delay_s: Floats) -> tuple[int, int]:
    """The two points on which a line below all others rests that lie furthest apart.

    The hull is made of the least delay in each of 200 parts, so that hours of samples cost nothing.
    """
    part = np.minimum((at_s / at_s[-1] * 200.0).astype(np.int64), 199)
    order = np.lexsort((delay_s, part))
    first = order[np.unique(part[order], return_index=True)[1]]
    hull: list[int] = []
    for k in (int(index) for index in first[np.argsort(at_s[first])]):
        while len(hull) > 1 and _slope_between(at_s, delay_s, hull[-2], hull[-1]) >= _slope_between(
            at_s, delay_s, hull[-1], k
        ):
            hull.pop()
        hull.append(k)
    return max(pairwise(hull), key=lambda edge: float(at_s[edge[1]] - at_s[edge[0]]))


def _slope_between(at_s: Floats, delay_s: Floats, first: int, last: int) -> float:
    return float((delay_s[last] - delay_s[first]) / (at_s[last] - at_s[first]))


@dataclass(frozen=True)
class SampleStamps:
    """``rate_Hz`` of the samples.   ``breaks`` (k,): samples in front of which others are missing.   ``missing``: how
    many, by the stamps.   ``crowded``: share of samples stamped less than half an interval behind the one before.
    ``worst_s``: largest distance of a stamp from even spacing.
    """

    rate_Hz: float
    breaks: Integers
    missing: int
    crowded: float
    worst_s: float

    @property
    def bursty(self) -> bool:
        """Whether the samples have to be counted, because the stamps are not their times."""
        return self.crowded > _BURSTY


def sample_stamps(t_s: Floats) -> SampleStamps:
    """Return rate and gaps from the stamps of a log.

    Stamps in bursts give the mean rate of the whole log and no gaps: one sample more or less cannot be told.

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
    mean = float(t_s[-1] - t_s[0]) / len(increments)
    crowded = float(np.mean(increments < _CROWDED * mean))
    if crowded > _BURSTY:
        even = t_s[0] + mean * np.arange(len(t_s))
        return SampleStamps(1.0 / mean, np.empty(0, np.int64), 0, crowded, float(np.abs(t_s - even).max()))
    usual = float(np.median(increments))
    gap = increments > _GAP * usual
    usual = float(np.mean(increments[~gap]))
    missing = int(np.rint(increments[gap] / usual - 1.0).sum())
    worst = float(np.abs(np.cumsum(np.where(gap, 0.0, increments - usual))).max())
    return SampleStamps(1.0 / usual, np.flatnonzero(gap).astype(np.int64) + 1, missing, crowded, worst)
