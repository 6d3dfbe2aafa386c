"""Are the errors as large as the filter says: normalised errors and innovations squared, with their bounds.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with applications to tracking and navigation, 2001, section 5.4: NEES
and NIS of a consistent filter follow chi-square; the mean over N runs times N has N times the degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.kalman.history import rotation_between
from bench.systems.time_sync.estimators.kalman.setup import OFFSET, FilterRun

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NisSummary:
    """Innovations of a whole run, (G, 4) by NIS_BLOCKS: ``ratio`` mean over degrees of freedom, 1 if consistent, above
    1 if the filter expects too little; ``outside`` share outside the 95 % interval, 0.05 if consistent and white;
    ``count`` how many.  NaN where there was none.
    """

    ratio: Array
    outside: Array
    count: Array


def nis_summary(run: FilterRun, from_s: float = -np.inf) -> NisSummary:
    """Innovations of the epochs from ``from_s`` on taken together.

    Source: see the head of this file.
    """
    late = run.t_s >= from_s
    count = run.nis_count[late]
    total = count.sum(axis=0)
    known = np.where(total > 0.0, total, np.nan)
    ratio = np.nansum(run.nis[late] * count, axis=0) / known / run.nis_dof
    return NisSummary(ratio, np.nansum(run.nis_outside[late] * count, axis=0) / known, total)


def state_errors(
    run: FilterRun, p: Array, v: Array, C: Array, accel_bias: Array, gyro_bias: Array, offset_s: Array
) -> Array:
    """Errors of all states, estimate minus reference, where a reference is known.

    Args:    p m, v m/s: (m, 3) and C (m, 3, 3) body to t at the kept epochs.   accel_bias m/s^2, gyro_bias rad/s:
             (R, 3).   offset_s: (G,).
    Returns: (m, G, R, 16) in the order of the covariance; attitude as rotation vector in t, rad.
    """
    estimate, reference = np.moveaxis(run.C, (-2, -1), (0, 1)), np.moveaxis(C, (-2, -1), (0, 1))[..., None, None]
    parts = (
        run.p - p[:, None, None],
        run.v - v[:, None, None],
        np.moveaxis(rotation_between(estimate, np.broadcast_to(reference, estimate.shape)), 0, -1),
        run.accel_bias - accel_bias,
        run.gyro_bias - gyro_bias,
        (run.offset_s - offset_s[:, None])[..., None],
    )
    return np.concatenate(parts, axis=-1)


def nees_of_offset(errors_s: Array, covariance: Array) -> Array:
    """The same of the offset alone: ``errors_s`` (..., R), ``covariance`` (..., 16, 16); one degree of freedom each.

    NaN where the offset is not a state.
    """
    variance = covariance[..., OFFSET, OFFSET][..., None]
    return np.asarray(errors_s**2 / np.where(variance > 0.0, variance, np.nan))
