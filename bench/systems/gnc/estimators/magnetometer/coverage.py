"""Do readings of a three-axis magnetometer determine an ellipsoid? Asked before it is fitted.

A turn about one axis leaves a circle, two circles leave the product of two components, a small cap leaves most: through
all of these pass many ellipsoids, and a fit would pick one by the noise. So the readings, seen from the middle of the
sphere through them, must separate all nine coefficients of the quadric by themselves; what noise separates counts for
nothing.

Source: Gander, Golub and Strebel, BIT 34 (1994) 558 (coefficients as smallest singular vector); Golub and Van Loan,
Matrix Computations, section 5.5 (numerical rank).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError

Array = NDArray[np.float64]
LEAST_SEPARATION = 0.02  # second smallest singular value over the largest; an even sphere 0.21, half a sphere 0.04
LEAST_ABOVE_NOISE = 5.0  # second smallest over smallest
LARGEST_HOLE_deg = 60.0  # radius of the empty cap; three great circles leave 55
_FLAT = 0.02  # thinner than this part of its width, readings lie in a plane
_POINTS = 642  # directions in which a sphere is searched, 8 degrees apart


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
    weakest: Array
    hole_deg: float
    hole: Array

    @property
    def complete(self) -> bool:
        """No empty cap wider than the limit: the result holds in every direction without extrapolation."""
        return self.hole_deg <= LARGEST_HOLE_deg

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a reader must know of a coverage that determines the ellipsoid but is not complete."""
        if self.complete:
            return ()
        return (
            f"no reading within {self.hole_deg:.0f} degrees of {direction_name(self.hole)} "
            f"(limit {LARGEST_HOLE_deg:.0f}): the correction is extrapolated there",
        )


def sphere_coverage(field: Array) -> SphereCoverage:
    """Coverage of the sphere by readings of three axes.

    Args:    field: (n, 3), any unit, n > 9.
    Returns: SphereCoverage.
    Raises:  FitError B-FIT-090 for fewer than ten readings or readings that are all the same.
    Source:  see the head of this file.
    """
    seen = _from_the_middle(field)
    columns = _monomials(seen) / np.sqrt(len(seen))
    sizes, vectors = np.linalg.svd(np.linalg.qr(columns, mode="r"))[1:]
    grid = _directions()
    weakness = _weakness(sizes, vectors, _monomials(grid))
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


def require_coverage(coverage: SphereCoverage) -> None:
    """Refuse readings that do not determine the ellipsoid.

    Raises:  FitError B-FIT-091, naming the direction along which they say least.
    """
    if coverage.determined:
        return
    raise FitError(
        "B-FIT-091",
        f"the readings do not determine an ellipsoid: they say too little about the direction "
        f"{direction_name(coverage.weakest)} (separation {coverage.separation:.2g}, limit {LEAST_SEPARATION:g}; "
        f"{coverage.above_noise:.1f} times the noise, limit {LEAST_ABOVE_NOISE:g})",
        next_step="turn the unit about further axes so that each of its axes points along and against the field, or "
        "evaluate a turn about one axis as an ellipse",
    )


def direction_name(direction: Array) -> str:
    """Unit vector with the sensor axis that is nearest: "(0.00, 0.00, 1.00), nearest +z"."""
    axis = int(np.argmax(np.abs(direction)))
    numbers = ", ".join(f"{0.0 + round(float(part), 2):.2f}" for part in direction)
    return f"({numbers}), nearest {'+' if direction[axis] > 0 else '-'}{'xyz'[axis]}"


def _from_the_middle(field: Array) -> Array:
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


def _weakness(sizes: Array, vectors: Array, columns: Array) -> Array:
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


def _monomials(points: Array) -> Array:
    """Squares, products, components and one, (n, 10)."""
    rows, columns = np.triu_indices(3)
    return np.column_stack((points[:, rows] * points[:, columns], points, np.ones(len(points))))


def _directions() -> Array:
    """Evenly spread unit vectors: a spiral, and the axes and diagonals that people give names to."""
    place = np.arange(_POINTS) + 0.5
    height, turn = 1.0 - 2.0 * place / _POINTS, np.pi * (1.0 + 5.0**0.5) * place
    flat = np.sqrt(1.0 - height**2)
    spiral = np.column_stack((flat * np.cos(turn), flat * np.sin(turn), height))
    named = np.array([(x, y, z) for x in (0, 1, -1) for y in (0, 1, -1) for z in (0, 1, -1)][1:], np.float64)
    return np.vstack((named / np.linalg.norm(named, axis=1)[:, None], spiral))


def _nearest_cosine(directions: Array, unit: Array) -> Array:
    """Cosine of the angle from each direction to the nearest reading, in parts that fit the cache."""
    best = np.full(len(directions), -1.0)
    for part in np.array_split(unit, max(1, len(unit) // 4096)):
        best = np.maximum(best, (directions @ part.T).max(axis=1))
    return best
