"""Linear least squares with a full covariance matrix and a rank test that says what is not determined.

The columns are scaled and decomposed orthogonally. A well-conditioned problem is solved in doubles, by singular
values. Beyond a condition number of 1,000 (columns of unit norm, whitened) doubles would lose more than the six digits
that leave nine, so the same problem is factorised in twice the precision.

Source: Golub and Van Loan, Matrix Computations, sections 5.3 (QR), 5.5 (rank) and 6.1 (generalised least squares);
Björck, Numerical Methods for Least Squares Problems, section 1.4 (the square of the condition number in the error).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.extended import Extended, ExtendedFit, Undetermined, solve_extended, stacked
from bench.model.errors import FitError

_RANK_TOLERANCE = 1e-9  # smallest singular value of the scaled design, relative to the largest
_EXACT_RANK_TOLERANCE = 1e-20  # the same for columns that are known to twice the precision
_CONDITION_LIMIT = 1e3  # of the scaled, whitened design: the error of doubles goes with its square


@dataclass(frozen=True)
class LinearFit:
    """Result of a linear fit ``y = X b + noise``; units follow ``y`` and the columns of ``X``.

    ``operator`` (p, m) maps readings to parameters, so any noise covariance W of the readings gives the parameter
    covariance ``operator @ W @ operator.T``, whatever weights were used.
    """

    parameters: Floats  # (p,)
    covariance: Floats  # (p, p)
    operator: Floats  # (p, m)
    residual: Floats  # (m,) y - X b
    chi2: float
    dof: int


def solve(design: Floats | Extended, readings: Floats, covariance: Floats, names: Sequence[str]) -> LinearFit:
    """Generalised least squares: whiten by the Cholesky factor, scale the columns, decompose, test the rank.

    Args:    design: (m, p), taken as exact. High powers should come from ``bench.maths.extended.polynomial_columns``:
             where columns are nearly dependent, powers rounded to doubles are already another problem.
             readings: (m,).   covariance: (m, m) of the readings, positive definite.
             names: p parameter names for the messages.
    Returns: LinearFit with the parameters in the caller's units.
    Raises:  FitError B-FIT-001 if the rows do not determine all parameters, naming those; B-FIT-002 if the
             covariance is not positive definite.
    Source:  Golub and Van Loan, Matrix Computations, section 6.1.
    """
    factor = _factor(covariance)
    exact = design if isinstance(design, Extended) else Extended.of(design)
    white = _whitened(factor, exact.high)
    rows, columns = white.shape
    length = np.linalg.norm(white, axis=0)
    scale = np.exp2(np.rint(np.log2(np.where(length > 0, length, 1.0))))  # powers of two: scaling rounds nothing
    left, singular, right = np.linalg.svd(white / scale, full_matrices=rows < columns)
    sizes = np.zeros(columns)
    sizes[: singular.size] = singular
    null = sizes <= _RANK_TOLERANCE * sizes.max(initial=0.0)
    if null.any() and not isinstance(design, Extended):
        raise _undetermined(rows, names, Undetermined(columns - int(null.sum()), np.abs(right[null]).max(axis=0)))
    if sizes[0] > _CONDITION_LIMIT * sizes[-1]:
        fit = _in_extended(exact, readings, factor, scale, names)
    else:
        root = (right.T / singular) / scale[:, None]
        white_readings = _whitened(factor, readings)
        parameters = root @ (left.T @ white_readings)
        fit = ExtendedFit(parameters, root @ left.T, root, white_readings - white @ parameters)
    return LinearFit(
        parameters=fit.parameters,
        covariance=fit.root @ fit.root.T,
        operator=_unwhitened_operator(factor, fit.pseudo_inverse),
        residual=np.asarray(factor * fit.residual if factor.ndim == 1 else factor @ fit.residual),
        chi2=float(fit.residual @ fit.residual),
        dof=rows - columns,
    )


def _in_extended(
    design: Extended, readings: Floats, factor: Floats, scale: Floats, names: Sequence[str]
) -> ExtendedFit:
    """Whitening and factorisation in twice the precision."""
    scaled = Extended(design.high / scale, design.low / scale)
    both = stacked(scaled.transposed, Extended.of(readings[None, :])).transposed
    both = _whitened_extended(factor, both)
    fit = solve_extended(both[:, :-1], both[:, -1], _EXACT_RANK_TOLERANCE)
    if isinstance(fit, Undetermined):
        raise _undetermined(len(readings), names, fit)
    return ExtendedFit(
        parameters=fit.parameters / scale,
        pseudo_inverse=fit.pseudo_inverse / scale[:, None],
        root=fit.root / scale[:, None],
        residual=fit.residual,
    )


def _undetermined(rows: int, names: Sequence[str], undetermined: Undetermined) -> FitError:
    loose = [name for name, part in zip(names, undetermined.weight, strict=True) if part > 1e-6]
    return FitError(
        "B-FIT-001",
        f"{rows} rows do not determine {', '.join(loose)}: rank {undetermined.rank} of {len(names)}",
        next_step="add rows that separate these parameters, or ask for fewer parameters",
    )


# --- the noise -------------------------------------------------------------------------------------------------------


def _factor(covariance: Floats) -> Floats:
    """Return standard deviations (m,) where the readings are independent, else the lower Cholesky factor (m, m)."""
    variance = covariance.diagonal()
    factor = np.full(covariance.shape, np.nan)
    if np.count_nonzero(covariance) == np.count_nonzero(variance):
        factor = np.sqrt(np.where(variance > 0, variance, np.nan))
    else:
        with contextlib.suppress(np.linalg.LinAlgError):
            factor = np.asarray(np.linalg.cholesky(covariance), np.float64)
    if not np.isfinite(factor).all():
        raise FitError(
            "B-FIT-002",
            "the covariance of the readings is not positive definite",
            next_step="check the uncertainties in the standards register and the converter noise of the campaign",
        )
    return factor


def _whitened(factor: Floats, rows: Floats) -> Floats:
    """Return factor^-1 @ rows by numpy's own solver, because scipy's triangular one wakes every core for 14 rows."""
    if factor.ndim == 1:
        return (rows.T / factor).T
    return np.asarray(np.linalg.solve(factor, rows), dtype=np.float64)


def _whitened_extended(factor: Floats, rows: Extended) -> Extended:
    """Return the same in twice the precision: one row after the other, from the top."""
    if factor.ndim == 1:
        return rows / Extended.of(factor[:, None])
    lower, done = Extended.of(factor), rows[:1] / Extended.of(factor[:1, :1])
    for k in range(1, len(factor)):
        known = (lower[k, :k][:, None] * done).sum()
        done = stacked(done, (rows[k : k + 1] - known[None, :]) / lower[k : k + 1, k : k + 1])
    return done


def _unwhitened_operator(factor: Floats, pseudo_inverse: Floats) -> Floats:
    if factor.ndim == 1:
        return pseudo_inverse / factor
    return np.asarray(np.linalg.solve(factor.T, pseudo_inverse.T).T, dtype=np.float64)
