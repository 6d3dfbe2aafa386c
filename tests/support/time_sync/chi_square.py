"""Consistency of all states of a filter, and where chi-square keeps the mean of many runs.

Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from bench.systems.time_sync.estimators.kalman.setup import Array


def nees(errors: Array, covariance: Array) -> Array:
    """Normalised error squared of the states given.

    Args:    errors: (..., R, n).   covariance: (..., n, n), positive; take the offset out where it is not a state.
    Returns: (..., R), with n degrees of freedom each.
    Source:  see the head of this file.
    """
    solved = np.linalg.solve(covariance, np.swapaxes(errors, -1, -2))
    return np.asarray(np.sum(errors * np.swapaxes(solved, -1, -2), axis=-1))


def chi_square_interval(dof: float, runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Interval of the mean over ``runs`` independent runs of a chi-square with ``dof`` degrees of freedom, two-sided.

    Source: quantiles by the inverse of the incomplete gamma function, chi-square(k) = 2 gamma(k / 2).
    """
    half = 0.5 * dof * runs
    low, high = special.gammaincinv(half, [0.5 - 0.5 * probability, 0.5 + 0.5 * probability])
    return 2.0 * float(low) / runs, 2.0 * float(high) / runs
