"""A calibrated triad of sensors: matrix, bias, their covariance, and what follows from them.

Sensor form ``N = S (input + ...)``, inverse form ``input = K N + ...``, K = S^-1. S is output per input, so its
diagonal minus one is the scale-factor error and its rest the cross coupling (row sensor, column axis), where N is in
the unit of the input.

Source: GNC module paper equations (1), (2); covariances by JCGM 102:2011 section 6.2.

Accelerometer triad from poses of known specific force.

Source: GNC module paper equation (2) and its least squares, with the column of ones that the print leaves out:
row j is [N_x N_y N_z 1], K_a the transpose of the first three rows of the 4 x 3 solution, bias the last one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.least_squares import solve
from bench.maths.tests import chi2_tail

AXES = ("x", "y", "z")
_IMPROBABLE = 1e-3
_STEP = 1e-3  # of a standard uncertainty: the functions are nearly linear over that, and doubles resolve it
_NAMES = ("the column of N_x", "the column of N_y", "the column of N_z", "the bias")


@dataclass(frozen=True)
class TriadRows:
    """Mean outputs that a fit is made of, (n, 3) each.

    ``output``: as indicated; ``input``: that is due; ``force``: specific force meanwhile, g.   ``covariance``
    (3n, 3n): of the output through K, without the wandering of a bias that nobody declares.   ``operator`` (12, 3n):
    what K, row by row, and bias gain per unit of it.   ``dof``: degrees of freedom of the noise.
    """

    output: Floats
    input: Floats
    force: Floats
    covariance: Floats
    operator: Floats
    dof: float


@dataclass(frozen=True)
class TriadFit:
    """Fit of a triad. Accelerometer: a = K N + bias; gyroscope: w = K N - bias, so N = S (w + bias).

    ``covariance`` is that of the nine elements of K, row by row, and then the three of the bias. ``dof`` are the
    degrees of freedom behind it (infinite where the noise was known). ``chi2`` is the weighted sum of squares of
    ``residual_dof`` independent residuals. ``inflated`` says that the residuals are larger than what was declared can
    explain and that the covariance was enlarged for it. ``rows``: of a calibration by positions or by turns.
    """

    matrix: Floats  # (3, 3) K, true input per indicated unit
    bias: Floats  # (3,) unit of the input
    covariance: Floats  # (12, 12)
    residual: Floats  # (n, 3) unit of the input
    chi2: float
    residual_dof: int
    dof: float
    inflated: bool = False
    rows: TriadRows | None = None

    @cached_property
    def sensitivity(self) -> Floats:
        """S = K^-1, (3, 3), indicated unit per input unit."""
        return np.asarray(np.linalg.inv(self.matrix))

    @property
    def by_matrix(self) -> Floats:
        """(9, 9) derivatives of S by K, both row by row: dS = -S dK S. Source: JCGM 102:2011 section 6."""
        return np.asarray(-np.kron(self.sensitivity, self.sensitivity.T))

    @cached_property
    def sensitivity_covariance(self) -> Floats:
        """(9, 9) of S, row by row."""
        return self.by_matrix @ self.covariance[:9, :9] @ self.by_matrix.T

    @property
    def matrix_std(self) -> Floats:
        """Standard uncertainty of K, (3, 3)."""
        return np.sqrt(self.covariance.diagonal()[:9]).reshape(3, 3)

    @property
    def bias_std(self) -> Floats:
        """Standard uncertainty of the bias, (3,), unit of the input."""
        return np.sqrt(self.covariance.diagonal()[9:])

    @property
    def sensitivity_std(self) -> Floats:
        """Standard uncertainty of S, (3, 3)."""
        return np.sqrt(self.sensitivity_covariance.diagonal()).reshape(3, 3)

    @property
    def scale_error_ppm(self) -> Floats:
        """(3,) 1e6 (S_ii - 1): positive = more output per input."""
        return 1e6 * (self.sensitivity.diagonal() - 1.0)

    @property
    def scale_error_std_ppm(self) -> Floats:
        """Standard uncertainty of the scale-factor errors, (3,), ppm."""
        return 1e6 * self.sensitivity_std.diagonal()

    @property
    def cross_coupling(self) -> Floats:
        """(3, 3) S with a zero diagonal: row sensor, column axis of the input."""
        return self.sensitivity - np.diag(self.sensitivity.diagonal())

    @property
    def cross_coupling_std(self) -> Floats:
        """Standard uncertainty of the cross coupling, (3, 3), zero on the diagonal."""
        return self.sensitivity_std - np.diag(self.sensitivity_std.diagonal())

    def apply(self, indicated: Floats, *, bias_sign: int) -> Floats:
        """K N + bias_sign * bias for (n, 3) indicated values; +1 for an accelerometer, -1 for a gyroscope."""
        return indicated @ self.matrix.T + bias_sign * self.bias


def improbable(chi2: float, dof: int, below: float = _IMPROBABLE) -> bool:
    """Return whether a chi-square is less probable than 0.1 %, or ``below``: then something was larger than declared.

    Source: JCGM 100:2008 annex G.
    """

    return dof > 0 and chi2_tail(chi2, dof) < below


def derivatives(function: Callable[[Floats], Floats], at: Floats, std: Floats) -> Floats:
    """Return derivatives of a function by each of its inputs, by central differences.

    Args:    function: (k,) -> (p,).   at: (k,), where.   std: (k,), of the inputs; one of none is left out.
    Returns: (p, k), zero for what is left out.
    Raises:  nothing of its own.
    Source:  JCGM 102:2011 section 6.2.
    """
    jacobian = np.zeros((function(at).size, at.size))
    for place in np.flatnonzero(std > 0):
        step = np.zeros(at.size)
        step[place] = std[place] * _STEP
        jacobian[:, place] = (function(at + step) - function(at - step)) / (2.0 * step[place])
    return jacobian


def propagate_inputs(function: Callable[[Floats], Floats], at: Floats, covariance: Floats) -> Floats:
    """Return covariance (p, p) of ``function`` of inputs of a covariance (k, k). Args, Source: as ``derivatives``."""
    jacobian = derivatives(function, at, np.sqrt(covariance.diagonal()))
    return jacobian @ covariance @ jacobian.T


def fit_six_position(
    mean: Floats, force: Floats, covariance_of_means: Floats | None = None, *, tilt_std_deg: float = 0.0
) -> TriadFit:
    """Fit a = K N + bias to the mean outputs in n >= 4 poses.

    The fit itself is unweighted, as the paper's. Its covariance holds the noise of the means and three small
    independent angles per pose by which the unit is not where it should be.
    Without ``covariance_of_means`` the noise is taken from the residuals, which then also hold the tilt. With it, a
    chi-square that is improbable (0.1 %) enlarges the covariance by its ratio to its degrees of freedom, which are then
    those of the fit: something was larger than declared.

    Args:    mean: (n, 3), indicated, any unit.   force: (n, 3), specific force at the pose, unit wanted (up = +g).
             covariance_of_means: (n, 3, 3), or (3n, 3n) pose by pose where they are not independent, indicated unit
             squared, or None.   tilt_std_deg: per axis and pose.
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
    rows = (noise + systematic) * (chi2 / dof if inflated else 1.0)
    return TriadFit(
        matrix=matrix,
        bias=solution[3],
        covariance=_parameters(operator, rows, poses),
        residual=residual,
        chi2=chi2,
        residual_dof=dof,
        dof=behind,
        inflated=inflated,
    )


def rows_of_positions(
    fit: TriadFit, mean: Floats, force: Floats, covariance_of_means: Floats, tilt_std_deg: float, dof: float
) -> TriadRows:
    """Return the rows of a fit. Args: as ``fit_six_position``; ``dof``: of the covariance. Source: its equations."""
    operator = np.linalg.pinv(np.column_stack([mean, np.ones(len(mean))]))
    noise = _scaled(fit.matrix, covariance_of_means) + _tilt(force, tilt_std_deg)
    return TriadRows(mean, force, force, noise, -_weights(operator, len(mean)), dof)


def _tilt(force: Floats, tilt_std_deg: float) -> Floats:
    """(3n, 3n): a small rotation vector phi turns f into f + phi x f, covariance sigma^2 (|f|^2 I - f f^T)."""
    sigma = math.radians(tilt_std_deg)
    square = np.sum(force**2, axis=1)[:, None, None] * np.eye(3)
    return spread_out(sigma**2 * (square - force[:, :, None] * force[:, None, :]))


def _scaled(matrix: Floats, covariance: Floats) -> Floats:
    """Covariance (3n, 3n) of the means of all poses in the unit of the input."""
    if covariance.ndim == 3:
        return spread_out(matrix @ covariance @ matrix.T)
    scale = np.kron(np.eye(len(covariance) // 3), matrix)
    return scale @ covariance @ scale.T


def spread_out(blocks: Floats) -> Floats:
    """Blocks (n, 3, 3) on the diagonal of a (3n, 3n) matrix. Source: none; poses are independent."""
    rows = np.zeros((3 * len(blocks), 3 * len(blocks)))
    for place, block in enumerate(blocks):
        rows[3 * place : 3 * place + 3, 3 * place : 3 * place + 3] = block
    return rows


def _chi_square(residual: Floats, operator: Floats, design: Floats, rows: Floats) -> float:
    """Of the residuals of an unweighted fit: their own covariance is singular, so by its pseudo-inverse."""
    left = np.kron(np.eye(len(residual)) - design @ operator, np.eye(3))
    vector = residual.ravel()
    rank = vector.size - 3 * operator.shape[0]
    values, vectors = np.linalg.eigh(left @ rows @ left.T)
    values, vectors = values[values.size - rank :], vectors[:, values.size - rank :]
    if rank == 0 or values[0] <= 0.0:
        return 0.0
    return float(np.sum((vectors.T @ vector) ** 2 / values))


def _parameters(operator: Floats, rows: Floats, poses: int) -> Floats:
    """Covariance (12, 12) of K row by row and the bias, from that of the row equations, pose by pose x, y, z."""
    weights = _weights(operator, poses)
    return weights @ rows @ weights.T


def _weights(operator: Floats, poses: int) -> Floats:
    """Derivatives (12, 3n) of K row by row and the bias by the forces, pose by pose x, y, z."""
    weights = np.zeros((12, 3 * poses))
    for sensor in range(3):
        weights[3 * sensor : 3 * sensor + 3, sensor::3] = operator[:3]
        weights[9 + sensor, sensor::3] = operator[3]
    return weights
