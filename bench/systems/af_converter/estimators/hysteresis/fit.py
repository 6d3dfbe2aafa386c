"""Bias, hysteresis and thermal lag of one channel fitted together, with the full covariance; the loop of a fit.

The loop between the two ends of a ramp has a width at a temperature, curves of both branches, and crossings. The usual
comparison of a rising and a falling ramp, one polynomial each with no word about lag or play, is here so that a reader
can be shown what lag does: against the chamber's temperature the difference of the branches holds 2 rate lag dy/dT on
top of the hysteresis.
Source: docs/method-af-converter.md; JCGM 100:2008 (uncertainty of a fit); geometry of the play operator;
AF-converter paper section 4 (up and down ramp).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.maths.least_squares import solve
from bench.systems.af_converter.estimators.gates import Drive
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, Gates, HysteresisModel, Level, ModelShape
from bench.systems.af_converter.estimators.hysteresis.search import (
    Bounds,
    Problem,
    Solution,
    averaged,
    search,
    solution_at,
    spacing_degC,
)

Whiten = Callable[[Floats], Floats]
LAG, HALF_WIDTH = "thermal lag", "play half-width"
_BRANCH_ORDER = 3  # degree of the polynomial of a branch
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
    parameters: Floats
    covariance: Floats
    reference_degC: float
    order: int
    unit_degC: Floats
    play_column: Floats
    residual: Floats
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


def fit_hysteresis(
    readings: Floats,
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
    Source:  docs/method-af-converter.md; Golub and Pereyra (1973).
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
    lag_s, half_width_degC = (float(value) for value in solution.parameters[-2:])
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


def _inside(solution: Solution, bounds: Bounds) -> Flags:
    """True where the readings alone keep lag and half-width away from both bounds of their search, (2,)."""
    place = solution.parameters[-2:]
    precision = 1.0 / np.diag(solution.covariance)[-2:] - 1.0 / bounds.std**2
    std = np.where(precision > 0, 1.0 / np.sqrt(np.where(precision > 0, precision, 1.0)), np.inf)
    return (place - _INSIDE * std > bounds.low) & (place + _INSIDE * std < bounds.high)


def width_at(fit: HysteresisFit, temperature_degC: float) -> tuple[float, float]:
    """Falling minus rising branch at one temperature, with its standard uncertainty; 0 at the ends of the loop.

    After a reversal 2 r must be crossed before the play moves, so within 2 r of an end the loop is narrower.

    Args:    fit: the joint fit.   temperature_degC: lagged temperature.
    Returns: width and standard uncertainty in the unit of the readings; the covariance of width and r is in it.
    Raises:  nothing.
    Source:  width = W min(1, d / (2 r)) with d the distance from the nearer end, of a loop wider than 2 r.
    """
    weights = width_weights(fit, temperature_degC)
    width = fit.value(WIDTH) * float(weights[fit.names.index(WIDTH)])
    return width, float(np.sqrt(weights @ fit.covariance @ weights))


def width_weights(fit: HysteresisFit, temperature_degC: float) -> Floats:
    """Return how the width at a lagged temperature follows each parameter, (n,).

    Source: as for ``width_at``.
    """
    low, high = fit.loop_degC
    twice = 2.0 * fit.value(HALF_WIDTH)
    crossed = np.clip(min(temperature_degC - low, high - temperature_degC, high - low - twice) / twice, 0.0, 1.0)
    weights = np.zeros(fit.parameters.size)
    weights[fit.names.index(WIDTH)] = crossed
    if crossed < 1.0:
        weights[fit.names.index(HALF_WIDTH)] = -fit.value(WIDTH) * crossed / fit.value(HALF_WIDTH)
    return weights


def branch_curves(fit: HysteresisFit, temperature_degC: Floats) -> tuple[Floats, Floats]:
    """Rising and falling branch of the closed loop at lagged temperatures, (k,) each.

    Args:    temperature_degC: (k,).
    Raises:  nothing.
    Source:  play between the ends of the loop: P = max(T - r, low + r) rising, min(T + r, high - r) falling.
    """
    low, high = fit.loop_degC
    r = fit.value(HALF_WIDTH)
    centre = np.polynomial.polynomial.polyval(temperature_degC - fit.reference_degC, fit.parameters[: fit.order + 1])
    slope = fit.value(WIDTH) / (2.0 * r)
    rising = np.minimum(np.maximum(temperature_degC - r, low + r), temperature_degC + r)
    falling = np.maximum(np.minimum(temperature_degC + r, high - r), temperature_degC - r)
    return np.asarray(centre + slope * (rising - temperature_degC)), np.asarray(
        centre + slope * (falling - temperature_degC)
    )


def crossed_over(fit: HysteresisFit) -> Flags:
    """True for the readings in which the play follows: outside the 2 r after a reversal; (m,).

    Source: |P - T| = r where the play follows.
    """
    return np.abs(fit.play_column) > 0.5 * (1.0 - 1e-6)


def branch_difference(
    temperature_degC: Floats, readings: Floats, rising: Flags, falling: Flags, at_degC: Floats
) -> Floats:
    """Falling minus rising polynomial at temperatures; NaN outside what both branches cover.

    Args:    temperature_degC, readings: (m,).   rising, falling: (m,) masks of the branches.   at_degC: (k,).
             All readings weigh the same.
    Returns: (k,), unit of the readings; all NaN if a branch has no more readings than coefficients.
    Raises:  FitError B-FIT-001 if the temperatures of a branch do not determine its polynomial.
    Source:  see the module.
    """
    both = [(temperature_degC[mask], readings[mask]) for mask in (falling, rising)]
    if min(temperature.size for temperature, _ in both) <= _BRANCH_ORDER + 1:
        return np.full(at_degC.shape, np.nan)
    low = max(float(temperature.min()) for temperature, _ in both)
    high = min(float(temperature.max()) for temperature, _ in both)
    values = [_polynomial(temperature, y, at_degC) for temperature, y in both]
    return np.where((at_degC >= low) & (at_degC <= high), values[0] - values[1], np.nan)


def _polynomial(temperature_degC: Floats, readings: Floats, at_degC: Floats) -> Floats:
    middle, reach = float(np.mean(temperature_degC)), float(np.ptp(temperature_degC)) / 2.0 or 1.0
    basis, triangle = np.linalg.qr(np.vander((temperature_degC - middle) / reach, _BRANCH_ORDER + 1, increasing=True))
    names = [f"coefficient {k} of a branch" for k in range(_BRANCH_ORDER + 1)]
    fit = solve(triangle, basis.T @ readings, np.eye(_BRANCH_ORDER + 1), names)
    return np.asarray(np.polynomial.polynomial.polyval((at_degC - middle) / reach, fit.parameters))
