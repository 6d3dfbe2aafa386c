"""Consistency and observability: whether a filter knows its errors, and how much it was told about each state.

Normalised errors and innovations of a consistent filter follow chi-square; the mean over N runs times N has N times the
degrees of freedom.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with applications to tracking and navigation, 2001, section 5.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.kalman.innovation import rotation_between
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
    """Return the normalised squared error of the offset, one degree of freedom each.

    ``errors_s`` (..., R), ``covariance`` (..., 16, 16).
    NaN where the offset is not a state.
    """
    variance = covariance[..., OFFSET, OFFSET][..., None]
    return np.asarray(errors_s**2 / np.where(variance > 0.0, variance, np.nan))


@dataclass(frozen=True)
class Observability:
    """``eigenvalues`` (m, G, 16) ascending.   ``associated`` (m, G): the one of the offset.   ``component`` (m, G): of
    the offset in its eigenvector, 0 to 1; near 0.7 two directions share it.   ``offset_variance`` (m, G): P'_TdTd.
    NaN in groups where the offset is not a state.
    """

    eigenvalues: Array
    associated: Array
    component: Array
    offset_variance: Array


def observability(covariance: Array, first: Array) -> Observability:
    """Normalise covariances by the first one and take them apart.

    An eigenvalue near 1 belongs to a direction nothing is known of beyond what was known at the begin, near 0 to a well
    observed one. The eigenvalue "associated" with the time offset is the one whose eigenvector has the largest
    component of the offset. That association is a convention with a trap: in level flight position and offset are seen
    only as p - v T_d. Where the first position uncertainty is below v times that of the offset (1 m against 3 m at
    100 m/s and 30 ms) the largest component of the offset is in that well-seen direction, and the eigenvalue is small
    for any manoeuvre although nothing is known of the offset. With 10 m it is in the other one. The normalised variance
    of the offset itself, ``offset_variance``, has no such trap; look at both, and at ``component``.

    Args:    covariance: (m, G, 16, 16).   first: (G, 16, 16), diagonal.
    Source:  Ham and Brown, Observability, eigenvalues and Kalman filtering, IEEE Trans. AES 19(2), 1983; Lee et al.
             2020, equation (14), P' = P0^-1/2 P P0^-1/2 with the symmetric root of a diagonal P0.
    """
    root = np.sqrt(np.diagonal(first, axis1=-2, axis2=-1))
    state = root[:, OFFSET] > 0.0
    scale = np.where(root > 0.0, root, 1.0)
    values, vectors = np.linalg.eigh(covariance / (scale[:, :, None] * scale[:, None, :]))
    sizes = np.abs(vectors[..., OFFSET, :])
    which = np.argmax(sizes, axis=-1)[..., None]
    associated = np.take_along_axis(values, which, axis=-1)[..., 0]
    component = np.take_along_axis(sizes, which, axis=-1)[..., 0]
    variance = covariance[..., OFFSET, OFFSET] / scale[:, OFFSET] ** 2
    values[:, ~state], associated[:, ~state], component[:, ~state], variance[:, ~state] = (np.nan,) * 4
    return Observability(values, associated, component, variance)
