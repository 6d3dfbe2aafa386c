"""Linear least squares with a full covariance matrix and a rank test that says what is not determined.

The columns are scaled and decomposed orthogonally. A well-conditioned problem is solved in doubles, by singular
values. Beyond a condition number of 1,000 (columns of unit norm, whitened) doubles would lose more than the six digits
that leave nine, so the same problem is factorised in twice the precision.

Source: Golub and Van Loan, Matrix Computations, sections 5.3 (QR), 5.5 (rank) and 6.1 (generalised least squares);
Björck, Numerical Methods for Least Squares Problems, sections 1.4 (the square of the condition number in the error),
2.4 (modified Gram-Schmidt with the readings as one more column) and 2.7.3 (pivoting and rank). Twice the precision is
the unevaluated sum of two doubles, some 32 digits, by error-free transformations: Dekker, Numer. Math. 18 (1971) 224;
Knuth, The Art of Computer Programming 2, section 4.2.2; Hida, Li and Bailey, 15th IEEE Symposium on Computer Arithmetic
(2001) 155.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError

_RANK_TOLERANCE = 1e-9  # smallest singular value of the scaled design, relative to the largest
_EXACT_RANK_TOLERANCE = 1e-20  # the same for columns that are known to twice the precision
_CONDITION_LIMIT = 1e3  # of the scaled, whitened design: the error of doubles goes with its square

_SPLIT = float((1 << 27) + 1)


@dataclass(frozen=True)
class Extended:
    """Numbers ``high + low``, both of one shape; ``low`` is at most half a unit in the last place of ``high``."""

    high: Floats
    low: Floats

    @classmethod
    def of(cls, values: ArrayLike) -> Extended:
        """Return doubles as they are."""
        high = np.asarray(values, np.float64)
        return cls(high, np.zeros_like(high))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of numbers."""
        return self.high.shape

    @property
    def transposed(self) -> Extended:
        """The transposed matrix."""
        return Extended(self.high.T, self.low.T)

    def __getitem__(self, place: Any) -> Extended:
        return Extended(self.high[place], self.low[place])

    def __neg__(self) -> Extended:
        return Extended(-self.high, -self.low)

    def __add__(self, other: Extended) -> Extended:
        high, error = _two_sum(self.high, other.high)
        low, rest = _two_sum(self.low, other.low)
        high, error = _fast_two_sum(high, error + low)
        return Extended(*_fast_two_sum(high, error + rest))

    def __sub__(self, other: Extended) -> Extended:
        return self + (-other)

    def __mul__(self, other: Extended) -> Extended:
        high, error = _two_product(self.high, other.high)
        return Extended(*_fast_two_sum(high, error + (self.high * other.low + self.low * other.high)))

    def __truediv__(self, other: Extended) -> Extended:
        first = Extended.of(self.high / other.high)
        rest = self - first * other
        second = Extended.of(rest.high / other.high)
        rest = rest - second * other
        return first + second + Extended.of(rest.high / other.high)

    def sqrt(self) -> Extended:
        """Return square roots of positive numbers: one Newton step from the double root."""
        root = Extended.of(np.sqrt(self.high))
        rest = self - root * root
        return root + Extended.of(rest.high / (2.0 * root.high))

    def sum(self) -> Extended:
        """Return sum over the first axis, in pairs of pairs."""
        total = self
        while len(total.high) > 1:
            half = len(total.high) // 2
            paired = total[:half] + total[half : 2 * half]
            total = paired if len(total.high) == 2 * half else stacked(paired, total[2 * half :])
        return total[0]


def stacked(*parts: Extended) -> Extended:
    """Return the parts one after the other along the first axis.

    Args:    parts: arrays of numbers, alike but for their first axis.
    Returns: Extended.
    Source:  plain rearrangement.
    """
    return Extended(np.concatenate([p.high for p in parts]), np.concatenate([p.low for p in parts]))


def _two_sum(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _fast_two_sum(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the same where |a| >= |b|."""
    total = a + b
    return total, b - (total - a)


def _two_product(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    product = a * b
    a_high, a_low = _split(a)
    b_high, b_low = _split(b)
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _split(a: Floats) -> tuple[Floats, Floats]:
    """Return halves of 26 bits, whose products are exact; for sizes below 1e300."""
    scaled = _SPLIT * a
    high = scaled - (scaled - a)
    return high, a - high


@dataclass(frozen=True)
class ExtendedFit:
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


def solve_extended(design: Extended, readings: Extended, tolerance: float) -> ExtendedFit | Undetermined:
    """Least squares by Gram-Schmidt on the columns in order of what is left of them, readings last.

    Args:    design: (m, p), columns of norms of about one.   readings: (m,).
             tolerance: what is left of a column is nothing below this.
    Returns: ExtendedFit, or Undetermined.
    Source:  Björck, Numerical Methods for Least Squares Problems, sections 2.4 and 2.7.3.
    """
    rows, columns = design.shape
    order = np.arange(columns)
    left = stacked(design.transposed, readings[None, :])  # one row a column, readings last
    upper = Extended.of(np.zeros((columns, columns + 1)))
    unit = Extended.of(np.zeros((columns, rows)))
    for k in range(columns):
        best = k + int(np.argmax(np.linalg.norm(left.high[k:columns], axis=1)))
        for swapped in (left.high, left.low, upper.high.T, upper.low.T, order):
            swapped[[k, best]] = swapped[[best, k]]
        length = _squared(left[k]).sqrt()
        if not length.high > tolerance:
            return _vanishing(upper[:, :columns], k, order)
        along = left[k] / length
        share = (left[k + 1 :].transposed * along[:, None]).sum()
        rest = left[k + 1 :] - share[:, None] * along[None, :]
        left.high[k + 1 :], left.low[k + 1 :] = rest.high, rest.low
        upper.high[k, k], upper.low[k, k] = length.high, length.low
        upper.high[k, k + 1 :], upper.low[k, k + 1 :] = share.high, share.low
        unit.high[k], unit.low[k] = along.high, along.low
    sides = stacked(upper.transposed[columns:], unit.transposed, Extended.of(np.eye(columns))).transposed
    solved = _back_substitute(upper[:, :columns], sides).high[np.argsort(order)]
    return ExtendedFit(solved[:, 0], solved[:, 1 : rows + 1], solved[:, rows + 1 :], left.high[-1])


def _squared(column: Extended) -> Extended:
    return (column * column).sum()


def _back_substitute(upper: Extended, sides: Extended) -> Extended:
    """Return solution of upper @ x = sides for sides (p, s)."""
    rest = Extended(sides.high.copy(), sides.low.copy())
    for k in range(len(sides.high) - 1, -1, -1):
        row = rest[k] / upper[k, k]
        rest.high[k], rest.low[k] = row.high, row.low
        above = rest[:k] - upper[:k, k][:, None] * row[None, :]
        rest.high[:k], rest.low[:k] = above.high, above.low
    return rest


def _vanishing(upper: Extended, rank: int, order: Integers) -> Undetermined:
    """Return which columns take part in the combinations that vanish."""
    columns = len(order)
    null = np.eye(columns)[:, rank:]
    null[:rank] = -_back_substitute(upper[:rank, :rank], upper[:rank, rank:]).high
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


def solve(design: Floats | Extended, readings: Floats, covariance: Floats, names: Sequence[str]) -> LinearFit:
    """Generalised least squares: whiten by the Cholesky factor, scale the columns, decompose, test the rank.

    Args:    design: (m, p), taken as exact. High powers should come from ``polynomial_columns``: where columns are
             nearly dependent, powers rounded to doubles are already another problem.
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
