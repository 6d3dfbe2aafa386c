"""Noise that is white and, beside it, wanders and returns: its size from the residuals, and intervals that hold it.

Residuals of a slow record are alike for hours. A fit that takes them for independent states intervals many times too
narrow.
Source: Patterson and Thompson, Biometrika 58 (1971) 545 (restricted likelihood); Kenward and Roger, Biometrics 53
(1997) 983 (degrees of freedom of an estimate under an estimated covariance).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
from scipy import optimize
from scipy.linalg import lapack

from bench.maths.arrays import Floats

_STEP = 5e-2  # of the numeric derivatives, in logarithms
_SHARES = (1e-4, 0.01, 0.1, 0.3, 0.6, 0.9)  # of the white part in the variance, where the search begins
_TIMES = 9  # correlation times where the search begins, from a third of a step to the whole record
_FEWEST_DOF, _MOST_DOF = 1.0, 1e4


@dataclass(frozen=True)
class CorrelatedNoise:
    """Variance ``white`` of every reading, and ``slow * exp(-|dt| / time_s)`` between readings; unit squared.

    ``spread`` (3, 3): covariance of the logarithms of the three, from the curvature of the likelihood.
    """

    white: float
    slow: float
    time_s: float
    spread: Floats

    def variance_of(self, weights: Floats, t_s: Floats) -> tuple[float, float]:
        """Variance of ``weights @ readings``, and the degrees of freedom with which it is known.

        Args:    weights, t_s: (m,).
        Returns: variance in the unit of the readings squared; degrees of freedom, 1 to 10,000.
        Source:  Satterthwaite: 2 v^2 / Var(v), Var(v) from the spread of the noise parameters (Kenward and Roger).
        """
        place = np.log([self.white, self.slow, self.time_s])
        square, lags_s = np.outer(weights, weights), np.abs(t_s[:, None] - t_s)
        diagonal = float(np.trace(square))

        @cache  # two of the three logarithms leave it as it is
        def alike(time_s: float) -> float:
            return float(np.sum(square * np.exp(-lags_s / time_s)))

        def at(point: Floats) -> float:
            white, slow, time_s = np.exp(point)
            return float(white * diagonal + slow * alike(float(time_s)))

        value = at(place)
        slope = np.array([(at(place + step) - at(place - step)) / (2 * _STEP) for step in np.eye(3) * _STEP])
        spread = float(slope @ self.spread @ slope)
        dof = 2.0 * value**2 / spread if spread > 0 else _MOST_DOF
        return value, float(np.clip(dof, _FEWEST_DOF, _MOST_DOF))

    def whitening(self, t_s: Floats) -> Whitening:
        """Return V^-1/2 of readings at these times, (m,), in order."""
        return whitening(t_s, (self.white, self.slow, self.time_s))


@dataclass(frozen=True)
class Whitening:
    """V^-1/2 by a filter: of what is expected of a reading ``stays`` goes into the next, ``learnt`` of what it read.

    ``std`` (m,): of what each reading says beyond those before it.   ``log_volume``: log|V| / 2.
    """

    stays: Floats
    learnt: Floats
    std: Floats
    log_volume: float

    def of(self, columns: Floats) -> Floats:
        """V^-1/2 applied to (m,) or (m, p): what each reading says beyond those before it, in standard deviations.

        Source:  prediction error decomposition. What is expected of all readings is a triangular system of two bands.
        """
        table = columns.reshape(self.std.size, -1)
        bands = np.ones((2, self.std.size))
        bands[1] = np.append(-self.stays, 0.0)
        expected = np.zeros(table.shape, order="F")
        np.multiply(self.learnt[:, None], table[:-1], out=expected[1:])
        expected = lapack.dtbtrs(bands, expected, uplo="L", diag="U", overwrite_b=True)[0]
        return np.asarray((table - expected) / self.std[:, None]).reshape(columns.shape)


def whitening(t_s: Floats, noise: tuple[float, float, float]) -> Whitening:
    """Return what takes the correlation out of columns; takes m steps, not m^3.

    The slow part is a Markov process, so a Kalman filter of one state predicts each reading from all before it.

    Args:    t_s: (m,), in order.   noise: variance of the white part, of the slow part, correlation time in s.
    Source:  Kalman, J. Basic Eng. 82 (1960) 35; Schweppe, IEEE Trans. Inf. Theory 11 (1965) 61 (likelihood).
    """
    white, slow, time_s = (float(value) for value in noise)
    kept = np.exp(-np.diff(t_s) / time_s)
    variances = [slow]  # of the state, before each reading
    for square, fresh in zip((kept**2).tolist(), (slow * (1.0 - kept**2)).tolist(), strict=True):
        variances.append(square * variances[-1] * white / (variances[-1] + white) + fresh)
    predicted = np.array(variances)
    total = predicted + white
    log_volume = float(np.cumsum(np.log(total) / 2.0)[-1])
    return Whitening(kept * (white / total)[:-1], kept * (predicted / total)[:-1], np.sqrt(total), log_volume)


def fit_noise(t_s: Floats, readings: Floats, design: Floats) -> CorrelatedNoise:
    """Size and duration of the noise of readings about a linear model, by restricted likelihood.

    The restricted likelihood knows that the model has taken a part of the noise away; plain residuals would look
    smaller and shorter-lived than the noise is.

    Args:    t_s: (m,), in order.   readings: (m,).   design: (m, p), of full rank.
    Returns: CorrelatedNoise.
    Source:  Patterson and Thompson (1971); a grid, then scipy.optimize.minimize (Nelder-Mead).
    """
    columns = np.column_stack((readings, np.linalg.qr(design)[0]))
    step_s, length_s = float(np.median(np.diff(t_s))), float(t_s[-1] - t_s[0])
    low, high = np.array([_SHARES[0], np.log(step_s / 3)]), np.array([0.999, np.log(length_s)])

    def parts(place: Floats) -> tuple[float, float, float]:
        share, log_time = np.clip(place, low, high)
        return share, 1.0 - share, np.exp(log_time)

    starts = [np.array([share, time]) for share in _SHARES for time in np.linspace(low[1], high[1], _TIMES)]
    costs = [_profiled(t_s, columns, parts(start))[0] for start in starts]
    end = optimize.minimize(
        lambda place: _profiled(t_s, columns, parts(place))[0],
        starts[int(np.argmin(costs))],
        method="Nelder-Mead",
        options={"xatol": 1e-2, "fatol": 1e-3},
    )
    share, rest, time_s = parts(end.x)
    variance = _profiled(t_s, columns, (share, rest, time_s))[1]
    place = np.log([variance * share, variance * rest, time_s])
    spread = _spread(lambda at: _restricted(t_s, columns, at), place)
    return CorrelatedNoise(variance * share, variance * rest, float(time_s), spread)


def _profiled(t_s: Floats, columns: Floats, unit: tuple[float, float, float]) -> tuple[float, float]:
    """Minus the restricted log-likelihood for a covariance of unknown size, and the best size."""
    log_volume, square = _volume_and_square(t_s, columns, unit)
    dof = columns.shape[0] - columns.shape[1] + 1
    size = max(square / dof, float(np.finfo(np.float64).tiny))
    return log_volume + dof / 2.0 * float(np.log(size)), size


def _restricted(t_s: Floats, columns: Floats, place: Floats) -> float:
    """Minus the restricted log-likelihood, up to a constant."""
    white, slow, time_s = (float(value) for value in np.exp(place))
    log_volume, square = _volume_and_square(t_s, columns, (white, slow, time_s))
    return log_volume + square / 2.0


def _volume_and_square(t_s: Floats, columns: Floats, noise: tuple[float, float, float]) -> tuple[float, float]:
    """log|V|/2 + log|X'V^-1 X|/2, and the square of the whitened residual; columns: readings, then X."""
    filtered = whitening(t_s, noise)
    white = filtered.of(columns)
    turned, triangle = np.linalg.qr(white[:, 1:])
    left = white[:, 0] - turned @ (turned.T @ white[:, 0])
    return filtered.log_volume + float(np.sum(np.log(np.abs(np.diag(triangle))))), float(left @ left)


def _spread(cost: Callable[[Floats], float], place: Floats) -> Floats:
    """Inverse curvature at the minimum; a direction that the residuals leave open is taken as known to a factor e."""
    steps = np.eye(place.size) * _STEP
    curvature = np.empty((place.size, place.size))
    for i, j in combinations_with_replacement(range(place.size), 2):
        step, other = steps[i], steps[j]
        corners = cost(place + step + other) - cost(place + step - other)
        corners -= cost(place - step + other) - cost(place - step - other)
        curvature[i, j] = curvature[j, i] = corners / (4.0 * _STEP**2)
    values, vectors = np.linalg.eigh(curvature)
    return np.asarray((vectors / np.maximum(values, 1.0)) @ vectors.T)
