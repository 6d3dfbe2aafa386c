"""Noise of equally spaced means: a white part and a part that wanders and returns, by the Whittle likelihood.

How long the slow part lasts is known badly from one record, so what depends on it is averaged over all durations and
sizes, weighted with their likelihood.

Source: Whittle, Ark. Mat. 2 (1953) 423 (likelihood of a periodogram); variance of quadratic forms of Gaussian noise by
Isserlis' theorem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_SHARES = np.concatenate(([0.0], np.geomspace(0.003, 1.0, 25)))  # slow part of the variance of a mean
_TIMES = 24  # correlation times tried, from half a mean to the whole record


@dataclass(frozen=True)
class MeanNoise:
    """Noise of ``count`` means, unit squared.

    Attributes:
        white, slow: variance of a mean by part, ``steps``: correlation length of the slow part in means; the most
            likely ones.   dof_of_variance: effective degrees of freedom of the variance of the means about their mean.
    """

    white: float
    slow: float
    steps: float
    count: int
    dof_of_variance: float


def mean_noise(means: Array) -> MeanNoise:
    """White and slow part of the noise of equally spaced means.

    Args:    means: (n,), n >= 8.
    Returns: MeanNoise.
    Source:  see the head of this file; degrees of freedom 2 E^2 / Var, their inverse averaged.
    """
    count = means.size
    power = np.square(np.abs(np.fft.rfft(means - means.mean())))[1 : (count + 1) // 2] / count
    turn = 2.0 * np.pi * np.arange(1, power.size + 1) / count
    kept = np.exp(-1.0 / np.geomspace(0.5, float(count), _TIMES))
    slow = (1.0 - kept[:, None] ** 2) / (1.0 - 2.0 * kept[:, None] * np.cos(turn) + kept[:, None] ** 2)
    shape = (1.0 - _SHARES)[None, :, None] + _SHARES[None, :, None] * slow[:, None, :]
    size = (power / shape).mean(axis=2)
    if not np.all(size > 0.0):
        return MeanNoise(0.0, 0.0, 1.0, count, count - 1.0)
    cost = power.size * np.log(size) + np.log(shape).sum(axis=2)
    weight = np.exp(cost.min() - cost)
    spread = float((weight * _inverse_dof(kept, count)).sum() / weight.sum())
    time, share = np.unravel_index(int(np.argmin(cost)), cost.shape)
    total = float(size[time, share])
    return MeanNoise(
        white=total * (1.0 - float(_SHARES[share])),
        slow=total * float(_SHARES[share]),
        steps=float(-1.0 / np.log(kept[time])),
        count=count,
        dof_of_variance=float(np.clip(1.0 / spread, 1.0, count - 1.0)),
    )


def _inverse_dof(kept: Array, count: int) -> Array:
    """1 / degrees of freedom of the variance about the mean, by correlation time and share, (times, shares).

    With C = I - 1 1'/n and covariance V: Var / (2 E^2) = tr(CVCV) / tr(CV)^2, taken from the lags because V depends on
    them only.
    """
    lags = np.arange(count)
    covariance = _SHARES[None, :, None] * (kept[:, None, None] ** lags)
    covariance[:, :, 0] = 1.0
    pairs = np.where(lags == 0, count, 2.0 * (count - lags))
    summed = np.cumsum(covariance, axis=2)
    rows = summed + summed[:, :, ::-1] - 1.0
    total = rows.sum(axis=2)
    square = (pairs * covariance**2).sum(axis=2) - 2.0 / count * (rows**2).sum(axis=2) + (total / count) ** 2
    return np.asarray(square / (count - total / count) ** 2)
