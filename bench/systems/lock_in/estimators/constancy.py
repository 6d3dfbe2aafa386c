"""Whether the two constants of the lock-in are the same in every group of turnarounds, and follow no run.

The score of a turnaround is what its crossings still say against the constants; where the model holds its mean is zero
in every group that one cares to make, and scores of different turnarounds have nothing to do with each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from bench.systems.lock_in.estimators.global_constants import GlobalConstants

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]
_LAGS = 5
_FEWEST = 20  # turnarounds of a group
_UNKNOWN = 1e6  # condition of the two constants, if a group does not tell one of them


@dataclass(frozen=True)
class Constancy:
    """``probability``: of groups at least as unlike in a laser of constant lock-in.   ``figure``: chi-squared per
    degree of freedom.   ``kappa_moves``, ``beta_moves_rad``: relative change of the lock-in rate, and change of the
    phase, if every group counts by its turnarounds, not by its weight in the fit. ``turned``: lock-in of each group
    over that of the fit, (G,), complex: size and turn of the phase; empty where the groups tell nothing.
    """

    probability: float
    figure: float
    kappa_moves: float
    beta_moves_rad: float
    turned: NDArray[np.complex128]


def constancy(fit: GlobalConstants, group: Int64) -> Constancy:
    """Return whether the constants differ between groups of the usable turnarounds.

    Args:    fit: with u usable turnarounds.   group: of each, (u,), 0 to G - 1.
    Returns: Constancy; of groups that do not tell both constants, nothing odd. By Hotelling's T squared
             with as many degrees of freedom as the smallest group has turnarounds.
    Source:  score test with the scatter of the turnarounds themselves; Hotelling (1931).
    """
    count = int(group.max()) + 1
    size = np.bincount(group, minlength=count)
    change, precision = np.empty((count, 2)), np.empty((count, 2, 2))
    for g in range(count):
        score, weight = fit.score[group == g], fit.information[group == g].sum(axis=0)
        if size[g] < _FEWEST or np.linalg.cond(weight) > _UNKNOWN:
            return Constancy(1.0, 0.0, 0.0, 0.0, np.empty(0, np.complex128))
        scatter = score.T @ score - np.outer(score.sum(axis=0), score.sum(axis=0)) / size[g]
        change[g] = np.linalg.solve(weight, score.sum(axis=0))
        precision[g] = weight @ np.linalg.inv(scatter) @ weight
    pooled = np.linalg.solve(precision.sum(axis=0), np.einsum("gpq,gq->p", precision, change))
    off = change - pooled
    chi2, dof = float(np.einsum("gp,gpq,gq->", off, precision, off)), 2 * (count - 1)
    turned = (fit.kappa_rad_s + (change[:, 0] + 1j * change[:, 1]) * np.exp(-1j * fit.beta_rad)) / fit.kappa_rad_s
    return Constancy(
        float(special.fdtrc(dof, int(size.min()), chi2 / dof)),
        chi2 / dof,
        float(np.average(np.abs(turned), weights=size)) - 1.0,
        float(np.average(np.angle(turned), weights=size)),
        turned,
    )


def runs(fit: GlobalConstants) -> tuple[float, float]:
    """Return the probability of scores at least as correlated if turnarounds are independent, and by how much the
    standard uncertainty of the constants would have to be multiplied.

    Args:    fit: its turnarounds in order of time, (u,).
    Source:  Ljung and Box, Biometrika 65 (1978) 297, with correlations that do not ask for equal variances.
    """
    score, lags = fit.score, range(1, _LAGS + 1)
    products = [score[lag:] * score[:-lag] for lag in lags]
    z = np.array([product.sum(axis=0) / np.sqrt(np.square(product).sum(axis=0)) for product in products])
    shared = np.array([product.sum(axis=0) for product in products]) / np.square(score).sum(axis=0)
    factor = np.sqrt(np.maximum(1.0 + 2.0 * shared.sum(axis=0), 0.0))
    return float(special.chdtrc(z.size, float(np.square(z).sum()))), float(factor.max())


def parts_of(values: Array, count: int) -> Int64:
    """Return which of ``count`` parts of equal size each value is in, by its order, (n,).

    Source: definition of quantiles.
    """
    order = np.empty(values.size, np.int64)
    order[np.argsort(values, kind="stable")] = np.arange(values.size)
    return np.asarray(order * count // values.size)
