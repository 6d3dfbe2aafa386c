"""Linear least squares with a full covariance matrix and a rank test that says what is not determined.

Source: Golub and Van Loan, Matrix Computations, sections 5.3 (QR), 5.5 (rank) and 6.1 (generalised least squares).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError

Array = NDArray[np.float64]
_RANK_TOLERANCE = 1e-9  # smallest singular value of the scaled design, relative to the largest


@dataclass(frozen=True)
class LinearFit:
    """Result of a linear fit ``y = X b + noise``; units follow ``y`` and the columns of ``X``.

    ``operator`` (p, m) maps readings to parameters, so any noise covariance W of the readings gives the parameter
    covariance ``operator @ W @ operator.T``, whatever weights were used.
    """

    parameters: Array  # (p,)
    covariance: Array  # (p, p)
    operator: Array  # (p, m)
    residual: Array  # (m,) y - X b
    chi2: float
    dof: int


def solve(design: Array, readings: Array, covariance: Array, names: Sequence[str]) -> LinearFit:
    """Generalised least squares: whiten by the Cholesky factor, scale the columns, decompose, test the rank.

    Args:    design: (m, p).   readings: (m,).   covariance: (m, m) of the readings, positive definite.
             names: p parameter names for the messages.
    Returns: LinearFit with the parameters in the caller's units.
    Raises:  FitError B-FIT-001 if the rows do not determine all parameters, naming those; B-FIT-002 if the
             covariance is not positive definite.
    Source:  Golub and Van Loan, Matrix Computations, section 6.1.
    """
    factor = _cholesky(covariance)
    white_design = np.asarray(np.linalg.solve(factor, design), dtype=np.float64)
    white_readings = np.linalg.solve(factor, readings)
    pseudo_inverse, parameter_covariance = _decompose(white_design, names)
    parameters = pseudo_inverse @ white_readings
    operator = np.asarray(np.linalg.solve(factor.T, pseudo_inverse.T).T, dtype=np.float64)
    white_residual = white_readings - white_design @ parameters
    rows, columns = design.shape
    return LinearFit(
        parameters=parameters,
        covariance=parameter_covariance,
        operator=operator,
        residual=readings - design @ parameters,
        chi2=float(white_residual @ white_residual),
        dof=rows - columns,
    )


def _cholesky(covariance: Array) -> Array:
    """Lower factor; numpy's own solvers, because scipy's triangular one wakes every core for 14 rows."""
    try:
        factor = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        factor = np.full_like(covariance, np.nan)
    if not np.isfinite(factor).all():
        raise FitError(
            "B-FIT-002",
            "the covariance of the readings is not positive definite",
            next_step="check the uncertainties in the standards register and the converter noise of the campaign",
        )
    return np.asarray(factor)


def _decompose(design: Array, names: Sequence[str]) -> tuple[Array, Array]:
    """Pseudo-inverse (p, m) and (X'X)^-1 (p, p) of a full-rank design; refuses any other."""
    rows, columns = design.shape
    scale = np.linalg.norm(design, axis=0)
    scale[scale == 0] = 1.0
    left, singular, right = np.linalg.svd(design / scale, full_matrices=rows < columns)
    padded = np.zeros(columns)
    padded[: singular.size] = singular
    null = padded <= _RANK_TOLERANCE * padded.max(initial=0.0)
    if null.any():
        weight = np.abs(right[null]).max(axis=0)
        loose = [name for name, part in zip(names, weight, strict=True) if part > 1e-6]
        raise FitError(
            "B-FIT-001",
            f"{rows} rows do not determine {', '.join(loose)}: rank {columns - int(null.sum())} of {columns}",
            next_step="add rows that separate these parameters, or ask for fewer parameters",
        )
    inverse = (right.T / singular) / scale[:, None]
    return inverse @ left.T, inverse @ inverse.T
