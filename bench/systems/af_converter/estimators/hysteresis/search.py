"""Search for thermal lag and play half-width: the linear parameters are solved inside (variable projection).

Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413 (variable projection).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from bench.systems.af_converter.estimators.hysteresis.model import HysteresisModel

Array = NDArray[np.float64]
Whiten = Callable[[Array], Array]
_REFINED = 3  # local minima of the grid that are followed up
_TOLERANCE = {"diff_step": 1e-4, "xtol": 1e-7, "ftol": 1e-10}


@dataclass(frozen=True)
class Bounds:
    """Range in which lag and half-width are looked for, and how many starts per axis."""

    lag_s: tuple[float, float] = (120.0, 5400.0)
    half_width_degC: tuple[float, float] = (0.3, 9.0)
    starts: int = 5

    @property
    def low(self) -> Array:
        """Lower ends, (lag in s, half-width in degC)."""
        return np.array([self.lag_s[0], self.half_width_degC[0]])

    @property
    def high(self) -> Array:
        """Upper ends, (lag in s, half-width in degC)."""
        return np.array([self.lag_s[1], self.half_width_degC[1]])

    @property
    def std(self) -> Array:
        """Standard deviation of a value of which nothing is known but the bounds, (lag in s, half-width in degC)."""
        return np.asarray((self.high - self.low) / np.sqrt(12.0))


@dataclass(frozen=True)
class Problem:
    """Readings (m,), the model that gives their columns, and V^-1/2 of their noise, for (m,) or (m, p)."""

    model: HysteresisModel
    readings: Array
    whiten: Whiten

    def projected(self, lag_s: float, half_width_degC: float) -> Array:
        """White residual (m,) of the best linear parameters at these nonlinear ones."""
        white = self.whiten(self.readings)
        basis = np.linalg.qr(self.whiten(self.model.columns(lag_s, half_width_degC)))[0]
        return np.asarray(white - basis @ (basis.T @ white))

    def chi2(self, lag_s: float, half_width_degC: float) -> float:
        """Chi-square of the best linear parameters at these nonlinear ones."""
        white = self.projected(lag_s, half_width_degC)
        return float(white @ white)


@dataclass(frozen=True)
class Place:
    """A pair of nonlinear parameters and its chi-square."""

    lag_s: float
    half_width_degC: float
    chi2: float


def search(problem: Problem, bounds: Bounds) -> Place:
    """Least chi-square over the bounds: a grid of starts, then a bounded descent from its best local minima.

    Args:    problem: what is fitted.   bounds: where to look; starts squared is the number of starts.
    Returns: the best Place.
    Source:  Golub and Pereyra (1973); descent by scipy.optimize.least_squares (trust region reflective).
    """
    lags, halves = (_spaced(low, high, bounds.starts) for low, high in (bounds.lag_s, bounds.half_width_degC))
    cost = np.array([[problem.chi2(lag, half) for half in halves] for lag in lags])
    ends = []
    for row, column in _local_minima(cost)[:_REFINED]:
        end = optimize.least_squares(
            lambda place: problem.projected(float(place[0]), float(place[1])),
            [lags[row], halves[column]],
            bounds=(bounds.low, bounds.high),
            x_scale=bounds.high,
            **_TOLERANCE,
        )
        ends.append(Place(float(end.x[0]), float(end.x[1]), 2.0 * float(end.cost)))
    return min(ends, key=lambda end: end.chi2)


def best_lag(problem: Problem, half_width_degC: float, bounds: Bounds, start_s: float) -> Place:
    """Least chi-square over the lag alone, the half-width given; a descent from ``start_s``.

    Source: as for ``search``.
    """
    low, high = bounds.lag_s
    end = optimize.least_squares(
        lambda place: problem.projected(float(place[0]), half_width_degC),
        [min(max(start_s, low + 1e-3 * (high - low)), high - 1e-3 * (high - low))],
        bounds=bounds.lag_s,
        x_scale=high,
        **(_TOLERANCE | {"ftol": 1e-6}),  # of a chi-square near the number of readings: far below 1
    )
    return Place(float(end.x[0]), half_width_degC, 2.0 * float(end.cost))


def _spaced(low: float, high: float, count: int) -> list[float]:
    """Starts inside a range, denser at its low end: even in the square root, not on the ends themselves."""
    places = (np.arange(count) + 0.5) / count
    return [float(one) for one in (np.sqrt(low) + places * (np.sqrt(high) - np.sqrt(low))) ** 2]


def _local_minima(cost: Array) -> list[tuple[int, int]]:
    """Places of the grid not higher than their four neighbours, best first."""
    padded = np.pad(cost, 1, constant_values=np.inf)
    inner = padded[1:-1, 1:-1]
    around = np.minimum.reduce([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    places = [(int(row), int(column)) for row, column in np.argwhere(inner <= around)]
    return sorted(places, key=lambda place: cost[place])
