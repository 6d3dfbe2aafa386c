"""Arithmetic of twice the working precision on arrays, and orthogonal factorisation in it.

A number is the unevaluated sum of two doubles. Error-free transformations give the rounding error of a sum or product
as a double of its own; carrying it along makes about 32 significant digits. The factorisation serves
ill-conditioned least squares.

Source: Dekker, Numer. Math. 18 (1971) 224; Knuth, The Art of Computer Programming 2, section 4.2.2; Hida, Li and
Bailey, 15th IEEE Symposium on Computer Arithmetic (2001) 155; Björck, Numerical Methods for Least Squares Problems,
sections 2.4 (modified Gram-Schmidt with the readings as one more column) and 2.7.3 (pivoting and rank).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.maths.arrays import Floats, Integers

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
            return _undetermined(upper[:, :columns], k, order)
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


def _undetermined(upper: Extended, rank: int, order: Integers) -> Undetermined:
    """Return which columns take part in the combinations that vanish."""
    columns = len(order)
    null = np.eye(columns)[:, rank:]
    null[:rank] = -_back_substitute(upper[:rank, :rank], upper[:rank, rank:]).high
    weight = np.zeros(columns)
    weight[order] = np.abs(null / np.linalg.norm(null, axis=0)).max(axis=1)
    return Undetermined(rank, weight)
