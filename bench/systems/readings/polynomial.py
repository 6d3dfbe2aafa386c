"""A polynomial of one quantity against another, both measured: coefficients and departures.

Functions of a quantity that a fit may take: what a measured value becomes, and the way back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.least_squares import solve
from bench.model.errors import FitError

_TURNS = 3  # the slope at the points enters their weights; it settles at once
ZERO_K = 273.15  # of the scale in degC


@dataclass(frozen=True)
class Points:
    """Measured points, all (m,): the quantity, its mean and what makes it uncertain, as standard uncertainties.

    ``std``: of the mean by its scatter, independent.   ``scatter``: of one reading, NaN of a single one.   ``gain``: by
    a relative error, one for all points.   ``floor``: by what the specification adds, one error of all points or
    another one at each: it does not say.   ``n``: readings.
    """

    mean: Floats
    std: Floats
    scatter: Floats
    gain: Floats
    floor: Floats
    n: Floats


@dataclass(frozen=True)
class Curve:
    """A fitted polynomial, the sum of c x^k over its ``powers`` k; units follow y and the powers of x.

    ``operator``: what the coefficients gain per unit of each y.   ``slope``: of the curve at each x.
    """

    powers: tuple[int, ...]  # (p,)
    coefficients: Floats  # (p,)
    covariance: Floats  # (p, p)
    fitted: Floats  # (m,)
    departure: Floats  # (m,) y - fitted
    departure_std: Floats  # (m,)
    chi2: float
    dof: int
    operator: Floats  # (p, m)
    slope: Floats  # (m,)

    def at(self, x: Floats) -> Floats:
        """Return the polynomial at some places, (k,)."""
        return np.asarray(_columns(x, self.powers) @ self.coefficients, np.float64)

    def std_at(self, x: Floats) -> Floats:
        """Return its standard uncertainty there, (k,), by the covariance of the coefficients."""
        columns = _columns(x, self.powers)
        variance = np.einsum("kp,pq,kq->k", columns, self.covariance, columns)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), np.float64)


def fit_polynomial(x: Points, y: Points, powers: Sequence[int]) -> Curve:
    """Fit a polynomial by generalised least squares, errors of x carried over by the slope at each point.

    Args:    x, y: m points, each in its own unit.   powers: of x that the polynomial has, rising.
    Returns: Curve. The covariance of the coefficients has the scatter, widened where the departures are larger than
             scatter and floor explain, and the errors of both instruments: gains as one error each, floors both as one
             error of all points and as another at each, because a specification does not say which it is.
    Raises:  FitError B-FIT-001 if the points do not determine the polynomial.
    Source:  JCGM 100:2008 annex H.3 (calibration curve); docs/method-uncertainty.md.
    """
    powers, names = tuple(powers), [f"c{order}" for order in powers]
    if x.mean.size < len(powers):
        message = f"{x.mean.size} points do not determine {', '.join(names)}"
        raise FitError("B-FIT-001", message, next_step="read at more values, or take a lower degree")
    design, back = _design(x.mean, powers)
    slope: Floats = np.zeros(x.mean.size)
    for _ in range(_TURNS):
        weights = _independent(x, y, slope)
        fit = solve(design, y.mean, np.diag(weights), names)
        coefficients = back @ fit.parameters
        slope = _columns(x.mean, [max(order - 1, 0) for order in powers]) @ (np.array(powers) * coefficients)
    birge = max(1.0, fit.chi2 / fit.dof) if fit.dof else 1.0
    own, common = np.diag(weights), _common(x, y, slope)
    noise = birge * own + common
    operator = back @ fit.operator
    hat = design @ fit.operator
    left = np.eye(x.mean.size) - hat  # what departs is no noise of the departures
    return Curve(
        powers=powers,
        coefficients=coefficients,
        covariance=operator @ noise @ operator.T,
        fitted=y.mean - fit.residual,
        departure=fit.residual,
        departure_std=np.sqrt(np.maximum(np.diag(left @ (own + common) @ left.T), 0.0)),
        chi2=fit.chi2,
        dof=fit.dof,
        operator=operator,
        slope=slope,
    )


def _columns(x: Floats, powers: Sequence[int]) -> Floats:
    """Return powers of x, (m, p)."""
    return np.asarray(x[:, None] ** np.array(powers), np.float64)


def _design(x: Floats, powers: Sequence[int]) -> tuple[Floats, Floats]:
    """Return powers of x, scaled, (m, p), and the matrix (p, p) back to the coefficients of x itself.

    They are centred too, where no power is left out: one that is would come back by it.
    """
    middle = float(x.mean()) if tuple(powers) == tuple(range(len(powers))) else 0.0
    size = float(np.max(np.abs(x - middle))) or 1.0
    back = np.zeros((len(powers), len(powers)))
    for column, order in enumerate(powers):
        for row, power in enumerate(powers[: column + 1]):
            if middle or power == order:
                back[row, column] = math.comb(order, power) * (-middle) ** (order - power) / size**order
    return _columns((x - middle) / size, powers), back


def _independent(x: Points, y: Points, slope: Floats) -> Floats:
    """Return the variance of each point that no other point shares, (m,); equal ones where nothing is uncertain."""
    variance = y.std**2 + y.floor**2 + slope**2 * (x.std**2 + x.floor**2)
    known = variance[variance > 0.0]
    return np.where(variance > 0.0, variance, known.min() if known.size else 1.0)


def _common(x: Points, y: Points, slope: Floats) -> Floats:
    """Return the covariance that errors of the instruments bring to all points, (m, m)."""
    parts = (y.gain, y.floor, slope * x.gain, slope * x.floor)
    return np.asarray(sum(np.outer(part, part) for part in parts), np.float64)


@dataclass(frozen=True)
class Function:
    """A function of a quantity, its slope, its inverse and the slope of that; of and to arrays (m,)."""

    of: Callable[[Floats], Floats]
    slope: Callable[[Floats], Floats]
    back: Callable[[Floats], Floats]
    back_slope: Callable[[Floats], Floats]

    def points(self, points: Points) -> Points:
        """Return the function of measured points.

        Args:    points: of the quantity itself.
        Returns: mean and uncertainties of the function, each times the slope there; small against the curvature.
        Raises:  nothing.
        Source:  JCGM 100:2008 section 5.1.2 (law of propagation, first order).
        """
        slope = self.slope(points.mean)
        size = np.abs(slope)
        return replace(
            points,
            mean=self.of(points.mean),
            std=size * points.std,
            scatter=size * points.scatter,
            gain=slope * points.gain,
            floor=slope * points.floor,
        )


def function_of(name: str, unit: str) -> Function:
    """Return a function by its name: "log", "reciprocal" (of a temperature in degC in kelvin), or "" for none.

    Args:    name: of the function.   unit: of the quantity.
    Returns: Function.
    Raises:  KeyError for another name.
    Source:  docs/method-uncertainty.md.
    """
    zero = ZERO_K if unit == "degC" else 0.0
    return {
        "": Function(lambda x: x, np.ones_like, lambda y: y, np.ones_like),
        "log": Function(np.log, lambda x: 1.0 / x, np.exp, np.exp),
        "reciprocal": Function(
            lambda x: 1.0 / (x + zero), lambda x: -1.0 / (x + zero) ** 2,
            lambda y: 1.0 / y - zero, lambda y: -1.0 / y**2,
        ),
    }[name]  # fmt: skip
