"""Fits of polynomials that a sequence asks for: their points, and estimates with verdicts.

Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Document, Estimate, Estimates, Floats, Specification, Value, estimate, placed
from bench.model.errors import FitError
from bench.systems.readings.estimators.polynomial import Curve, Function, Points, fit_polynomial, function_of
from bench.systems.readings.wording import say

NONLINEARITY = "nonlinearity"
Asked = Document


@dataclass(frozen=True)
class Fitted:
    """One fit that was asked for, under the conditions of ``per``; ``refused`` says why there is no ``curve``.

    ``x``, ``y``: the quantities themselves; the curve is of their functions, if the fit names some. ``time_s``: of each
    point, (m,).
    """

    asked: Asked
    conditions: Document
    x: Points
    y: Points
    time_s: Floats
    curve: Curve | None
    refused: str = ""
    unstated: str = ""

    @property
    def functions(self) -> tuple[Function, Function]:
        """Functions of x and y."""
        return _functions(self.asked)

    @property
    def title(self) -> str:
        """Name and conditions."""
        return placed(self.asked["name"].replace("_", " "), self.conditions)

    @property
    def name_of_x(self) -> str:
        """What the points are against."""
        against = self.asked["against"]
        return str(against.get("quantity") or against.get("condition") or say("fit.time"))

    @property
    def fitted_points(self) -> tuple[Points, Points]:
        """Functions of x and y at the points."""
        of_x, of_y = self.functions
        return of_x.points(self.x), of_y.points(self.y)

    def operator_of(self, entry: Estimate) -> Floats:
        """Return what a coefficient, or a value that is read back, gains per unit of the function of each y, (m,)."""
        assert self.curve is not None
        of_x, of_y = self.functions
        for asked in self.asked.get("read_back", ()):
            if asked["quantity"] == entry.quantity:
                at = of_x.of(np.array([asked["at"]]))
                weights = at ** np.array(self.curve.powers) * of_y.back_slope(self.curve.at(at))
                return np.asarray(weights @ self.curve.operator)
        order = int(entry.quantity.rpartition("_c")[2])
        return np.asarray(self.curve.operator[self.curve.powers.index(order)])

    def values_at(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the curve at some x, and its standard uncertainty, read back as the quantity y itself, (k,)."""
        assert self.curve is not None
        of_x, of_y = self.functions
        y = self.curve.at(of_x.of(x))
        return of_y.back(y), np.abs(of_y.back_slope(y)) * self.curve.std_at(of_x.of(x))

    @property
    def departures(self) -> tuple[Floats, Floats]:
        """Departure of the points from the curve and its standard uncertainty, read back as the quantity y, (m,)."""
        assert self.curve is not None
        of_y = self.functions[1]
        measured, fitted = self.curve.fitted + self.curve.departure, self.curve.fitted
        return of_y.back(measured) - of_y.back(fitted), np.abs(of_y.back_slope(fitted)) * self.curve.departure_std


def powers_of(asked: Asked) -> tuple[int, ...]:
    """Return the powers of a fit; one with a degree has all up to it."""
    return tuple(asked["powers"] if "powers" in asked else range(asked["degree"] + 1))


def _functions(asked: Asked) -> tuple[Function, Function]:
    against = asked["against"]
    x = function_of(against.get("function", ""), against["unit"])
    return x, function_of(asked.get("function", ""), asked["units"][NONLINEARITY])


def fits_of(campaign: Document, values: Sequence[Value]) -> list[Fitted]:
    """Return all fits of a campaign, one for each set of conditions that it names under ``per``."""
    fits = []
    for asked in campaign.get("fits", ()):
        groups: dict[tuple[Any, ...], list[Value]] = {}
        for value in values:
            if value.quantity == asked["of"] and all(name in value.conditions for name in asked["per"]):
                groups.setdefault(tuple(value.conditions[name] for name in asked["per"]), []).append(value)
        for place, of in groups.items():
            fits.append(_fitted(asked, dict(zip(asked["per"], place, strict=True)), of, values))
    return fits


def _fitted(asked: Asked, conditions: Document, of: Sequence[Value], values: Sequence[Value]) -> Fitted:
    pairs = [(other, value) for value in of if (other := _beside(asked["against"], value, of, values)) is not None]
    x, y = (_points([pair[side] for pair in pairs]) for side in (0, 1))
    unstated = next((value.unstated for pair in pairs for value in pair if value.unstated), "")
    time_s = np.array([float(value.t_s.mean()) for _, value in pairs])
    of_x, of_y = _functions(asked)
    with np.errstate(all="ignore"):
        fitted_x, fitted_y = of_x.points(x), of_y.points(y)
    if not (np.isfinite(fitted_x.mean).all() and np.isfinite(fitted_y.mean).all()):
        return Fitted(asked, conditions, x, y, time_s, None, say("fit.no_function"))
    try:
        curve = fit_polynomial(fitted_x, fitted_y, powers_of(asked))
        return Fitted(asked, conditions, x, y, time_s, curve, unstated=unstated)
    except FitError as error:
        return Fitted(asked, conditions, x, y, time_s, None, error.message)


def _beside(against: Asked, value: Value, of: Sequence[Value], values: Sequence[Value]) -> Value | None:
    """Return what a value is fitted against: the other quantity under its conditions, a condition, or its time."""
    if "quantity" in against:
        named = (other for other in values if other.quantity == against["quantity"])
        return next((other for other in named if other.conditions == value.conditions), None)
    if "time" in against:
        first = min(float(other.t_s.mean()) for other in of)
        return _exact(value, float(value.t_s.mean()) - first, "time", 0.0, "")
    name = against["condition"]
    stated = against.get("uncertainty")
    unstated = "" if stated is not None else say("fit.set_point", name=name)
    known = value.conditions.get(name)
    return None if known is None else _exact(value, float(known), name, float(stated or 0.0), unstated)


def _exact(value: Value, number: float, name: str, expanded: float, unstated: str) -> Value:
    """Return a value that was not read: a set-point with its stated uncertainty, or a time."""
    specification = Specification(0.0, expanded)
    return Value(name, "", value.conditions, value.t_s[:1], np.array([number]), 0, specification, unstated)


def _points(values: Sequence[Value]) -> Points:
    def every(figure: Any) -> Floats:
        return np.array([figure(value) for value in values], dtype=np.float64)

    relative = every(lambda value: 0.0 if value.specification is None else value.specification.relative / 2.0)
    floor = every(lambda value: 0.0 if value.specification is None else value.specification.floor / 2.0)
    mean = every(lambda value: value.mean)
    return Points(
        mean=mean,
        std=every(lambda value: value.std_a),
        scatter=every(lambda value: value.scatter),
        gain=relative * mean,
        floor=floor,
        n=every(lambda value: value.n),
    )


def estimates_of(fit: Fitted) -> Estimates:
    """Return coefficients, largest departure of the points, and values that are read back, each with its verdict."""
    if fit.curve is None:
        return []
    std = np.sqrt(np.diag(fit.curve.covariance))
    coefficients = zip(fit.curve.powers, fit.curve.coefficients.tolist(), std.tolist(), strict=True)
    found = {f"c{order}": (value, of_it) for order, value, of_it in coefficients}
    departure, departure_std = fit.departures
    worst = int(np.argmax(np.abs(departure)))
    found[NONLINEARITY] = abs(float(departure[worst])), float(departure_std[worst])
    units, count = fit.asked["units"], fit.x.mean.size
    entries = [
        estimate(
            f"{fit.asked['name']}_{result}", units[result], value, of_it, fit.conditions, n=count,
            limit=_limits(fit.asked["expected"].get(result)),
        )
        for result, (value, of_it) in found.items()
    ]  # fmt: skip
    for asked in fit.asked.get("read_back", ()):
        (value,), (of_it,) = fit.values_at(np.array([asked["at"]]))
        entries.append(
            estimate(asked["quantity"], asked["unit"], value, of_it, fit.conditions, n=count, limit=_limits(asked))
        )
    return entries


def _limits(expected: Document | None) -> tuple[float, float] | None:
    if expected is None or not {"low", "high"} & expected.keys():
        return None
    return expected.get("low", -math.inf), expected.get("high", math.inf)
