"""Orthogonal factorisation with column pivoting in twice the working precision, for ill-conditioned least squares.

Source: Björck, Numerical Methods for Least Squares Problems, sections 2.4 (modified Gram-Schmidt with the readings as
one more column) and 2.7.3 (pivoting and rank).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.maths.extended import Extended, stacked

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExtendedFit:
    """Least-squares solution of full column rank.

    Attributes:
        parameters: (p,); ``pseudo_inverse`` (p, m) maps the readings to them; ``root`` (p, p) with
            root @ root.T = (X'X)^-1; ``residual`` (m,) readings minus design times parameters.
    """

    parameters: Array
    pseudo_inverse: Array
    root: Array
    residual: Array


@dataclass(frozen=True)
class Undetermined:
    """A design whose columns depend on each other: rank, and the largest weight of each column in that, (p,)."""

    rank: int
    weight: Array


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
    """Solution of upper @ x = sides for sides (p, s)."""
    rest = Extended(sides.high.copy(), sides.low.copy())
    for k in range(len(sides.high) - 1, -1, -1):
        row = rest[k] / upper[k, k]
        rest.high[k], rest.low[k] = row.high, row.low
        above = rest[:k] - upper[:k, k][:, None] * row[None, :]
        rest.high[:k], rest.low[:k] = above.high, above.low
    return rest


def _undetermined(upper: Extended, rank: int, order: NDArray[np.int64]) -> Undetermined:
    """Return which columns take part in the combinations that vanish."""
    columns = len(order)
    null = np.eye(columns)[:, rank:]
    null[:rank] = -_back_substitute(upper[:rank, :rank], upper[:rank, rank:]).high
    weight = np.zeros(columns)
    weight[order] = np.abs(null / np.linalg.norm(null, axis=0)).max(axis=1)
    return Undetermined(rank, weight)
