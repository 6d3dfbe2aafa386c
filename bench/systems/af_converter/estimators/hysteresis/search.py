"""Search for thermal lag and play half-width, and all parameters with their covariance at what was found.

The linear parameters are solved inside (variable projection). The solution is that at one pair of nonlinear parameters,
or averaged over the half-width.
Source: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413 (variable projection); JCGM 100:2008 (uncertainty of a
fit); docs/method-af-converter.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize

from bench.maths.arrays import Floats
from bench.maths.least_squares import solve
from bench.systems.af_converter.estimators.hysteresis.model import HysteresisModel, Level

Whiten = Callable[[Floats], Floats]
_REFINED = 3  # local minima of the grid that are followed up
_TOLERANCE = {"diff_step": 1e-4, "xtol": 1e-7, "ftol": 1e-10}
_STEP = 1e-3  # of the numeric derivatives, relative
_HALF_WIDTHS = 12  # places of the average


@dataclass(frozen=True)
class Bounds:
    """Range in which lag and half-width are looked for, and how many starts per axis."""

    lag_s: tuple[float, float] = (120.0, 5400.0)
    half_width_degC: tuple[float, float] = (0.3, 9.0)
    starts: int = 5

    @property
    def low(self) -> Floats:
        """Lower ends, (lag in s, half-width in degC)."""
        return np.array([self.lag_s[0], self.half_width_degC[0]])

    @property
    def high(self) -> Floats:
        """Upper ends, (lag in s, half-width in degC)."""
        return np.array([self.lag_s[1], self.half_width_degC[1]])

    @property
    def std(self) -> Floats:
        """Standard deviation of a value of which nothing is known but the bounds, (lag in s, half-width in degC)."""
        return np.asarray((self.high - self.low) / np.sqrt(12.0))


@dataclass(frozen=True)
class Problem:
    """Readings (m,), the model that gives their columns, and V^-1/2 of their noise, for (m,) or (m, p)."""

    model: HysteresisModel
    readings: Floats
    whiten: Whiten

    @cached_property
    def white(self) -> Floats:
        """White readings (m,)."""
        return self.whiten(self.readings)

    def projected(self, lag_s: float, half_width_degC: float) -> Floats:
        """White residual (m,) of the best linear parameters at these nonlinear ones."""
        basis = np.linalg.qr(self.whiten(self.model.columns(lag_s, half_width_degC)))[0]
        return self.white - basis @ (basis.T @ self.white)

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
    starts = _local_minima(cost)[:_REFINED]
    ends = [descend(problem, lags[row], halves[column], bounds) for row, column in starts]
    return min(ends, key=lambda end: end.chi2)


def descend(problem: Problem, lag_s: float, half_width_degC: float, bounds: Bounds) -> Place:
    """Least chi-square near a start inside the bounds.

    Source: as for ``search``.
    """
    end = optimize.least_squares(
        lambda place: problem.projected(float(place[0]), float(place[1])),
        [lag_s, half_width_degC],
        bounds=(bounds.low, bounds.high),
        x_scale=bounds.high,
        **_TOLERANCE,
    )
    return Place(float(end.x[0]), float(end.x[1]), 2.0 * float(end.cost))


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
    return [float(value) for value in (np.sqrt(low) + places * (np.sqrt(high) - np.sqrt(low))) ** 2]


def _local_minima(cost: Floats) -> list[tuple[int, int]]:
    """Places of the grid not higher than their four neighbours, best first."""
    padded = np.pad(cost, 1, constant_values=np.inf)
    inner = padded[1:-1, 1:-1]
    around = np.minimum.reduce([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
    places = [(int(row), int(column)) for row, column in np.argwhere(inner <= around)]
    return sorted(places, key=lambda place: cost[place])


@dataclass(frozen=True)
class Solution:
    """``parameters`` (p + 2,): linear ones, lag in s, half-width in degC; ``covariance`` (p + 2, p + 2)."""

    parameters: Floats
    covariance: Floats
    log_weight: float  # logarithm of the integral of the likelihood over all but the half-width, up to a constant


def solution_at(
    problem: Problem, place: Place, bounds: Bounds, level: Level | None, *, fixed: bool = False
) -> Solution:
    """Linear parameters at a place and the covariance of all.

    The bounds of the search enter as what is known beforehand: the half-width of a channel without hysteresis would
    have no finite variance otherwise.

    Args:    level: see ``fit_hysteresis``.   fixed: the half-width is given, so its variance is 0.
    Raises:  FitError B-FIT-001 if the readings do not determine the linear parameters, naming those.
    Source:  Golub and Pereyra (1973); JCGM 100:2008, 5.2.
    """
    columns = problem.model.columns(place.lag_s, place.half_width_degC)
    white, white_columns = problem.white, problem.whiten(columns)
    basis, triangle = np.linalg.qr(white_columns)
    linear = solve(triangle, basis.T @ white, np.eye(triangle.shape[0]), problem.model.names).parameters
    slopes = problem.whiten(derivatives(problem, place, linear))
    prior_std = bounds.std
    if fixed:
        slopes, prior_std = slopes[:, :1], prior_std[:1]
    design = np.column_stack((white_columns, slopes))
    covariance, log_volume = _covariance(design, prior_std)
    if level is not None:
        shared = problem.whiten(level.covariance)
        linear = linear + np.eye(linear.size)[0] * float(shared @ (white - basis @ (basis.T @ white)))
        covariance = level.referred(covariance, design.T @ shared, float(shared @ shared))
    if fixed:
        covariance = np.pad(covariance, (0, 1))
    parameters = np.concatenate((linear, [place.lag_s, place.half_width_degC]))
    return Solution(parameters, covariance, log_volume - place.chi2 / 2.0)


def averaged(problem: Problem, place: Place, bounds: Bounds, level: Level | None) -> Solution:
    """Mean and covariance over all half-widths within the bounds, each as likely as the readings make it.

    To choose the best half-width where there is no hysteresis is to choose the one at which noise looks most like it.

    Source: Bayesian model averaging with uniform weight over the bounds; integrals by the method of Laplace.
    """
    low, high = bounds.half_width_degC
    halves = low + (np.arange(_HALF_WIDTHS) + 0.5) / _HALF_WIDTHS * (high - low)
    parts = []
    for half in halves:
        at = best_lag(problem, float(half), bounds, place.lag_s)
        parts.append(solution_at(problem, at, bounds, level, fixed=True))
    log_weights = np.array([part.log_weight for part in parts])
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    all_parameters = np.array([part.parameters for part in parts])
    mean = weights @ all_parameters
    within = np.tensordot(weights, np.array([part.covariance for part in parts]), axes=1)
    between = (all_parameters - mean).T @ (weights[:, None] * (all_parameters - mean))
    return Solution(mean, within + between, float(log_weights.max()))


def spacing_degC(bounds: Bounds) -> float:
    """Distance of the half-widths of an average, degC.

    Source: definition; see ``averaged``.
    """
    return float(bounds.high[1] - bounds.low[1]) / _HALF_WIDTHS


def derivatives(problem: Problem, place: Place, linear: Floats) -> Floats:
    """Change of the model with lag and half-width, (m, 2), by central differences."""
    columns, lag_s, half = problem.model.columns, place.lag_s, place.half_width_degC
    by_lag = columns(lag_s * (1 + _STEP), half) - columns(lag_s * (1 - _STEP), half)
    by_half = columns(lag_s, half * (1 + _STEP)) - columns(lag_s, half * (1 - _STEP))
    return np.column_stack((by_lag @ linear / (2 * _STEP * lag_s), by_half @ linear / (2 * _STEP * half)))


def first_order(problem: Problem, lag_s: float, half_width_degC: float) -> tuple[Floats, Floats]:
    """Return the columns of the fit about a lag and a half-width, these two last, (m, p + 2), and its residual, (m,).

    Source: Golub and Pereyra (1973): linear parameters solved, lag and half-width by their slopes.
    """
    columns = problem.model.columns(lag_s, half_width_degC)
    linear = np.asarray(np.linalg.lstsq(problem.whiten(columns), problem.white, rcond=None)[0], dtype=np.float64)
    slopes = derivatives(problem, Place(lag_s, half_width_degC, 0.0), linear)
    return np.column_stack((columns, slopes)), problem.readings - columns @ linear


def _covariance(white_design: Floats, prior_std: Floats) -> tuple[Floats, float]:
    """(J' V^-1 J + prior)^-1, and half the logarithm of its determinant; the prior is on the last parameters."""
    rows, columns = white_design.shape
    more = prior_std.size
    stacked = np.zeros((rows + more, columns))
    stacked[:rows] = white_design
    stacked[rows:, columns - more :] = np.diag(1.0 / prior_std)
    scale = np.linalg.norm(stacked, axis=0)
    triangle = np.linalg.qr(stacked / scale)[1]
    inverse = np.linalg.inv(triangle) / scale[:, None]
    return inverse @ inverse.T, -float(np.sum(np.log(np.abs(np.diag(triangle)))) + np.sum(np.log(scale)))
