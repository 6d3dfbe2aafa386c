"""Accelerometer triad from poses of known specific force.

Source: GNC module paper equation (2) and its least squares, with the column of ones that the print leaves out:
row j is [N_x N_y N_z 1], K_a the transpose of the first three rows of the 4 x 3 solution, bias the last one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bench.maths.least_squares import solve
from bench.systems.gnc.estimators.triad import TriadFit, improbable

Array = NDArray[np.float64]
_NAMES = ("the column of N_x", "the column of N_y", "the column of N_z", "the bias")


def fit_six_position(
    mean: Array,
    force: Array,
    covariance_of_means: Array | None = None,
    *,
    tilt_std_deg: float = 0.0,
    force_relative_std: float = 0.0,
) -> TriadFit:
    """Fit a = K N + bias to the mean outputs in n >= 4 poses.

    The fit itself is unweighted, as the paper's. Its covariance holds the noise of the means, three small independent
    angles per pose by which the unit is not where it should be, and a relative error of gravity common to all poses.
    Without ``covariance_of_means`` the noise is taken from the residuals, which then also hold the tilt. With it, a
    chi-square that is improbable (0.1 %) enlarges the covariance by its ratio to its degrees of freedom, which are then
    those of the fit: something was larger than declared.

    Args:    mean: (n, 3), indicated, any unit.   force: (n, 3), specific force at the pose, unit wanted (up = +g).
             covariance_of_means: (n, 3, 3), or (3n, 3n) pose by pose where they are not independent, indicated unit
             squared, or None.   tilt_std_deg: per axis and pose.   force_relative_std: of local gravity, relative.
    Returns: TriadFit; bias and residual in the unit of ``force``.
    Raises:  FitError B-FIT-001 if the poses do not determine all twelve, naming what is not.
    Source:  the equations named in the head of this file; covariance as in JCGM 102:2011 section 6.2.
    """
    poses = len(mean)
    design = np.column_stack([mean, np.ones(poses)])
    operator = solve(design, force[:, 0], np.eye(poses), _NAMES).operator
    solution = operator @ force
    residual = force - design @ solution
    matrix = solution[:3].T
    dof = 3 * poses - 12
    common = force_relative_std**2 * np.outer(force.ravel(), force.ravel())
    if covariance_of_means is None:
        variance = float(np.sum(residual**2)) / dof if dof else math.nan
        noise = np.eye(3 * poses) * variance
        chi2, behind, inflated = float(dof), float(max(dof, 1)), False
        if not dof:
            noise = np.full_like(noise, math.nan)
        systematic = np.zeros_like(noise)  # the residuals hold it already
    else:
        systematic = _tilt(force, tilt_std_deg)
        noise = _scaled(matrix, covariance_of_means)
        chi2 = _chi_square(residual, operator, design, noise + systematic)
        behind = float(dof) if (inflated := improbable(chi2, dof)) else math.inf  # then the residuals say how large
    rows = (noise + systematic) * (chi2 / dof if inflated else 1.0) + common
    return TriadFit(
        matrix=matrix,
        bias=solution[3],
        covariance=_parameters(operator, rows, poses),
        residual=residual,
        chi2=chi2,
        residual_dof=dof,
        dof=behind,
        condition=float(np.linalg.cond(design / np.linalg.norm(design, axis=0))),
        inflated=inflated,
    )


def _tilt(force: Array, tilt_std_deg: float) -> Array:
    """(3n, 3n): a small rotation vector phi turns f into f + phi x f, covariance sigma^2 (|f|^2 I - f f^T)."""
    sigma = math.radians(tilt_std_deg)
    square = np.sum(force**2, axis=1)[:, None, None] * np.eye(3)
    return spread_out(sigma**2 * (square - force[:, :, None] * force[:, None, :]))


def _scaled(matrix: Array, covariance: Array) -> Array:
    """Covariance (3n, 3n) of the means of all poses in the unit of the input."""
    if covariance.ndim == 3:
        return spread_out(matrix @ covariance @ matrix.T)
    scale = np.kron(np.eye(len(covariance) // 3), matrix)
    return np.asarray(scale @ covariance @ scale.T)


def spread_out(blocks: Array) -> Array:
    """Blocks (n, 3, 3) on the diagonal of a (3n, 3n) matrix. Source: none; poses are independent."""
    rows = np.zeros((3 * len(blocks), 3 * len(blocks)))
    for place, block in enumerate(blocks):
        rows[3 * place : 3 * place + 3, 3 * place : 3 * place + 3] = block
    return rows


def _chi_square(residual: Array, operator: Array, design: Array, rows: Array) -> float:
    """Of the residuals of an unweighted fit: their own covariance is singular, so by its pseudo-inverse."""
    left = np.kron(np.eye(len(residual)) - design @ operator, np.eye(3))
    vector = residual.ravel()
    rank = vector.size - 3 * operator.shape[0]
    values, vectors = np.linalg.eigh(left @ rows @ left.T)
    values, vectors = values[values.size - rank :], vectors[:, values.size - rank :]
    if rank == 0 or values[0] <= 0.0:
        return 0.0
    return float(np.sum((vectors.T @ vector) ** 2 / values))


def _parameters(operator: Array, rows: Array, poses: int) -> Array:
    """Covariance (12, 12) of K row by row and the bias, from that of the row equations, pose by pose x, y, z."""
    weights = np.zeros((12, 3 * poses))
    for sensor in range(3):
        weights[3 * sensor : 3 * sensor + 3, sensor::3] = operator[:3]
        weights[9 + sensor, sensor::3] = operator[3]
    return np.asarray(weights @ rows @ weights.T)
