"""Accelerometer triad from many poses of unknown direction: at rest the specific force has the length of gravity.

Nine parameters: a = U (N - zero), U upper triangular (three scales on its diagonal, three misalignments), three zeros.
Lengths alone leave the frame open; the triangle chooses that of the public method: z along the sensitive axis of the
third sensor, the second one in the plane of y and z. The lower triangle is another frame of the same solution.

Source: Tedaldi, Pretto and Menegatti, ICRA 2014, sections II (frame) and III (cost function).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats, rms
from bench.model.errors import FitError

_ROWS, _COLUMNS = np.triu_indices(3)
_AMPLIFICATION_LIMIT = 30.0  # the recording published with the method has 3, two thirds of its poses up to 17
_LEAST = 10
_LARGEST = 0.05  # of gravity: beyond it the poses are none, or the search has ended elsewhere


@dataclass(frozen=True)
class NormFit:
    """``matrix`` (3, 3) upper triangular, true input per indicated unit.   ``zero`` (3,) indicated output at no input.
    ``covariance`` (9, 9): U_xx, U_xy, U_xz, U_yy, U_yz, U_zz, zero x, y, z.   ``residual`` (n,): length minus gravity.
    ``dof``: n - 9.   ``amplification``: largest ratio, over all directions, of the uncertainty of the length there to
    the scatter of one pose.
    """

    matrix: Floats
    zero: Floats
    covariance: Floats
    residual: Floats
    dof: int
    amplification: float
    gravity: float

    @property
    def residual_rms(self) -> float:
        """Root mean square of the residuals, unit of gravity."""
        return rms(self.residual)

    @property
    def counts_per_unit(self) -> Floats:
        """(3,) indicated unit per unit of gravity: 1 / U_ii."""
        return 1.0 / self.matrix.diagonal()

    @property
    def counts_per_unit_std(self) -> Floats:
        """(3,) standard uncertainty of ``counts_per_unit``."""
        return np.sqrt(self.covariance.diagonal()[[0, 3, 5]]) * self.counts_per_unit**2

    @property
    def zero_std(self) -> Floats:
        """(3,) standard uncertainty of ``zero``, indicated unit."""
        return np.sqrt(self.covariance.diagonal()[6:])

    def apply(self, indicated: Floats) -> Floats:
        """(n, 3) calibrated specific force, unit of gravity."""
        return (indicated - self.zero) @ self.matrix.T

    def jacobian(self, indicated: Floats) -> Floats:
        """(n, 9) change of the length of the calibrated force with each parameter of ``covariance``."""
        parameters = np.concatenate([self.matrix[_ROWS, _COLUMNS], self.zero])
        return _jacobian(parameters, indicated)


def fit_multi_position(mean: Floats, gravity: float) -> NormFit:
    """Fit scale, misalignment and zero to n >= 10 poses by Levenberg and Marquardt's method.

    The poses must determine the length in every direction: the uncertainty that the fit would have somewhere on the
    sphere may not be more than thirty times the scatter of one pose.

    Args:    mean: (n, 3) mean output of each interval at rest, indicated unit.   gravity: its length, > 0.
    Returns: NormFit; its covariance comes from the residuals (n - 9 degrees of freedom).
    Raises:  FitError B-FIT-085 if there are fewer than 10 poses or they are not spread enough, naming the direction
             that is not seen; B-FIT-086 if the lengths scatter by more than 5 %.
    Source:  Tedaldi et al. 2014, equation (10).
    """
    from scipy import optimize

    if len(mean) < _LEAST:
        raise FitError("B-FIT-085", f"{len(mean)} poses, {_LEAST} are needed for nine parameters", next_step=_POSES)
    zero, half = _start(mean)
    scaled = (mean - zero) / half  # lengths near one: the search sees numbers of one size
    begin = np.concatenate([np.eye(3)[_ROWS, _COLUMNS], np.zeros(3)])
    solution = optimize.least_squares(
        _residual, begin, jac=_jacobian, args=(scaled,), method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    amplification, direction = _worst_direction(solution.x, scaled)
    if not amplification < _AMPLIFICATION_LIMIT:
        raise FitError(
            "B-FIT-085",
            f"{len(mean)} poses do not determine the length along ({', '.join(f'{part:+.2f}' for part in direction)}):"
            f" uncertain by {amplification:.3g} times the scatter of one pose, limit {_AMPLIFICATION_LIMIT:g}",
            next_step=_POSES,
        )
    left = rms(solution.fun)
    if not left < _LARGEST:
        raise FitError(
            "B-FIT-086",
            f"the lengths of {len(mean)} poses scatter by {100 * left:.3g} %, limit {100 * _LARGEST:g} %",
            next_step="check that the unit was at rest in each pose and which columns are the accelerometers",
        )
    return _in_units(solution.x, scaled, zero, half, gravity, amplification)


_POSES = "hold the unit at rest in more poses, with each axis up, down and in between"


def _start(mean: Floats) -> tuple[Floats, float]:
    """Centre of the poses and the size of the sphere: a sphere fitted linearly."""
    middle = mean.mean(axis=0)
    around = mean - middle
    size = rms(around) or 1.0
    rows = np.column_stack([2.0 * around / size, np.ones(len(mean))])
    solution, *_ = np.linalg.lstsq(rows, np.sum((around / size) ** 2, axis=1), rcond=1e-8)
    radius2 = float(solution[3] + solution[:3] @ solution[:3])
    return middle + size * solution[:3], size * math.sqrt(max(radius2, 1e-6))


def _matrix(parameters: Floats) -> Floats:
    matrix = np.zeros((3, 3))
    matrix[_ROWS, _COLUMNS] = parameters[:6]
    return matrix


def _residual(parameters: Floats, scaled: Floats) -> Floats:
    return np.asarray(np.linalg.norm((scaled - parameters[6:]) @ _matrix(parameters).T, axis=1) - 1.0)


def _jacobian(parameters: Floats, scaled: Floats) -> Floats:
    """d|a| = a/|a| . (dU (N - zero) - U dzero)."""
    around, matrix = scaled - parameters[6:], _matrix(parameters)
    true = around @ matrix.T
    unit = true / np.linalg.norm(true, axis=1)[:, None]
    return np.column_stack([unit[:, _ROWS] * around[:, _COLUMNS], -unit @ matrix])


def _worst_direction(parameters: Floats, scaled: Floats) -> tuple[float, Floats]:
    """Largest uncertainty of the length over directions, per unit scatter of one pose, and that direction (output)."""
    information = _jacobian(parameters, scaled)
    _, singular, right = np.linalg.svd(information, full_matrices=False)
    root = right.T / np.maximum(singular, 1e-12 * singular[0])
    sphere = _directions(2000)
    matrix = _matrix(parameters)
    with np.errstate(all="ignore"):
        seen = _jacobian(parameters, sphere @ np.linalg.pinv(matrix).T + parameters[6:]) @ root
    size = np.linalg.norm(seen, axis=1)
    place = int(np.argmax(size))
    return float(size[place]), sphere[place]


def _directions(count: int) -> Floats:
    """Return points spread evenly over the sphere along a spiral (golden angle)."""
    place = np.arange(count) + 0.5
    height = 1.0 - 2.0 * place / count
    turn = math.pi * (3.0 - math.sqrt(5.0)) * place
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])


def _in_units(x: Floats, scaled: Floats, zero: Floats, half: float, gravity: float, amplification: float) -> NormFit:
    residual, jacobian = _residual(x, scaled), _jacobian(x, scaled)
    dof = len(scaled) - 9
    root = np.linalg.pinv(jacobian)
    units = np.concatenate([np.full(6, gravity / half), np.full(3, half)])
    covariance = (root @ root.T) * float(residual @ residual) / dof * np.outer(units, units)
    return NormFit(
        matrix=_matrix(x) * gravity / half,
        zero=zero + half * x[6:],
        covariance=covariance,
        residual=residual * gravity,
        dof=dof,
        amplification=amplification,
        gravity=gravity,
    )
