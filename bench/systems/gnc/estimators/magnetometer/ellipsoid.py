"""Hard and soft iron of a three-axis magnetometer: an ellipsoid by orthogonal distance, refused where undetermined.

Model: ``v_out = hard_iron + W^-1 u`` with |u| = norm. Readings alone leave the orientation of u open: the symmetric
root turns the axes least, the triangular one keeps axis z (and the plane y, z) where the sensor has it. Which of both
is right the field cannot tell; both correct the size of the field equally.

Source: Gander, Golub and Strebel, BIT 34 (1994) 558; Renaudin, Afzal and Lachapelle, J. Sensors 2010, 967245 (model of
hard and soft iron); coverage: ``bench.systems.gnc.estimators.magnetometer.coverage``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError
from bench.systems.gnc.estimators.magnetometer.coverage import (
    SphereCoverage,
    direction_name,
    require_coverage,
    sphere_coverage,
)
from bench.systems.gnc.estimators.magnetometer.quadric import Quadric, fit_quadric

Array = NDArray[np.float64]
LARGEST_STD = 0.01  # standard uncertainty of the size of the corrected field in the worst direction, relative
_STEP = 1e-6
_TRIANGLE = np.triu_indices(3)


@dataclass(frozen=True)
class EllipsoidFit:
    """Correction ``u = soft_iron @ (v_out - hard_iron)``.

    Attributes:
        hard_iron: (3,), unit of the readings.   hard_iron_covariance: (3, 3).
        symmetric, triangular: (3, 3) soft iron, two roots of the same ellipsoid; triangular is upper triangular.
        symmetric_std, triangular_std: (3, 3) standard uncertainties of their elements.
        norm: size of u, unit of the readings: as given, or the mean radius for which the correction keeps volumes.
        noise: standard deviation of the orthogonal distances.   worst_std: see ``LARGEST_STD``.   wander: see
        ``estimators.magnetometer.quadric.Quadric``.   coverage: of the sphere; its sentences belong into a report.
    """

    hard_iron: Array
    hard_iron_covariance: Array
    symmetric: Array
    symmetric_std: Array
    triangular: Array
    triangular_std: Array
    norm: float
    noise: float
    worst_std: float
    wander: float
    coverage: SphereCoverage

    def corrected(self, field: Array, *, triangular: bool = False) -> Array:
        """Return readings (n, 3) without hard and soft iron, unit of ``norm``."""
        return np.asarray((field - self.hard_iron) @ (self.triangular if triangular else self.symmetric).T)


def fit_ellipsoid(field: Array, norm: float | None = None) -> EllipsoidFit:
    """Hard iron, soft iron and their uncertainty from readings in many directions.

    Args:    field: (n, 3), same unit and like noise on all axes, gaps left out.   norm: size of the field if it is
             known; without it only ratios of sensitivities are determined, and the correction keeps volumes.
    Returns: EllipsoidFit.
    Raises:  FitError B-FIT-090 for too few readings or no closed surface; B-FIT-091 if the readings do not determine
             the ellipsoid or leave its size in some direction uncertain by more than 1 %, naming the direction.
    Source:  see the head of this file; covariance by first derivatives, JCGM 102:2011 section 6.2.
    """
    field = np.asarray(field, np.float64)
    coverage = sphere_coverage(field)
    require_coverage(coverage)
    quadric = fit_quadric(field)
    worst_std = _worst_std(quadric)
    roots = np.concatenate([root.ravel() for root in _roots(quadric.shape, norm)])
    slope = _derivative(quadric.shape, norm)
    std = np.sqrt(np.einsum("rp,pq,rq->r", slope, quadric.covariance[3:, 3:], slope))
    return EllipsoidFit(
        hard_iron=quadric.centre,
        hard_iron_covariance=quadric.covariance[:3, :3],
        symmetric=roots[:9].reshape(3, 3),
        symmetric_std=std[:9].reshape(3, 3),
        triangular=roots[9:].reshape(3, 3),
        triangular_std=std[9:].reshape(3, 3),
        norm=_norm(quadric.shape, norm),
        noise=quadric.noise,
        worst_std=worst_std,
        wander=quadric.wander,
        coverage=coverage,
    )


def _norm(shape: Array, norm: float | None) -> float:
    return float(np.prod(np.diag(shape)) ** (-1.0 / 3.0)) if norm is None else norm


def _roots(shape: Array, norm: float | None) -> tuple[Array, Array]:
    """Symmetric and triangular soft iron of the surface |shape v| = 1."""
    triangular = shape * _norm(shape, norm)
    values, vectors = np.linalg.eigh(triangular.T @ triangular)
    return (vectors * np.sqrt(values)) @ vectors.T, triangular


def _derivative(shape: Array, norm: float | None) -> Array:
    """(18, 6) derivatives of both roots with respect to the upper triangle, by central differences."""
    step = _STEP * shape[0, 0]
    columns = []
    for row, column in zip(*_TRIANGLE, strict=True):
        change = np.zeros((3, 3))
        change[row, column] = step
        above, below = _roots(shape + change, norm), _roots(shape - change, norm)
        columns.append(np.concatenate([(a - b).ravel() for a, b in zip(above, below, strict=True)]) / (2.0 * step))
    return np.column_stack(columns)


def _worst_std(quadric: Quadric) -> float:
    """Relative standard uncertainty of the corrected field's size, largest over all directions.

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
        name = direction_name(reading[worst] / np.linalg.norm(reading[worst]))
        raise FitError(
            "B-FIT-091",
            f"the readings do not determine an ellipsoid: along {name} its "
            f"size is uncertain by {100 * std:.2g} % (limit {100 * LARGEST_STD:g} %)",
            next_step="turn the unit so that this direction lies along and against the field, and read longer",
        )
    return std
