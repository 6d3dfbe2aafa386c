"""Where an inertial unit was at rest: from its accelerometers against a declared interval at rest, or from
accelerometers and gyroscopes against the noise that the log itself shows.

Without a declared interval nothing is set for a file: the quietest windows are the noise of the sensors. The window and
the multiple are the same.

Source: Tedaldi, Pretto and Menegatti, A robust and easy to implement method for IMU calibration without external
equipments, ICRA 2014, section IV: the length of the vector of the three variances in a window, against a multiple of
the same in an initial interval at rest. The level from the quietest windows is this program's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.maths.arrays import Flags, Floats, Integers
from bench.model.errors import FitError

MULTIPLE = 5.0  # of the noise's variance that still counts as rest
WINDOW_s = 2.0
LEAST_s = 1.0
STEADY_deg_s = 5.0  # a mean rate this far from that of the other rests is a steady turn, no change of bias


@dataclass(frozen=True)
class StaticIntervals:
    """``begin``, ``end`` (k,): first sample at rest and the one behind the last.   ``threshold``: length of the vector
    of variances, unit^2.   ``initial``: the same of the initial interval.
    """

    begin: Integers
    end: Integers
    threshold: float
    initial: float

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First sample at rest and the one behind the last of each interval."""
        return list(zip(self.begin.tolist(), self.end.tolist(), strict=True))

    def means(self, samples: Floats) -> Floats:
        """Return mean of each interval, (k, 3)."""
        return np.stack([samples[a:b].mean(axis=0) for a, b in self.spans])


def static_intervals(
    samples: Floats,
    rate_Hz: float,
    *,
    initial_s: float,
    multiple: float = 5.0,
    window_s: float = 2.0,
    least_s: float = 1.0,
) -> StaticIntervals:
    """Find the intervals at rest.

    Args:    samples: (n, 3) of the accelerometers, any unit.   rate_Hz: of the samples.   initial_s: rest at the begin.
             multiple: of the initial variance that still counts as rest.   window_s: over which the variance is taken,
             centred.   least_s: a shorter interval is left out.
    Returns: StaticIntervals in order of time.
    Raises:  FitError B-FIT-084 if the record is shorter than its initial interval, or if no interval is at rest.
    Source:  Tedaldi et al. 2014, section IV.
    """
    half, first = max(1, round(0.5 * window_s * rate_Hz)), round(initial_s * rate_Hz)
    if first < 2 or len(samples) < max(first, 2 * half + 1):
        raise _no_rest(f"{len(samples) / rate_Hz:.4g} s of samples for {initial_s:g} s of rest first")
    initial = float(np.linalg.norm(np.var(samples[:first], axis=0)))
    if initial == 0.0:
        raise _no_rest(f"the outputs do not change at all in the first {initial_s:g} s")
    size = np.linalg.norm(moving_variance(samples, half), axis=1)
    begin, end = _stretches(size < multiple * initial)
    long = end - begin >= least_s * rate_Hz
    if not long.any():
        raise _no_rest(
            f"no interval of {least_s:g} s stays below {multiple:g} times the variance of the first {initial_s:g} s"
        )
    return StaticIntervals(begin[long], end[long], multiple * initial, initial)


def _stretches(still: Flags) -> tuple[Integers, Integers]:
    """Return the first sample of each stretch that is still, and the one behind its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    return edges[0::2], edges[1::2]


def moving_variance(samples: Floats, half: int) -> Floats:
    """Variance around each sample.

    Args:    samples: (n, 3), any unit.   half: samples on each side.
    Returns: (n, 3), in windows of 2 half + 1 samples; infinite within half a window of an end.
    Source:  definition of the variance, from running sums.
    """
    centred = samples - samples.mean(axis=0)  # sums of squares would lose digits
    width = 2 * half + 1
    sums = np.cumsum(np.vstack([np.zeros(3), centred]), axis=0)
    squares = np.cumsum(np.vstack([np.zeros(3), centred**2]), axis=0)
    mean = (sums[width:] - sums[:-width]) / width
    inside = (squares[width:] - squares[:-width]) / width - mean**2
    return np.pad(inside, ((half, half), (0, 0)), constant_values=np.inf)


_FROM_REST = (
    "leave the unit at rest before it is turned by hand, and a few seconds in each pose; "
    "look at the initial interval declared"
)
_SEVERAL_RESTS = "leave the unit at rest for a few seconds several times; check that the columns are the sensors"


def _no_rest(message: str, next_step: str = _FROM_REST) -> FitError:
    return FitError("B-FIT-084", message, next_step=next_step)


def find_rests(
    accel: Floats, gyro: Floats, rate_Hz: float, breaks: Integers, steady: float = STEADY_deg_s
) -> StaticIntervals:
    """Find the intervals in which neither triad shows more than its own noise.

    Args:    accel, gyro: (n, 3), any unit.   rate_Hz: of the samples.   breaks: samples in front of which others are
             missing; no rest goes across.   steady: as ``STEADY_deg_s``, in the unit of the gyroscopes; infinite where
             that is counts.
    Returns: StaticIntervals, threshold and noise of the accelerometers.
    Raises:  FitError B-FIT-084 if there is no interval of 1 s, or the outputs do not change at all.
    Source:  see the head of this file.
    """
    half = max(1, round(0.5 * WINDOW_s * rate_Hz))
    if len(accel) < 2 * half + 1:
        raise _no_rest(
            f"the log is {len(accel) / rate_Hz:.3g} s long, shorter than one window of {WINDOW_s:g} s", _SEVERAL_RESTS
        )
    size = _size(accel, half, "accelerometers")
    noise = quiet_level(size)
    turning = _size(gyro, half, "gyroscopes")
    still = (size < MULTIPLE * noise) & (turning < MULTIPLE * quiet_level(turning))
    still[breaks] = False
    begin, end = _stretches(still)
    keep = end - begin >= LEAST_s * rate_Hz
    if keep.any():
        keep &= _not_turning(gyro, begin, end, keep, steady)
    if not keep.any():
        raise _no_rest(f"nothing stays below {MULTIPLE:g} times the noise for {LEAST_s:g} s", _SEVERAL_RESTS)
    return StaticIntervals(begin[keep], end[keep], MULTIPLE * noise, noise)


def quiet_level(size: Floats) -> float:
    """The usual size of the windows that hold nothing but noise: the median of those within 5 times the smallest."""
    return float(np.median(size[size < MULTIPLE * float(size.min())]))


def _size(samples: Floats, half: int, what: str) -> Floats:
    """Return length of the vector of variances, at least that of the resolution; infinite near the ends."""
    steps = [np.diff(np.unique(column)) for column in samples.T]
    if not all(step.size for step in steps):
        raise _no_rest(f"an output of the {what} does not change at all", _SEVERAL_RESTS)
    floor = float(np.linalg.norm([step.min() ** 2 / 12.0 for step in steps]))
    return np.asarray(np.maximum(np.linalg.norm(moving_variance(samples, half), axis=1), floor))


def _not_turning(gyro: Floats, begin: NDArray[np.intp], end: NDArray[np.intp], keep: Flags, steady: float) -> Flags:
    """Return whether the mean rate is near the usual one, weighted by length: turning evenly is as quiet as rest."""
    means = np.stack([gyro[a:b].mean(axis=0) for a, b in zip(begin, end, strict=True)])
    usual = np.median(np.repeat(means[keep], (end - begin)[keep], axis=0), axis=0)
    return np.asarray(np.linalg.norm(means - usual, axis=1) < steady)
