"""A bad reading among thousands, found before any fit: one that no quadric through most of the others explains.

Free quadrics (centre, shape and size open, closed or not) go through a few readings drawn at random; the one with the
smallest median distance of all readings has most likely met none that is bad. Readings that lie further off than any
noise are odd, as long as they are very few: many are no outliers but another surface.

Source: Rousseeuw, J. Am. Stat. Assoc. 79 (1984) 871 (least median of squares by random subsets); Taubin, IEEE Trans.
Pattern Anal. 13 (1991) 1115 (distance of a point from an algebraic surface to first order).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_SUBSETS, _TIMES = 20, 3  # subsets, and readings of each per coefficient
_SEED = 1984  # the same readings give the same answer
_FAR = 10.0 * 1.4826  # medians: ten standard deviations of normal noise
_ROUNDING = 1e-9  # of the size of the cloud
LARGEST_SHARE = 1e-3


def odd_readings(points: Array) -> NDArray[np.bool_]:
    """Return which readings lie off the surface of the others.

    Args:    points: (n, d), d = 2 or 3, any unit.
    Returns: (n,); at most one in a thousand, or one reading. All false where more lie off: then they are not odd.
    Source:  see the head of this file.
    """
    count = len(points)
    middle = np.median(points, axis=0)
    scale = float(np.median(np.linalg.norm(points - middle, axis=1)))
    nothing = np.zeros(count, np.bool_)
    unit = (points - middle) / (scale or 1.0)
    columns = _monomials(unit)
    drawn = _TIMES * columns.shape[1]
    if scale == 0.0 or count < 2 * drawn:
        return nothing
    rng = np.random.default_rng(_SEED)
    subsets = np.stack([rng.choice(count, drawn, replace=False) for _ in range(_SUBSETS)])
    coefficients = np.linalg.svd(columns[subsets], full_matrices=False)[2][:, -1]
    distances = [_distance(unit, columns, each) for each in coefficients]
    best = min(distances, key=lambda each: float(np.median(each)))
    odd = np.asarray(best > max(_FAR * float(np.median(best)), _ROUNDING))
    return odd if odd.sum() <= max(1.0, LARGEST_SHARE * count) else nothing


def _monomials(points: Array) -> Array:
    """Squares and products, components, one."""
    rows, columns = np.triu_indices(points.shape[1])
    return np.column_stack((points[:, rows] * points[:, columns], points, np.ones(len(points))))


def _distance(points: Array, columns: Array, coefficients: Array) -> Array:
    """Return distance of each point from a surface, to first order, (n,)."""
    dimensions = points.shape[1]
    form = np.zeros((dimensions, dimensions))
    form[np.triu_indices(dimensions)] = coefficients[: -dimensions - 1]
    slope = points @ (form + form.T) + coefficients[-dimensions - 1 : -1]
    return np.asarray(np.abs(columns @ coefficients) / np.maximum(np.linalg.norm(slope, axis=1), 1e-12))
