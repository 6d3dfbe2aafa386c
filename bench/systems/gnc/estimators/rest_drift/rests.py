"""Where an inertial unit was at rest, from accelerometers and gyroscopes, against the noise that the log itself shows.

No interval is declared and nothing is set for a file: the quietest windows are the noise of the sensors. The window and
the multiple are those of the detector with a declared interval (``bench.systems.gnc.estimators.static_intervals``).

Source: Tedaldi, Pretto and Menegatti, ICRA 2014, section IV, for the length of the vector of variances in a window; the
level from the quietest windows instead of a declared interval is this program's own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError
from bench.systems.gnc.estimators.static_intervals import StaticIntervals, moving_variance

Array = NDArray[np.float64]
MULTIPLE = 5.0  # of the noise's variance that still counts as rest
WINDOW_s = 2.0
LEAST_s = 1.0
STEADY_deg_s = 5.0  # a mean rate this far from that of the other rests is a steady turn, no change of bias


def find_rests(
    accel: Array, gyro: Array, rate_Hz: float, breaks: NDArray[np.int64], steady: float = STEADY_deg_s
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
        raise _none(f"the log is {len(accel) / rate_Hz:.3g} s long, shorter than one window of {WINDOW_s:g} s")
    size = _size(accel, half, "accelerometers")
    noise = quiet_level(size)
    turning = _size(gyro, half, "gyroscopes")
    still = (size < MULTIPLE * noise) & (turning < MULTIPLE * quiet_level(turning))
    still[breaks] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    begin, end = edges[0::2], edges[1::2]
    keep = end - begin >= LEAST_s * rate_Hz
    if keep.any():
        keep &= _not_turning(gyro, begin, end, keep, steady)
    if not keep.any():
        raise _none(f"nothing stays below {MULTIPLE:g} times the noise for {LEAST_s:g} s")
    return StaticIntervals(begin[keep], end[keep], MULTIPLE * noise, noise)


def quiet_level(size: Array) -> float:
    """The usual size of the windows that hold nothing but noise: the median of those within 5 times the smallest."""
    return float(np.median(size[size < MULTIPLE * float(size.min())]))


def _size(samples: Array, half: int, what: str) -> Array:
    """Return length of the vector of variances, at least that of the resolution; infinite near the ends."""
    steps = [np.diff(np.unique(column)) for column in samples.T]
    if not all(one.size for one in steps):
        raise _none(f"an output of the {what} does not change at all")
    floor = float(np.linalg.norm([one.min() ** 2 / 12.0 for one in steps]))
    return np.asarray(np.maximum(np.linalg.norm(moving_variance(samples, half), axis=1), floor))


def _not_turning(
    gyro: Array, begin: NDArray[np.intp], end: NDArray[np.intp], keep: NDArray[np.bool_], steady: float
) -> NDArray[np.bool_]:
    """Return whether the mean rate is near the usual one, weighted by length: turning evenly is as quiet as rest."""
    means = np.stack([gyro[a:b].mean(axis=0) for a, b in zip(begin, end, strict=True)])
    usual = np.median(np.repeat(means[keep], (end - begin)[keep], axis=0), axis=0)
    return np.asarray(np.linalg.norm(means - usual, axis=1) < steady)


def _none(message: str) -> FitError:
    return FitError(
        "B-FIT-084",
        message,
        next_step="leave the unit at rest for a few seconds several times; check that the columns are the sensors",
    )
