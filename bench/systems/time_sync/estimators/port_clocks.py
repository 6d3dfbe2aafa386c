"""A unit's clock against the bench clock, from when its frames were received: rate, offset and how well both are known.

A frame is received behind its time tag by a delay that is never less than some minimum. Where the receive stamps are
fine, a line below all delays has the ratio of both clocks as its slope: of all such lines the one with the least sum of
distances, which is an edge of the convex hull and the most likely line for exponential excess delays. Where the bench
looks at its ports in steps, the stamps lie on a grid, and frames that always arrive within the same step hide up to a
whole one: there the likelihood of the steps is taken, for an exponential excess delay and normal noise of the tags. It
is the jitter that shows the place within a step; without any, the uncertainty is that of the step. Tags of a clock that
runs evenly are taken without their noise, which no arrival depends on.

Source: Moon, Skelly, Towsley, Estimation and Removal of Clock Skew from Network Delay Measurements, INFOCOM 1999, and
Zhang, Liu, Xia, Clock Synchronization Algorithms for Network Measurements, INFOCOM 2002 (line below the delays, convex
hull); White, Econometrica 50 (1982) for the covariance of a likelihood that is not quite the right one; JCGM 100:2008
section 4.3.7 for rectangular bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats, Integers, rms
from bench.maths.stamps import lower_hull, tag_noise_s
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.stamp_grid import Grid, expected_covariance, grid_line

_BLOCKS = 24
LEAST_FRAMES = 200
_EVEN_s = 1e-4  # scatter of time tags about a steady clock up to which they are taken as steady
_EXPECTED_FRAMES, _CASES = 500, 512  # that stand for all frames, and for all rates and places within a step
_EVEN = (math.sqrt(5.0) - 1.0) / 2.0  # multiples spread evenly
_LOWEST = 2.0  # noise of the tags at the lowest delays, in standard deviations


@dataclass(frozen=True)
class PortClock:
    """Least delay of one port as a line over the unit's own time.

    ``at_s``: time of the unit in the middle of the recording.   ``delay_s``: receive stamp minus time tag there, at the
    least delay.   ``rate``: of that delay, s/s: positive = the unit's clock is slow against the bench.
    ``covariance``: (2, 2) of both.   ``jitter_s``: mean excess over the least delay, ``jitter_std_s``: its standard
    uncertainty.   ``grid_s``: step of the stamps, 0 if they are fine.   ``tag_noise_s``: white noise of the time tags.
    ``above_s``: (n,) delay above the line.
    """

    at_s: float
    delay_s: float
    rate: float
    covariance: Floats
    jitter_s: float
    jitter_std_s: float
    grid_s: float
    tag_noise_s: float
    above_s: Floats

    def least_s(self, at_s: float) -> float:
        """Least delay at a time of the unit, s."""
        return self.delay_s + self.rate * (at_s - self.at_s)

    def std_s(self, at_s: float) -> float:
        """Return its standard uncertainty, s."""
        row = np.array([1.0, at_s - self.at_s])
        return math.sqrt(float(row @ self.covariance @ row))

    @property
    def rate_std(self) -> float:
        """Standard uncertainty of the rate, s/s."""
        return math.sqrt(float(self.covariance[1, 1]))


def port_clock(device_s: Floats, counter: Integers, received_s: Floats, step_s: float = 0.0) -> PortClock:
    """Line of the least delay of one port.

    Args:    device_s: time tags, (n,), rising.   counter: of the frames, (n,).   received_s: receive stamps, (n,),
             second of the bench clock.   step_s: of the stamps, 0 if they are fine (``stamp_grid.grid_s``).
    Raises:  FitError B-SYNC-009 for fewer than 200 frames, or without a span.
    Source:  see the head of this file.
    """
    if device_s.size < LEAST_FRAMES or not device_s[-1] > device_s[0]:
        raise FitError(
            "B-SYNC-009",
            f"{device_s.size} frames do not tell the clock of a unit, {LEAST_FRAMES} in order of time are the least",
            next_step="record longer; look at the link's lost frames in the report",
        )
    tag_std_s, device_s = tag_noise_s(device_s, counter), even_tags_s(device_s, counter)
    at_s = 0.5 * float(device_s[0] + device_s[-1])
    half_s = 0.5 * float(device_s[-1] - device_s[0])
    place, delay_s = (device_s - at_s) / half_s, received_s - device_s
    base_s = float(delay_s.min())
    noise_s = tag_noise_s(device_s, counter)
    level, slope = line_below(place, delay_s - base_s)
    above_s = delay_s - base_s - level - slope * place
    if step_s > 0.0:
        grid = Grid(place, delay_s - base_s, step_s, noise_s)
        level, slope, jitter_s, covariance = grid_line(grid, level, slope)
        above_s = delay_s - base_s - level - slope * place
    else:
        jitter_s, covariance = float(above_s.mean()), _hull_covariance(place, above_s, noise_s)
    by_rate = np.array([1.0, 1.0 / half_s])
    return PortClock(
        at_s, base_s + level, slope / half_s, covariance[:2, :2] * np.outer(by_rate, by_rate), jitter_s,
        math.sqrt(float(covariance[2, 2])), step_s, tag_std_s, above_s,
    )  # fmt: skip


@dataclass(frozen=True)
class StampNoise:
    """What is declared of receive stamps: ``jitter_s``: mean excess over the least delay.   ``clock``: as much as the
    rate of a unit's clock may be off.
    """

    jitter_s: float
    clock: float


def expected_clock(device_s: Floats, noise: StampNoise, step_s: float = 0.0) -> PortClock:
    """Return a clock that is right, with the uncertainties that frames of declared noise will give.

    Args:    device_s: planned time tags, (n,), evenly spaced.   step_s: of the receive stamps, 0 if they are fine.
    Source:  see the head of this file. Where stamps come in steps, delays are an even sequence over their distribution,
             not a draw, and variances are means over all rates of the clock and all places within a step.
    """
    at_s, half_s = 0.5 * float(device_s[0] + device_s[-1]), 0.5 * float(device_s[-1] - device_s[0])
    if step_s > 0.0:
        frames_s = device_s[:: max(1, device_s.size // _EXPECTED_FRAMES)]
        place, number = (frames_s - at_s) / half_s, np.arange(frames_s.size) + 0.5
        late_s = -noise.jitter_s * np.log1p(-(number * _EVEN % 1.0))
        covariance = np.zeros((3, 3))
        for case in (np.arange(_CASES) + 0.5) / _CASES:
            line_s = case * step_s + frames_s * (1.0 + noise.clock * (2.0 * (case * _CASES * _EVEN % 1.0) - 1.0))
            seen_s = np.ceil((line_s + late_s) / step_s) * step_s - line_s
            grid = Grid(place, seen_s, step_s, 0.0)
            covariance += expected_covariance(grid, noise.jitter_s, device_s.size) / _CASES
    else:
        least_s = noise.jitter_s * _BLOCKS / device_s.size  # mean of the least delay of a part, and its deviation
        covariance = _of_least(2.0 * least_s**2, noise.jitter_s, device_s.size)
    by_rate = np.array([1.0, 1.0 / half_s])
    return PortClock(
        at_s, 0.0, 0.0, covariance[:2, :2] * np.outer(by_rate, by_rate), noise.jitter_s,
        math.sqrt(float(covariance[2, 2])), step_s, 0.0, np.zeros(device_s.size),
    )  # fmt: skip


def line_below(place: Floats, delay_s: Floats) -> tuple[float, float]:
    """Of all lines below the delays that with the least sum of distances: level at 0 and slope.

    Args:    place: (n,), rising, 0 within.   delay_s: (n,).
    Returns: level and slope of delay over place.
    Source:  Zhang, Liu, Xia (2002): the edge of the lower convex hull above the mean of the places.
    """
    hull = lower_hull(place, delay_s, 2000)
    mean = float(place.mean())
    right = next(k for k in range(1, len(hull)) if place[hull[k]] >= mean or k == len(hull) - 1)
    first, last = hull[right - 1 : right + 1]
    slope = float((delay_s[last] - delay_s[first]) / (place[last] - place[first]))
    return float(delay_s[first]) - slope * float(place[first]), slope


def _hull_covariance(place: Floats, above_s: Floats, noise_s: float) -> Floats:
    """Of level, slope and mean excess: as high above the line as the least delay in each of 24 parts, it may be off.

    The level is taken to be off by their RMS, for delays need not become short everywhere; the slope by what
    independent errors of that size make. Noise of the tags makes delays look too short, by about twice its size.
    """
    part = np.minimum(((place + 1.0) * 0.5 * _BLOCKS).astype(np.int64), _BLOCKS - 1)
    least_s = np.array([above_s[part == k].min() for k in range(_BLOCKS) if (part == k).any()])
    return _of_least(float(np.mean(least_s**2)) + (_LOWEST * noise_s) ** 2, float(above_s.mean()), above_s.size)


def _of_least(variance: float, jitter_s: float, frames: int) -> Floats:
    return np.diag([variance, variance * 3.0 / _BLOCKS, variance + jitter_s**2 / frames])


def even_tags_s(device_s: Floats, counter: Integers) -> Floats:
    """Return time tags without their noise, (n,): by a clock that runs evenly, unless they scatter too much about it.

    Units sample evenly by their own clock; what scatters is the tag. When a frame arrives has nothing to do with the
    noise of its tag, so noise that stays in the delays is taken for a place of the line within a step that it is not.

    Args:    device_s: (n,).   counter: of the frames, (n,), rising.
    Source:  a line over the counter; tags that scatter by more than 0.1 ms RMS stay as they are.
    """
    at = (counter - counter[0]).astype(np.float64)
    middle, half = 0.5 * at[-1], max(0.5 * at[-1], 1.0)
    line = np.polynomial.polynomial.polyfit((at - middle) / half, device_s, 1)
    even_s = line[0] + line[1] * (at - middle) / half
    off_s = device_s - even_s
    return even_s if rms(off_s) <= _EVEN_s else device_s


@dataclass(frozen=True)
class StampsDifference:
    """Offset of one unit's clock against another's by receive stamps: ``offset_s`` at ``at_s``, ``drift`` in s/s.

    ``std_s``: of the offset, with that of the latencies.   ``drift_std``: s/s.
    """

    at_s: float
    offset_s: float
    std_s: float
    drift: float
    drift_std: float


def clock_difference(
    one: PortClock, other: PortClock, at_s: float, latency_s: float = 0.0, latency_std_s: float = 0.0
) -> StampsDifference:
    """Clock of ``one`` minus clock of ``other``.

    Args:    one, other: ports whose time tags count from the same origin.   at_s: when.   latency_s: least delay of
             ``one`` minus that of ``other``, as stated; latency_std_s: its standard uncertainty.
    Returns: StampsDifference, positive = the clock of ``one`` is ahead.
    Source:  tag = bench time + offset, stamp = bench time + least delay.
    """
    return StampsDifference(
        at_s=at_s,
        offset_s=latency_s - (one.least_s(at_s) - other.least_s(at_s)),
        std_s=math.hypot(one.std_s(at_s), other.std_s(at_s), latency_std_s),
        drift=other.rate - one.rate,
        drift_std=math.hypot(one.rate_std, other.rate_std),
    )
