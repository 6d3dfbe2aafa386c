"""The fits that a sequence asks for: their points, estimates with verdicts, and what speaks against them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Estimates, Evidence, Floats, Specification, Value, estimate, place_of
from bench.model.errors import FitError
from bench.systems.readings.estimators.polynomial import Curve, Points, fit_polynomial

NONLINEARITY = "nonlinearity"
Asked = Mapping[str, Any]


@dataclass(frozen=True)
class Fitted:
    """One fit that was asked for, under the conditions of ``per``; ``refused`` says why there is no ``curve``."""

    asked: Asked
    conditions: Mapping[str, Any]
    x: Points
    y: Points
    curve: Curve | None
    refused: str = ""
    unstated: str = ""

    @property
    def title(self) -> str:
        """Name and conditions."""
        return f"{self.asked['name'].replace('_', ' ')}{place_of(self.conditions)}"


def fits_of(campaign: Mapping[str, Any], values: Sequence[Value]) -> list[Fitted]:
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


def _fitted(asked: Asked, conditions: Mapping[str, Any], of: Sequence[Value], values: Sequence[Value]) -> Fitted:
    pairs = [(other, value) for value in of if (other := _beside(asked["against"], value, of, values)) is not None]
    x, y = (_points([pair[side] for pair in pairs]) for side in (0, 1))
    unstated = next((value.unstated for pair in pairs for value in pair if value.unstated), "")
    try:
        return Fitted(asked, conditions, x, y, fit_polynomial(x, y, asked["degree"]), unstated=unstated)
    except FitError as error:
        return Fitted(asked, conditions, x, y, None, error.message)


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
    missing = f"{name} is a set-point, and 'against_uncertainty' is not stated, so the interval would lack its error"
    unstated = "" if stated is not None else missing
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
    """Return the coefficients and the largest departure of the points from the polynomial, each with its verdict."""
    if fit.curve is None:
        return []
    std = np.sqrt(np.diag(fit.curve.covariance))
    found = {f"c{order}": (float(value), float(std[order])) for order, value in enumerate(fit.curve.coefficients)}
    worst = int(np.argmax(np.abs(fit.curve.departure)))
    found[NONLINEARITY] = abs(float(fit.curve.departure[worst])), float(fit.curve.departure_std[worst])
    units, count = fit.asked["units"], fit.x.mean.size
    return [
        estimate(
            f"{fit.asked['name']}_{result}", units[result], value, of_it, fit.conditions, n=count,
            limit=_limits(fit.asked["expected"].get(result)),
        )
        for result, (value, of_it) in found.items()
    ]  # fmt: skip


def _limits(expected: Mapping[str, float] | None) -> tuple[float, float] | None:
    return None if not expected else (expected.get("low", -math.inf), expected.get("high", math.inf))


def evidence_of(fit: Fitted) -> Iterator[Evidence]:
    """Yield what speaks against a fit: an uncertainty that nothing states, and a curve that the points do not follow.

    A fit whose departure is judged says how far the points are from it; its coefficients are those of the best
    polynomial then, and a lack of fit is the result and no doubt.
    """
    if fit.curve is None:
        return
    name = fit.asked["name"]
    coefficients = [f"{name}_c{order}" for order in range(fit.asked["degree"] + 1)]
    if fit.unstated:
        sentence = f"{fit.title}: {fit.unstated}"
        every = [*coefficients, f"{name}_{NONLINEARITY}"]
        yield Evidence("no_specification", sentence, None, 0.0, quantities=every, conditions=fit.conditions)
    if not math.isnan(fit.curve.lack) and NONLINEARITY not in fit.asked["expected"]:
        move = math.inf if math.isnan(fit.curve.rival) else fit.curve.rival
        sentence = (
            f"{fit.title}: the points leave a polynomial of degree {fit.asked['degree']} by more than their scatter; "
            f"one degree more moves the curve by {move:.2g} of its expanded uncertainty"
        )
        yield Evidence(
            "lack_of_fit", sentence, move, fit.curve.lack, move, quantities=coefficients, conditions=fit.conditions
        )
