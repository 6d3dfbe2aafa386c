"""Bias, hysteresis and thermal lag of one channel fitted together, with the full covariance.

Source: docs/decisions/0006-bias-and-hysteresis.md; JCGM 100:2008 (uncertainty of a fit).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, Gates, HysteresisModel, ModelShape
from bench.systems.af_converter.estimators.hysteresis.search import Bounds, Problem, search
from bench.systems.af_converter.estimators.hysteresis.solution import Solution, averaged, solution_at, spacing_degC
from bench.systems.af_converter.estimators.level import Level
from bench.systems.af_converter.estimators.thermal_lag import Drive

Array = NDArray[np.float64]
Whiten = Callable[[Array], Array]
LAG, HALF_WIDTH = "thermal lag", "play half-width"
_SIGNIFICANT = 4.0  # standard deviations of the width, below which its half-width means nothing
_INSIDE = 2.0  # standard deviations that must fit between an estimate and the bounds of its search


@dataclass(frozen=True)
class HysteresisFit:
    """Result of a joint fit. Units: Y = that of the readings.

    ``names``: b0, b1 ... (Y/degC^k about ``reference_degC``), "hysteresis width" (Y, falling minus rising), the extra
    columns, "thermal lag" (s), "play half-width" (degC); ``parameters`` (n,) and ``covariance`` (n, n) in that order.
    ``unit_degC``, ``play_column``, ``residual`` (m,): lagged temperature of each gate, (P - T) / (2 r), and reading
    minus fit.   ``loop_degC``: ends of the temperature loop.   ``lag_determined``, ``half_width_determined``: False
    where the readings leave that parameter open within the bounds of the search; without a determined half-width, all
    estimates are averages over the half-widths possible, and their covariance holds the spread.
    ``beyond``: LAG or HALF_WIDTH if the readings ask for one that was not looked for, else "". The other parameters
    then take over what that one may not, and none of them is to be believed.
    """

    names: tuple[str, ...]
    parameters: Array
    covariance: Array
    reference_degC: float
    order: int
    unit_degC: Array
    play_column: Array
    residual: Array
    chi2: float
    dof: int
    loop_degC: tuple[float, float]
    lag_determined: bool
    half_width_determined: bool
    beyond: str

    @property
    def reduced_chi2(self) -> float:
        """Chi-square per degree of freedom; about 1 where the declared noise is that of the readings."""
        return self.chi2 / self.dof

    def value(self, name: str) -> float:
        """Return estimate of the parameter called ``name``."""
        return float(self.parameters[self.names.index(name)])

    def std(self, name: str) -> float:
        """Return standard uncertainty of the parameter called ``name``."""
        index = self.names.index(name)
        return float(np.sqrt(self.covariance[index, index]))

    def combination(self, weights: Array) -> tuple[float, float]:
        """Return value and standard uncertainty of a linear combination of the leading parameters, weights (k,)."""
        k = weights.size
        return float(weights @ self.parameters[:k]), float(np.sqrt(weights @ self.covariance[:k, :k] @ weights))

    def curve(self, temperature_degC: float) -> tuple[float, float]:
        """Centre curve, b0 + b1 x + ..., at a lagged temperature, with its standard uncertainty."""
        return self.combination((temperature_degC - self.reference_degC) ** np.arange(self.order + 1.0))


def fit_hysteresis(
    readings: Array,
    gates: Gates,
    drive: Drive,
    whiten: Whiten,
    *,
    shape: ModelShape | None = None,
    bounds: Bounds | None = None,
    level: Level | None = None,
) -> HysteresisFit:
    """Fit polynomial, hysteresis width, thermal lag and play half-width to one series of readings.

    Args:    readings: (m,), NaN not allowed.   gates: when they were taken.   drive: temperature around the unit (or
             of its own sensor), its preparation included.   whiten: V^-1/2 of the noise of the readings.
             shape: order, extra columns, start of the play.   bounds: of lag and half-width.
             level: what b0 means where the noise has no level of its own (a random walk); None: b0 as it stands.
    Returns: HysteresisFit.
    Raises:  FitError B-FIT-001 if the readings do not determine the linear parameters, naming those.
    Source:  docs/decisions/0006-bias-and-hysteresis.md; Golub and Pereyra (1973).
    """
    shape, bounds = shape or ModelShape(), bounds or Bounds()
    problem = Problem(HysteresisModel(gates, drive, shape), readings, whiten)
    place = search(problem, bounds)
    solution = solution_at(problem, place, bounds, level)
    names = (*problem.model.names, LAG, HALF_WIDTH)
    lag_inside, half_inside = _inside(solution, bounds)
    at = names.index(WIDTH)
    significant = solution.parameters[at] ** 2 > _SIGNIFICANT**2 * solution.covariance[at, at]
    known = solution.covariance[-1, -1] < spacing_degC(bounds) ** 2  # an average over a grid would miss it
    at_bound = significant and known and not half_inside
    if not (half_inside and significant) and not at_bound:
        solution = averaged(problem, place, bounds, level)
    lag_s, half_width_degC = (float(one) for one in solution.parameters[-2:])
    columns = problem.model.columns(lag_s, half_width_degC)
    return HysteresisFit(
        names=names,
        parameters=solution.parameters,
        covariance=solution.covariance,
        reference_degC=shape.reference_degC,
        order=shape.order,
        unit_degC=problem.model.unit_degC(lag_s),
        play_column=columns[:, at],
        residual=readings - columns @ solution.parameters[:-2],
        chi2=place.chi2,
        dof=readings.size - len(names),
        loop_degC=problem.model.span_degC(lag_s),
        lag_determined=bool(lag_inside),
        half_width_determined=bool(half_inside and significant),
        beyond=_longer_lag(solution, bounds, lag_inside=bool(lag_inside)) or (HALF_WIDTH if at_bound else ""),
    )


def _longer_lag(solution: Solution, bounds: Bounds, *, lag_inside: bool) -> str:
    """LAG if it is known and comes out at the longest one; at the shortest one there is next to none, no harm done."""
    lag_s, std_s = float(solution.parameters[-2]), float(np.sqrt(solution.covariance[-2, -2]))
    longest = not lag_inside and lag_s + _INSIDE * std_s >= bounds.high[0] and std_s < bounds.std[0]
    return LAG if longest else ""


def _inside(solution: Solution, bounds: Bounds) -> NDArray[np.bool_]:
    """True where the readings alone keep lag and half-width away from both bounds of their search, (2,)."""
    place = solution.parameters[-2:]
    precision = 1.0 / np.diag(solution.covariance)[-2:] - 1.0 / bounds.std**2
    std = np.where(precision > 0, 1.0 / np.sqrt(np.where(precision > 0, precision, 1.0)), np.inf)
    return np.asarray((place - _INSIDE * std > bounds.low) & (place + _INSIDE * std < bounds.high))
