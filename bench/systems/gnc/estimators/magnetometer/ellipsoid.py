"""Hard and soft iron of a three-axis magnetometer: an ellipsoid by orthogonal distance, refused where undetermined.

Model: ``v_out = hard_iron + W^-1 u`` with |u| = norm. Readings alone leave the orientation of u open: the symmetric
root turns the axes least; any other corrects the size of the field equally.

Do the readings determine an ellipsoid? A turn about one axis leaves a circle, two circles leave the product of two
components, a small cap leaves most: through all of these pass many ellipsoids, and a fit would pick one by the noise.
So the readings, seen from the middle of the sphere through them, must separate all nine coefficients of the quadric by
themselves; what noise separates counts for nothing.

Source: Gander, Golub and Strebel, BIT 34 (1994) 558 (coefficients as smallest singular vector); Renaudin, Afzal and
Lachapelle, J. Sensors 2010, 967245 (model of hard and soft iron); Golub and Van Loan, Matrix Computations, section 5.5
(numerical rank).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from bench.maths.arrays import Flags, Floats
from bench.model.errors import FitError
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric, fit_quadric
from bench.systems.gnc.estimators.magnetometer.wander import monomials, odd_readings
from bench.systems.gnc.wording import say

LARGEST_STD = 0.01  # standard uncertainty of the size of the corrected field in the worst direction, relative
_STEP = 1e-6
_TRIANGLE = np.triu_indices(3)
LEAST_SEPARATION = 0.02  # second smallest singular value over the largest; an even sphere 0.21, half a sphere 0.04
LEAST_ABOVE_NOISE = 5.0  # second smallest over smallest
LARGEST_HOLE_deg = 60.0  # radius of the empty cap; three great circles leave 55
_FLAT = 0.02  # thinner than this part of its width, readings lie in a plane
_POINTS = 642  # directions in which a sphere is searched, 8 degrees apart


@dataclass(frozen=True)
class EllipsoidFit:
    """Correction ``u = soft_iron @ (v_out - hard_iron)``.

    Attributes:
        hard_iron: (3,), unit of the readings.   hard_iron_covariance: (3, 3).
        symmetric: (3, 3) soft iron.   symmetric_std: (3, 3) standard uncertainties of its elements.
            hard_iron_dof (3,), symmetric_dof (3, 3): degrees of freedom behind them.
        slope: (12, 9) derivatives of hard iron and soft iron, row by row, by the parameters of the quadric.
        norm: size of u, unit of the readings: as given, or the mean radius for which the correction keeps volumes.
        noise: standard deviation of the orthogonal distances.   wander: see
        ``estimators.magnetometer.quadric.Quadric``.   coverage: of the sphere; its sentences belong into a report.
    """

    hard_iron: Floats
    hard_iron_covariance: Floats
    hard_iron_dof: Floats
    symmetric: Floats
    symmetric_std: Floats
    symmetric_dof: Floats
    slope: Floats
    norm: float
    quadric: Quadric
    coverage: SphereCoverage
    odd: Flags

    @property
    def noise(self) -> float:
        """Standard deviation of the orthogonal distances, unit of the readings."""
        return self.quadric.noise

    def corrected(self, field: Floats) -> Floats:
        """Return readings (n, 3) without hard and soft iron, unit of ``norm``."""
        return (field - self.hard_iron) @ self.symmetric.T


def fit_ellipsoid(
    field: Floats, norm: float | None = None, begins: Sequence[int] = (), noise: float | None = None
) -> EllipsoidFit:
    """Hard iron, soft iron and their uncertainty from readings in many directions.

    Args:    field: (n, 3), same unit and like noise on all axes, gaps left out.   norm: size of the field if it is
             known; without it only ratios of sensitivities are determined, and the correction keeps volumes.
             begins: first reading of each record, if there are several.   noise: of readings that hold none.
    Returns: EllipsoidFit; a reading among a thousand that no ellipsoid of the others explains is left out.
    Raises:  FitError B-FIT-090 for too few readings or no closed surface; B-FIT-091 if the readings do not determine
             the ellipsoid or leave its size in some direction uncertain by more than 1 %, naming the direction.
    Source:  see the head of this file; covariance by first derivatives, JCGM 102:2011 section 6.2.
    """
    field = np.asarray(field, np.float64)
    odd = odd_readings(field) if len(field) else np.zeros(0, np.bool_)
    kept = np.flatnonzero(~odd)
    coverage = sphere_coverage(field[kept])
    _require_coverage(coverage)
    quadric = fit_quadric(field[kept], np.searchsorted(kept, np.asarray(begins, np.intp)).tolist(), noise)
    _require_known(quadric)
    of_root = _derivative(quadric.shape, norm)
    std = np.sqrt(np.einsum("rp,pq,rq->r", of_root, quadric.covariance[3:, 3:], of_root))
    slope = linalg.block_diag(np.eye(3), of_root)
    dof = quadric.uncertainty.dof(slope)
    return EllipsoidFit(
        hard_iron=quadric.centre,
        hard_iron_covariance=quadric.covariance[:3, :3],
        hard_iron_dof=dof[:3],
        symmetric=_root(quadric.shape, norm),
        symmetric_std=std.reshape(3, 3),
        symmetric_dof=dof[3:].reshape(3, 3),
        slope=slope,
        norm=_norm(quadric.shape, norm),
        quadric=quadric,
        coverage=coverage,
        odd=odd,
    )


def _norm(shape: Floats, norm: float | None) -> float:
    return float(np.prod(np.diag(shape)) ** (-1.0 / 3.0)) if norm is None else norm


def _root(shape: Floats, norm: float | None) -> Floats:
    """Symmetric soft iron of the surface |shape v| = 1."""
    scaled = shape * _norm(shape, norm)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


def _derivative(shape: Floats, norm: float | None) -> Floats:
    """(9, 6) derivatives of the root with respect to the upper triangle, by central differences."""
    step = _STEP * shape[0, 0]
    columns = []
    for row, column in zip(*_TRIANGLE, strict=True):
        change = np.zeros((3, 3))
        change[row, column] = step
        columns.append((_root(shape + change, norm) - _root(shape - change, norm)).ravel() / (2.0 * step))
    return np.column_stack(columns)


def _require_known(quadric: Quadric) -> None:
    """Refuse readings that leave the size of the corrected field uncertain in any direction.

    Raises:  FitError B-FIT-091 above ``LARGEST_STD``, naming the direction.
    """
    height = np.linspace(-1.0, 1.0, 41)
    turn = np.arange(0.0, 2.0 * np.pi, np.pi / 20.0)
    flat = np.sqrt(1.0 - height**2)
    unit = np.stack((np.outer(flat, np.cos(turn)), np.outer(flat, np.sin(turn)), np.outer(height, 0 * turn + 1)), -1)
    unit = unit.reshape(-1, 3)  # directions of u; readings relative to the centre are W^-1 u
    reading = np.linalg.solve(quadric.shape, unit.T).T
    slope = np.column_stack((-unit @ quadric.shape, unit[:, _TRIANGLE[0]] * reading[:, _TRIANGLE[1]]))
    variance = np.einsum("np,pq,nq->n", slope, quadric.covariance, slope)
    worst = int(np.argmax(variance))
    std = float(np.sqrt(variance[worst]))
    if not std <= LARGEST_STD:
        name = _direction_name(reading[worst] / np.linalg.norm(reading[worst]))
        raise FitError(
            "B-FIT-091",
            f"the readings do not determine an ellipsoid: along {name} its "
            f"size is uncertain by {100 * std:.2g} % (limit {100 * LARGEST_STD:g} %)",
            next_step="turn the unit so that this direction lies along and against the field, and read longer",
        )


@dataclass(frozen=True)
class SphereCoverage:
    """How readings cover the sphere of directions.

    Attributes:
        separation: see ``LEAST_SEPARATION``.   above_noise: see ``LEAST_ABOVE_NOISE``.   determined: both hold.
        weakest: (3,) unit vector, sensor axes, along which the readings say least about the ellipsoid; the middle of
            the hole where that is too wide.
        hole_deg: radius of the largest empty cap of directions.   hole: (3,) its middle.
    """

    separation: float
    above_noise: float
    determined: bool
    weakest: Floats
    hole_deg: float
    hole: Floats

    @property
    def complete(self) -> bool:
        """No empty cap wider than the limit: the result holds in every direction without extrapolation."""
        return self.hole_deg <= LARGEST_HOLE_deg

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences a reader needs about a coverage that determines the ellipsoid but is not complete."""
        if self.complete:
            return ()
        numbers, nearest = _direction(self.hole)
        return (say("check.hole", hole=self.hole_deg, direction=numbers, nearest=nearest, limit=LARGEST_HOLE_deg),)


def sphere_coverage(field: Floats) -> SphereCoverage:
    """Coverage of the sphere by readings of three axes.

    Args:    field: (n, 3), any unit, n > 9.
    Returns: SphereCoverage.
    Raises:  FitError B-FIT-090 for fewer than ten readings or readings that are all the same.
    Source:  see the head of this file.
    """
    seen = _from_the_middle(field)
    columns = monomials(seen) / np.sqrt(len(seen))
    sizes, vectors = np.linalg.svd(np.linalg.qr(columns, mode="r"))[1:]
    grid = _directions()
    weakness = _weakness(sizes, vectors, monomials(grid))
    unit = seen / np.linalg.norm(seen, axis=1)[:, None]
    nearest = _nearest_cosine(grid, unit)
    hole = int(np.argmin(nearest))
    separation = float(sizes[8] / sizes[0])
    above = float(sizes[8] / max(sizes[9], 1e-15 * sizes[0]))
    weakest = grid[hole] if np.rad2deg(np.arccos(nearest[hole])) > LARGEST_HOLE_deg else grid[int(np.argmax(weakness))]
    return SphereCoverage(
        separation=separation,
        above_noise=above,
        determined=separation >= LEAST_SEPARATION and above >= LEAST_ABOVE_NOISE,
        weakest=weakest,
        hole_deg=float(np.rad2deg(np.arccos(np.clip(nearest[hole], -1.0, 1.0)))),
        hole=grid[hole],
    )


def _require_coverage(coverage: SphereCoverage) -> None:
    """Refuse readings that do not determine the ellipsoid.

    Raises:  FitError B-FIT-091, naming the direction along which they say least.
    """
    if coverage.determined:
        return
    raise FitError(
        "B-FIT-091",
        f"the readings do not determine an ellipsoid: they say too little about the direction "
        f"{_direction_name(coverage.weakest)} (separation {coverage.separation:.2g}, limit {LEAST_SEPARATION:g}; "
        f"{coverage.above_noise:.1f} times the noise, limit {LEAST_ABOVE_NOISE:g})",
        next_step=_SCATTERED if coverage.separation >= LEAST_SEPARATION else _FURTHER,
    )


_FURTHER = (
    "turn the unit about further axes so that each of its axes points along and against the field, or evaluate a turn "
    "about one axis as an ellipse"
)
_SCATTERED = (
    "the directions are enough, but the readings scatter about every ellipsoid: look for a field that changes (steel, "
    "motors, currents near the table) and for an axis that saturates"
)


def _direction_name(direction: Floats) -> str:
    """Return a unit vector with the sensor axis that is nearest: "(0.00, 0.00, 1.00), nearest +z"."""
    numbers, nearest = _direction(direction)
    return f"({numbers}), nearest {nearest}"


def _direction(direction: Floats) -> tuple[str, str]:
    """Return the numbers of a unit vector, and the sensor axis that is nearest."""
    axis = int(np.argmax(np.abs(direction)))
    numbers = ", ".join(f"{0.0 + round(float(part), 2):.2f}" for part in direction)
    return numbers, f"{'+' if direction[axis] > 0 else '-'}{'xyz'[axis]}"


def _from_the_middle(field: Floats) -> Floats:
    """Readings from the middle of the sphere through them, in its radii; of a plane, from the middle of its circle."""
    field = np.asarray(field, np.float64)
    middle = field.mean(axis=0) if len(field) else np.zeros(3)
    scale = float(np.sqrt(np.square(field - middle).sum(axis=1).mean())) if len(field) else 0.0
    if len(field) < 10 or not scale > 1e-12 * float(np.abs(middle).max()):
        raise FitError(
            "B-FIT-090",
            f"{len(field)} readings are too few for an ellipsoid, or they are all the same",
            next_step="read the magnetometer while the unit is turned about all axes",
        )
    unit = (field - middle) / scale
    columns = np.column_stack((2.0 * unit, np.ones(len(unit))))
    centre = np.linalg.lstsq(columns, np.square(unit).sum(axis=1), rcond=_FLAT)[0][:3]
    seen = unit - centre
    return np.asarray(seen / np.sqrt(np.square(seen).sum(axis=1).mean()))


def _weakness(sizes: Floats, vectors: Floats, columns: Floats) -> Floats:
    """Return how far quadrics that the readings hardly tell apart differ in each direction, (directions,).

    Of the quadrics that pass through the readings one is the surface itself; it is taken away as the part that is
    nearest to a sphere, because noise may mix it with the others.
    """
    enough = max(LEAST_SEPARATION * sizes[0], LEAST_ABOVE_NOISE * sizes[9])  # what has less is all the same
    sphere = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]) / 2.0
    loose = sizes < enough
    loose[9] = True
    surface = vectors[loose].T @ (vectors[loose] @ sphere)
    surface = surface / np.linalg.norm(surface)
    open_vectors = np.where(loose[:, None], vectors - np.outer(vectors @ surface, surface), vectors)
    return np.asarray(np.square(columns @ (open_vectors / np.maximum(sizes, enough)[:, None]).T).sum(axis=1))


def _directions() -> Floats:
    """Evenly spread unit vectors: a spiral, and the axes and diagonals that people give names to."""
    place = np.arange(_POINTS) + 0.5
    height, turn = 1.0 - 2.0 * place / _POINTS, np.pi * (1.0 + 5.0**0.5) * place
    flat = np.sqrt(1.0 - height**2)
    spiral = np.column_stack((flat * np.cos(turn), flat * np.sin(turn), height))
    named = np.array([(x, y, z) for x in (0, 1, -1) for y in (0, 1, -1) for z in (0, 1, -1)][1:], np.float64)
    return np.vstack((named / np.linalg.norm(named, axis=1)[:, None], spiral))


def _nearest_cosine(directions: Floats, unit: Floats) -> Floats:
    """Cosine of the angle from each direction to the nearest reading, in parts that fit the cache."""
    best = np.full(len(directions), -1.0)
    for part in np.array_split(unit, max(1, len(unit) // 4096)):
        best = np.maximum(best, (directions @ part.T).max(axis=1))
    return best
