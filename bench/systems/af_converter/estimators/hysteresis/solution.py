"""Parameters and covariance of the joint fit at one pair of nonlinear parameters, or averaged over the half-width.

Source: docs/decisions/0006-bias-and-hysteresis.md; JCGM 100:2008 (uncertainty of a fit).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.maths.least_squares import solve
from bench.systems.af_converter.estimators.hysteresis.search import Bounds, Place, Problem, best_lag
from bench.systems.af_converter.estimators.level import Level

Array = NDArray[np.float64]
_STEP = 1e-3  # of the numeric derivatives, relative
_HALF_WIDTHS = 12  # places of the average


@dataclass(frozen=True)
class Solution:
    """``parameters`` (p + 2,): linear ones, lag in s, half-width in degC; ``covariance`` (p + 2, p + 2)."""

    parameters: Array
    covariance: Array
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
    white, white_columns = problem.whiten(problem.readings), problem.whiten(columns)
    basis, triangle = np.linalg.qr(white_columns)
    linear = solve(triangle, basis.T @ white, np.eye(triangle.shape[0]), problem.model.names).parameters
    slopes = problem.whiten(_derivatives(problem, place, linear))
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


def _derivatives(problem: Problem, place: Place, linear: Array) -> Array:
    """Change of the model with lag and half-width, (m, 2), by central differences."""
    columns, lag_s, half = problem.model.columns, place.lag_s, place.half_width_degC
    by_lag = columns(lag_s * (1 + _STEP), half) - columns(lag_s * (1 - _STEP), half)
    by_half = columns(lag_s, half * (1 + _STEP)) - columns(lag_s, half * (1 - _STEP))
    return np.column_stack((by_lag @ linear / (2 * _STEP * lag_s), by_half @ linear / (2 * _STEP * half)))


def _covariance(white_design: Array, prior_std: Array) -> tuple[Array, float]:
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
