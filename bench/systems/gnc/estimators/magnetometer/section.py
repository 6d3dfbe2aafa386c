"""Ellipse that an ellipsoid promises for a turn about one axis: its section by the plane of the readings.

The plane of the turn is that of the readings themselves, z = p + q x + r y, so neither the axis of the table nor the
mounting needs to be known.

Source: coordinate geometry of a quadric; covariance by first derivatives, JCGM 102:2011 section 6.2.

Is the surface an ellipse or ellipsoid at all? What its residuals say of its third and fourth order.

An axis that saturates or is not linear, a field that depends on the attitude (steel that turns with the unit, a
gradient) bend the surface in a way that no hard and soft iron does. The bend is fitted beside them, to first order.

Source: F test of further columns (Draper and Smith, Applied Regression Analysis, section 6.1); where noise wanders,
Student's t of each of them by blocks, union bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.tests import SMALLEST, f_tail, of_many, t_both
from bench.maths.verdict import coverage_factor
from bench.systems.gnc.estimators.magnetometer.ellipse import PlaneParameters, parameters_of
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric
from bench.systems.gnc.estimators.magnetometer.wander import uncertainty

_STEP = 1e-6
_TRIANGLE = np.triu_indices(3)
_ORDERS = (3, 4)
_APART = 0.03  # part of a column that the quadric and the others must leave of it


def section_of(quadric: Quadric, turn: Floats) -> PlaneParameters:
    """Return the parameters of axes x and y in the plane of a turn, with what ellipsoid and plane leave open.

    Args:    quadric: in space.   turn: (n, 3) readings, unit of the quadric.
    Returns: PlaneParameters; not a number where the plane does not cut the ellipsoid.
    Source:  see the head of this file.
    """
    design = np.column_stack((np.ones(len(turn)), turn[:, :2]))
    plane = np.linalg.lstsq(design, turn[:, 2], rcond=None)[0]
    of_plane = uncertainty(-design, turn[:, 2] - design @ plane)
    place = np.concatenate((quadric.centre, quadric.shape[_TRIANGLE], plane))
    size = float(quadric.shape[0, 0])
    steps = _STEP * np.concatenate((np.full(3, 1.0 / size), np.full(6, size), [1.0 / size, 1.0, 1.0]))
    slope = np.column_stack([(_section(place + step) - _section(place - step)) / (2.0 * step.sum())
                             for step in np.diag(steps)])  # fmt: skip
    values = _section(place)
    return PlaneParameters(
        offset=values[:2],
        gain=float(values[2]),
        alpha_deg=float(values[3]),
        radius=float(values[4]),
        covariance=slope[:, :9] @ quadric.covariance @ slope[:, :9].T
        + slope[:, 9:] @ of_plane.covariance @ slope[:, 9:].T,
        bias=np.zeros(5),
        dof=np.minimum(quadric.uncertainty.dof(slope[:, :9]), of_plane.dof(slope[:, 9:])),
    )


def _section(place: Floats) -> Floats:
    """(5,) offsets, gain, angle and radius from centre, shape and plane (12,)."""
    shape = np.zeros((3, 3))
    shape[_TRIANGLE] = place[3:9]
    origin = np.array([0.0, 0.0, place[9]]) - place[:3]
    along = shape @ np.array([[1.0, 0.0], [0.0, 1.0], [place[10], place[11]]])
    middle = -np.linalg.lstsq(along, shape @ origin, rcond=None)[0]
    left = 1.0 - float(np.sum((along @ middle + shape @ origin) ** 2))
    if left <= 0.0:
        return np.full(5, np.nan)
    upper = np.linalg.cholesky(along.T @ along / left).T
    return parameters_of(np.concatenate((middle, upper[np.triu_indices(2)])))


@dataclass(frozen=True)
class Misshape:
    """``probability``: of so much bend by noise alone.   ``size``: its root mean square, unit of the readings.
    ``move``: largest change of a parameter of the quadric by it, in its expanded uncertainty.
    """

    probability: float
    size: float
    move: float


def misshape(quadric: Quadric, points: Floats, begins: Sequence[int] = ()) -> Misshape:
    """Return how much the readings bend the surface that was fitted to them.

    Args:    points: (n, d), those of the fit.   begins: first point of each record, if there are several.
    Returns: Misshape.
    Source:  see the head of this file.
    """
    count, size = quadric.jacobian.shape
    basis, triangle = np.linalg.qr(quadric.jacobian)
    bends = _bends(quadric.corrected(points))
    inside = basis.T @ bends
    bends -= basis @ inside
    information, vectors = np.linalg.eigh(bends.T @ bends)
    kept = information > _APART**2 * count
    rank = int(kept.sum())
    if count <= size + rank + 1 or not rank or quadric.noise == 0.0:
        return Misshape(1.0, 0.0, 0.0)
    weights = vectors[:, kept] / np.sqrt(information[kept])
    left = bends @ weights
    seen = left.T @ quadric.distance
    rest = quadric.distance - left @ seen
    shift = np.linalg.solve(triangle, inside @ (weights @ seen))
    expanded = coverage_factor() * np.sqrt(np.diag(quadric.covariance))
    bent = uncertainty(np.column_stack((basis, left)), rest, begins)
    if bent.chosen is None:
        ratio = float(seen @ seen) / rank / bent.noise**2
        probability = f_tail(ratio, rank, count - size - rank)
    else:
        slope = np.eye(size + rank)[size:]
        score = np.abs(seen) / np.sqrt(np.maximum(np.diag(bent.covariance)[size:], SMALLEST))
        probability = of_many(float(t_both(score, bent.dof(slope)).min()), rank)
    return Misshape(probability, float(np.sqrt(seen @ seen / count)), float(np.abs(shift / expanded).max()))


def _bends(directions: Floats) -> Floats:
    """Monomials of third and fourth order of unit vectors, (n, columns)."""
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    return np.column_stack([
        np.prod(unit[:, list(each)], axis=1)
        for order in _ORDERS
        for each in combinations_with_replacement(range(unit.shape[1]), order)
    ])  # fmt: skip
