"""Linear least squares with a full covariance matrix and a rank test that says what is not determined.

The columns are scaled and decomposed orthogonally. A well-conditioned problem is solved in doubles, by singular
values. Beyond a condition number of 1,000 (columns of unit norm, whitened) doubles would lose more than the six digits
that leave nine, so the same problem is factorised in decimals of 40 digits.

Source: Golub and Van Loan, Matrix Computations, sections 5.3 (QR), 5.5 (rank) and 6.1 (generalised least squares);
Björck, Numerical Methods for Least Squares Problems, sections 1.4 (the square of the condition number in the error),
2.4 (modified Gram-Schmidt with the readings as one more column) and 2.7.3 (pivoting and rank).
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Context, Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError

Exact = NDArray[np.object_]  # of decimals
_RANK_TOLERANCE = 1e-9  # smallest singular value of the scaled design, relative to the largest
_EXACT_RANK_TOLERANCE = 1e-20  # the same for columns that are known in decimals
_CONDITION_LIMIT = 1e3  # of the scaled, whitened design: the error of doubles goes with its square

_DIGITS = Context(prec=40)
_exact: Any = np.frompyfunc(Decimal, 1, 1)  # doubles as decimals, digit by digit


@dataclass(frozen=True)
class ExactFit:
    """Least-squares solution of full column rank.

    Attributes:
        parameters: (p,); ``pseudo_inverse`` (p, m) maps the readings to them; ``root`` (p, p) with
            root @ root.T = (X'X)^-1; ``residual`` (m,) readings minus design times parameters.
    """

    parameters: Floats
    pseudo_inverse: Floats
    root: Floats
    residual: Floats


@dataclass(frozen=True)
class Undetermined:
    """A design whose columns depend on each other: rank, and the largest weight of each column in that, (p,)."""

    rank: int
    weight: Floats


def _orthogonalised(design: Exact, readings: Exact, tolerance: float) -> ExactFit | Undetermined:
    """Solve by Gram-Schmidt on the columns (m, p) in order of what is left of them, readings (m,) last.

    What is left of a column, which has a norm of about one, is nothing below the tolerance.
    Source: Björck, Numerical Methods for Least Squares Problems, sections 2.4 and 2.7.3.
    """
    rows, columns = design.shape
    order = np.arange(columns)
    left = np.vstack([design.T, readings])  # one row a column, readings last
    upper, unit = _exact(np.zeros((columns, columns + 1))), _exact(np.zeros((columns, rows)))
    for k in range(columns):
        best = k + int(np.argmax(np.linalg.norm(left[k:columns].astype(float), axis=1)))
        for swapped in (left, upper.T, order):
            swapped[[k, best]] = swapped[[best, k]]
        length = (left[k] @ left[k]).sqrt()
        if not length > tolerance:
            return _vanishing(upper[:, :columns], k, order)
        unit[k] = left[k] / length
        upper[k, k], upper[k, k + 1 :] = length, left[k + 1 :] @ unit[k]
        left[k + 1 :] -= np.outer(upper[k, k + 1 :], unit[k])
    sides = np.hstack([upper[:, columns:], unit, _exact(np.eye(columns))])
    solved = _back_substituted(upper[:, :columns], sides)[np.argsort(order)].astype(float)
    return ExactFit(solved[:, 0], solved[:, 1 : rows + 1], solved[:, rows + 1 :], left.astype(float)[-1])


def _back_substituted(upper: Exact, sides: Exact) -> Exact:
    """Return solution of upper @ x = sides for sides (p, s)."""
    solved = sides.copy()
    for k in range(len(solved) - 1, -1, -1):
        solved[k] /= upper[k, k]
        solved[:k] -= np.outer(upper[:k, k], solved[k])
    return solved


def _vanishing(upper: Exact, rank: int, order: Integers) -> Undetermined:
    """Return which columns take part in the combinations that vanish."""
    columns = len(order)
    null = np.eye(columns)[:, rank:]
    null[:rank] = -_back_substituted(upper[:rank, :rank], upper[:rank, rank:])
    weight = np.zeros(columns)
    weight[order] = np.abs(null / np.linalg.norm(null, axis=0)).max(axis=1)
    return Undetermined(rank, weight)


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


def solve(design: Floats | Exact, readings: Floats, covariance: Floats, names: Sequence[str]) -> LinearFit:
    """Generalised least squares: whiten by the Cholesky factor, scale the columns, decompose, test the rank.

    Args:    design: (m, p), taken as exact; of decimals where columns are nearly dependent, as high powers are: rounded
             to doubles they are already another problem.
             readings: (m,).   covariance: (m, m) of the readings, positive definite.
             names: p parameter names for the messages.
    Returns: LinearFit with the parameters in the caller's units.
    Raises:  FitError B-FIT-001 if the rows do not determine all parameters, naming those; B-FIT-002 if the
             covariance is not positive definite.
    Source:  Golub and Van Loan, Matrix Computations, section 6.1.
    """
    factor = _factor(covariance)
    white = _whitened(factor, design.astype(float))
    rows, columns = white.shape
    length = np.linalg.norm(white, axis=0)
    scale = np.exp2(np.rint(np.log2(np.where(length > 0, length, 1.0))))  # powers of two: scaling rounds nothing
    left, singular, right = np.linalg.svd(white / scale, full_matrices=rows < columns)
    sizes = np.zeros(columns)
    sizes[: singular.size] = singular
    null = sizes <= _RANK_TOLERANCE * sizes.max(initial=0.0)
    if null.any() and design.dtype != object:
        raise _undetermined(rows, names, Undetermined(columns - int(null.sum()), np.abs(right[null]).max(axis=0)))
    if sizes[0] > _CONDITION_LIMIT * sizes[-1]:
        with localcontext(_DIGITS):
            fit = _in_decimals(_exact(design), _exact(readings), _exact(factor), _exact(scale))
        if isinstance(fit, Undetermined):
            raise _undetermined(rows, names, fit)
    else:
        root = (right.T / singular) / scale[:, None]
        white_readings = _whitened(factor, readings)
        parameters = root @ (left.T @ white_readings)
        fit = ExactFit(parameters, root @ left.T, root, white_readings - white @ parameters)
    return LinearFit(
        parameters=fit.parameters,
        covariance=fit.root @ fit.root.T,
        operator=_unwhitened_operator(factor, fit.pseudo_inverse),
        residual=np.asarray(factor * fit.residual if factor.ndim == 1 else factor @ fit.residual),
        chi2=float(fit.residual @ fit.residual),
        dof=rows - columns,
    )


def _in_decimals(design: Exact, readings: Exact, factor: Exact, scale: Exact) -> ExactFit | Undetermined:
    """Whiten and factorise, all in the context of the caller."""
    both = np.column_stack([design / scale, readings])
    if factor.ndim == 1:
        both = both / factor[:, None]
    else:  # one row after the other, from the top
        for k in range(len(both)):
            both[k] = (both[k] - factor[k, :k].dot(both[:k])) / factor[k, k]
    fit = _orthogonalised(both[:, :-1], both[:, -1], _EXACT_RANK_TOLERANCE)
    if isinstance(fit, Undetermined):
        return fit
    size = scale.astype(float)
    return replace(
        fit,
        parameters=fit.parameters / size,
        pseudo_inverse=fit.pseudo_inverse / size[:, None],
        root=fit.root / size[:, None],
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


def _unwhitened_operator(factor: Floats, pseudo_inverse: Floats) -> Floats:
    if factor.ndim == 1:
        return pseudo_inverse / factor
    return np.asarray(np.linalg.solve(factor.T, pseudo_inverse.T).T, dtype=np.float64)
