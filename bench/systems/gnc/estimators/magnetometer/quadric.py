"""Closed quadric (ellipse in the plane, ellipsoid in space) through noisy points, by orthogonal distance.

A fit of the conic's coefficients is biased by the noise of the points, because they stand in it squared. The distance
of a point from the curve is linear in its noise. What is left
of the bias goes with the curvature: noise s about a radius R makes it s^2 / (2 R) too large, 0.7 ppm of R at
s / R = 0.5 mgauss / 0.43 gauss, alike on all axes.

Source: Gander, Golub and Strebel, BIT 34 (1994) 558 (geometric fit); Ahn, Rauh and Warnecke, Pattern
Recognition 34 (2001) 2283 (orthogonal distance as residual).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import optimize

from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.systems.gnc.estimators.magnetometer.wander import Uncertainty, Wander, uncertainty

_FOOT_STEPS = 60
_FOOT_TOLERANCE = 1e-9  # steps square themselves, so the next would be below rounding
_MOST_STEPS = 200
_SAME = 1e-12  # scatter of readings that differ by rounding only


@dataclass(frozen=True)
class Quadric:
    """Points v of the surface obey ``|shape @ (v - centre)| = 1``.

    Attributes:
        centre: (d,), unit of the points.   shape: (d, d), upper triangular, positive diagonal, 1 / unit.
        Parameters: centre, then the upper triangle row by row; p = d + d (d + 1) / 2.
        distance: signed orthogonal distance of each point, (n,), positive outside.   noise: its standard deviation
            with n - p degrees of freedom.   jacobian: (n, p) derivatives of ``distance``, parameters in these units.
            uncertainty: of the parameters, see ``estimators.magnetometer.wander``.
    """

    centre: Floats
    shape: Floats
    distance: Floats
    jacobian: Floats
    uncertainty: Uncertainty

    @property
    def covariance(self) -> Floats:
        """(p, p) of the parameters."""
        return self.uncertainty.covariance

    @property
    def noise(self) -> float:
        """Standard deviation of ``distance``, with n - p degrees of freedom."""
        return self.uncertainty.noise

    @property
    def wander(self) -> Wander:
        """How the noise wanders from reading to reading."""
        return self.uncertainty.wander

    def seen(self, points: Floats) -> tuple[Floats, Floats]:
        """Return distance (m,) of further points (m, d) and its derivatives (m, p), as ``distance``, ``jacobian``."""
        place = np.concatenate((self.centre, self.shape[np.triu_indices(len(self.centre))]))
        return _distances(points, place, len(self.centre))

    def corrected(self, points: Floats) -> Floats:
        """Return points on a circle or sphere of radius 1 about the origin, the shape of ``points`` (n, d)."""
        return (points - self.centre) @ self.shape.T


def fit_quadric(points: Floats, begins: Sequence[int] = (), noise: float | None = None) -> Quadric:
    """Least squares of the orthogonal distances, noise alike on all axes.

    Args:    points: (n, d), d = 2 or 3, any unit, in order of time; rows with NaN must be left out before.
             begins: first point of each record, if there are several.   noise: of points that hold none.
    Returns: Quadric.
    Raises:  FitError B-FIT-090 if there are too few points or no closed quadric passes through them.
    Source:  see the head of this file.
    """
    count, dimensions = points.shape
    parameters = dimensions + dimensions * (dimensions + 1) // 2
    if count <= parameters or not np.isfinite(points).all():
        raise _no_quadric(f"{count} points are too few for {parameters} parameters, or one is not a number")
    middle = points.mean(axis=0)
    scale = float(np.sqrt(np.square(points - middle).sum(axis=1).mean()))
    if scale <= _SAME * float(np.abs(middle).max()):
        raise _no_quadric(f"all {count} points are the same")
    unit = (points - middle) / scale

    @lru_cache(maxsize=1)  # the search asks for distances and derivatives one after the other at the same place
    def both(place: bytes) -> tuple[Floats, Floats]:
        return _distances(unit, np.frombuffer(place), dimensions)

    solution = optimize.least_squares(
        lambda place: both(place.tobytes())[0],
        _round(unit),
        jac=lambda place: both(place.tobytes())[1],
        method="lm",
        xtol=1e-13,
        ftol=1e-13,
        gtol=1e-13,
        max_nfev=_MOST_STEPS,
    )
    if solution.status <= 0:
        raise _no_quadric(f"the {count} points lie on a line, a plane or an open curve")
    centre, shape = _split(solution.x, dimensions)
    distance, jacobian = both(solution.x.tobytes())
    sign = np.sign(np.diag(shape))
    factor = np.concatenate((np.full(dimensions, scale), sign[np.triu_indices(dimensions)[0]] / scale))
    distance, jacobian = scale * distance, scale * jacobian / factor
    return Quadric(
        centre=middle + scale * centre,
        shape=sign[:, None] * shape / scale,
        distance=distance,
        jacobian=jacobian,
        uncertainty=uncertainty(jacobian, distance, begins, noise),
    )


def _round(unit: Floats) -> Floats:
    """Start: the circle or sphere through the points, whose equation is linear in centre and radius.

    Source: Kasa, IEEE Trans. Instrum. Meas. 25 (1976) 8. Started from the coefficients of a free conic, eight scattered
    points end in a far branch; from the circle they end in the published best fit.
    """
    dimensions = unit.shape[1]
    columns = np.column_stack((2.0 * unit, np.ones(len(unit))))
    solution = np.linalg.lstsq(columns, np.square(unit).sum(axis=1), rcond=None)[0]
    centre = solution[:-1]
    radius = float(np.sqrt(np.square(unit - centre).sum(axis=1).mean()))
    return np.concatenate((centre, (np.eye(dimensions) / radius)[np.triu_indices(dimensions)]))


def _split(place: Floats, dimensions: int) -> tuple[Floats, Floats]:
    shape = np.zeros((dimensions, dimensions))
    shape[np.triu_indices(dimensions)] = place[dimensions:]
    return place[:dimensions], shape


def _distances(points: Floats, place: Floats, dimensions: int) -> tuple[Floats, Floats]:
    """Signed orthogonal distances (n,) and their derivatives (n, p).

    The foot moves along the surface only, so to first order the distance changes by F_parameter / |grad F| at it.
    """
    centre, shape = _split(place, dimensions)
    stretch, turn = np.linalg.svd(shape)[1:]
    axes = 1.0 / stretch
    local = (points - centre) @ turn.T
    foot = _feet(local, axes)
    from_centre = foot @ turn
    inside = from_centre @ shape.T  # W (f - c), unit length
    slope = inside @ shape  # half the gradient of |W (v - c)|^2
    steep = np.linalg.norm(slope, axis=1)
    distance = np.einsum("nd,nd->n", local @ turn - from_centre, slope) / steep
    rows, columns = np.triu_indices(dimensions)
    derivative = np.column_stack((-slope, inside[:, rows] * from_centre[:, columns])) / steep[:, None]
    return distance, derivative


def _feet(local: Floats, axes: Floats) -> Floats:
    """Feet of the perpendiculars on an ellipsoid along its axes: a_k^2 p_k / (t + a_k^2) with t by Newton's method.

    The sum of squares falls and is convex in t beyond its poles, so from the left the steps never pass the root.
    Source: Eberly, Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid (Geometric Tools, 2011).
    """
    squares = axes**2
    t = np.max(axes * np.abs(local) - squares, axis=1)
    for _ in range(_FOOT_STEPS):
        ratio = axes * local / np.maximum(t[:, None] + squares, 1e-300)
        excess = np.square(ratio).sum(axis=1) - 1.0
        fall = 2.0 * (np.square(ratio) / np.maximum(t[:, None] + squares, 1e-300)).sum(axis=1)
        step = excess / np.maximum(fall, 1e-300)
        t = t + step
        if np.max(np.abs(step)) < _FOOT_TOLERANCE * float(squares.max()):
            break
    foot = squares * local / np.maximum(t[:, None] + squares, 1e-300)
    return np.asarray(foot / np.linalg.norm(foot / axes, axis=1)[:, None])


def _no_quadric(reason: str) -> FitError:
    return FitError(
        "B-FIT-090",
        f"no ellipse or ellipsoid can be fitted: {reason}",
        next_step="look at the X-Y figure of the readings; turn the unit through whole turns",
    )
