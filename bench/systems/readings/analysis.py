"""Plain readings: how well they repeat, and the polynomials that the sequence asks for.

The means of all values and their verdicts are made for every analysis alike (``bench.analysis``).

Source: JCGM 100:2008 section 4.2 (pooled scatter); docs/method-uncertainty.md.

Of the fits that a sequence asks for: what speaks against them, tables, figures.

What plain readings will show of their repeatability, where their scatter is declared.

One search goes for what departs from a polynomial. Rows are the means of the points with the scatter of their readings;
floors of the instruments are another error at each point, of which only the largest size is known, and one error of
all, as gains are.
Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimate,
    Estimates,
    Evidence,
    Figure,
    Floats,
    Labels,
    Material,
    Planned,
    Prediction,
    Residuals,
    Searched,
    Specification,
    Table,
    Value,
    Words,
    departures_of,
    estimate,
    evidence_of,
    foreseen_material,
    number,
    placed,
    search,
    series,
    significant,
    unit_text,
    unseen_tables,
    value_and_uncertainty,
    values_of,
)
from bench.maths.variances import of_variances
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.readings.polynomial import Curve, Function, Points, fit_polynomial, function_of
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


_HIGHER = 2  # powers beyond those of the polynomial
_PERCENT = 0.01


def departures_of_fit(fit: Fitted, entries: Sequence[Estimate], share: float) -> list[Searched]:
    """Return the search of a fit. ``entries``: its estimates.   ``share``: of the chance of a false doubt.

    There is none where a sequence judges the largest departure: that is a result then, of the best polynomial.
    """
    stated = [entry for entry in entries if entry.expanded_uncertainty and not entry.quantity.endswith(NONLINEARITY)]
    noise, dof = _noise(fit)
    if NONLINEARITY in fit.asked["expected"] or not noise.all() or not stated:
        return []
    found = search(_residuals(fit, stated, noise, dof), departures_of(_labels(fit)), share)
    return [Searched(found, _words(fit))]


def _noise(fit: Fitted) -> tuple[Floats, float]:
    """Return standard deviation of each point by scatter, (m,), at least that of all, and its degrees of freedom.

    By the floors of the instruments, where nothing scatters; 0 where nothing was read repeatedly, so that nobody knows.
    """
    assert fit.curve is not None
    x, y = fit.fitted_points
    single = np.divide(y.scatter, y.std, out=np.sqrt(y.n), where=y.std > 0.0) ** -2.0  # of independent readings
    dof = np.where(y.n > 1, 1.0 / single - 1.0, 0.0)
    if not y.std.any():
        return _floor(x, y, fit.curve.slope) * dof.any(), math.inf
    pooled = np.sqrt(np.sum(dof * np.where(dof > 0.0, y.scatter, 0.0) ** 2) / dof.sum())
    return np.hypot(np.maximum(y.std, pooled * np.sqrt(single)), fit.curve.slope * x.std), float(dof.sum())


def _floor(x: Points, y: Points, slope: Floats) -> Floats:
    return np.hypot(y.floor, slope * x.floor)


def _residuals(fit: Fitted, stated: Sequence[Estimate], noise: Floats, dof: float) -> Residuals:
    """Return the points as rows, common errors of the instruments last."""
    assert fit.curve is not None
    curve, (x, y) = fit.curve, fit.fitted_points
    held = np.column_stack([y.gain, y.floor, curve.slope * x.gain, curve.slope * x.floor])
    powers = (x.mean[:, None] / np.abs(x.mean).max()) ** np.array(curve.powers)
    operator = np.array([fit.operator_of(entry) for entry in stated])
    return Residuals.of(
        readings=y.mean,
        error=curve.departure,
        free=np.column_stack([powers, held]),
        std=np.ones(held.shape[1]),
        scatter=np.diag(_floor(x, y, curve.slope))[:, : noise.size * math.isfinite(dof)],
        whiten=lambda columns: columns / noise[:, None],
        operator=operator,
        stated=stated,
        noise=coverage_factor() * np.sqrt(operator**2 @ noise**2),
        on_curve=True,
        noise_dof=dof,
    )


def _labels(fit: Fitted) -> Labels:
    """Return the labels of the points; what departs is in the unit of y itself."""
    assert fit.curve is not None
    (x, _), slope, number = fit.fitted_points, fit.functions[1].slope(fit.y.mean), np.arange(fit.x.mean.size)
    highest = fit.curve.powers[-1] + _HIGHER
    further = [power for power in range(1, highest + 1) if power not in fit.curve.powers]
    return Labels(
        kinds={"point": number},
        hours=fit.time_s / 3600.0,
        visit=number,
        scales={"x": (x.mean / np.abs(x.mean).max(), further)},
        carriers={
            "offset": (unit_text(fit.asked["units"][NONLINEARITY]), slope),
            "gain": ("%", _PERCENT * slope * fit.y.mean),
        },
        steps_within=False,
    )


def _words(fit: Fitted) -> Words:
    """Return how a person names the labels of a fit."""
    unit = unit_text(fit.asked["against"]["unit"])

    def words(label: str, value: Any) -> str:
        if label == "point":
            return f"{fit.name_of_x} {fit.x.mean[int(value)]:g} {unit}"
        return {"offset": fit.title, "gain": say("departs.gain", title=fit.title), "x": fit.name_of_x}[label]

    return words


_CURVE_POINTS = 121
_HEADERS = ("against", "measured", "fitted", "departure", "u_departure", "n")
METHODS = ("polynomial",)


def _unstated(fit: Fitted) -> Evidence:
    """Return that the interval of a fit would lack a part."""
    every = [entry.quantity for entry in estimates_of(fit)]
    sentence = say("fit.refused", title=fit.title, why=fit.unstated)
    return Evidence("no_specification", sentence, None, 0.0, quantities=every, conditions=fit.conditions)


def powers_text(powers: Sequence[int]) -> str:
    """Return the powers of a polynomial as words."""
    if tuple(powers) == tuple(range(len(powers))):
        return say("powers.degree", degree=len(powers) - 1)
    return say("powers.list", powers=", ".join(map(str, powers)))


def fit_table(fit: Fitted) -> Table:
    """Return the points of a fit, and by how much each departs from the polynomial."""
    curve, asked = fit.curve, fit.asked
    headers = say.heads("fit", *_HEADERS)
    if curve is None:
        return Table(fit.title, say("fit.none", why=fit.refused), headers, [])
    departure, departure_std = fit.departures
    columns = (fit.x.mean, fit.y.mean, fit.y.mean - departure, departure, departure_std, fit.y.n)
    rows = [_row(*row) for row in zip(*columns, strict=True)]
    name = fit.name_of_x
    told = {
        "of": asked["of"],
        "unit": unit_text(asked["units"][NONLINEARITY]),
        "against": name,
        "against_unit": unit_text(asked["against"]["unit"]),
        "polynomial": _polynomial_text(fit, name),
        "chi2": curve.chi2,
        "dof": curve.dof,
    }
    return Table(fit.title, say("fit.caption", **told), headers, rows)


def _row(against: float, measured: float, fitted: float, departure: float, std: float, n: int) -> list[object]:
    """Return a point: what it departs by and what it is of have the digits that the uncertainty has."""
    shown = [value_and_uncertainty(float(value), float(std))[0] for value in (measured, fitted, departure)]
    return [number(float(against)), *shown, significant(float(std)), int(n)]


def fit_figures(fit: Fitted) -> list[Figure]:
    """Return the points with their polynomial, and what it leaves with 95 % intervals."""
    if fit.curve is None:
        return []
    asked, x = fit.asked, fit.x.mean
    x_label = say("fit.axis", name=fit.name_of_x, unit=unit_text(asked["against"]["unit"]))
    unit = unit_text(asked["units"][NONLINEARITY])
    dense = np.linspace(float(x.min()), float(x.max()), _CURVE_POINTS)
    drawn, _ = fit.values_at(dense)
    lines = [series(say("polynomial.series"), dense, drawn), series(say("fit.head.measured"), x, fit.y.mean, "points")]
    off, std = fit.departures
    reach = 2.0 * std
    left = series(say("fit.head.departure"), x, off, "points", low=off - reach, high=off + reach)
    return [
        Figure(fit.title, say("fit.measured"), x_label, f"{asked['of']} / {unit}", lines, fit.title),
        Figure(
            say("fit.departure_title", title=fit.title),
            say("fit.departure"),
            x_label,
            say("fit.departure_axis", unit=unit),
            [left],
            fit.title,
        ),
    ]


def _polynomial_text(fit: Fitted, name: str) -> str:
    """Return what was fitted; of the functions of the quantities, where there are some."""
    assert fit.curve is not None
    words = {"": "{}", "log": "log({})", "reciprocal": "1/{}"}
    functions = fit.asked.get("function", ""), fit.asked["against"].get("function", "")
    y, x = (words[function].format(of) for function, of in zip(functions, (fit.asked["of"], name), strict=True))
    powers = powers_text(fit.curve.powers)
    return say("polynomial.of", y=y, x=x, powers=powers) if any(functions) else say("polynomial", powers=powers)


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return repeatability of each quantity, and the fits.

    Raises: FitError B-FIT-160 if nothing was read.
    """
    values = values_of(material)
    if not values:
        cure = "look at the readings of the session: 'bench export SESSION'"
        raise FitError("B-FIT-160", "no reading of the session has a value", next_step=cure)
    fits = fits_of(material.campaign, values)
    curves = [fit for fit in fits if fit.curve is not None]
    searches = [one for fit in curves for one in departures_of_fit(fit, estimates_of(fit), 1.0 / len(curves))]
    return Analysis(
        "readings",
        method,
        dict(material.campaign.get("uut", {"model": "", "serial": ""})),
        [*repeatabilities(values), *(entry for fit in fits for entry in estimates_of(fit))],
        evidence=[*evidence_of(searches), *(_unstated(fit) for fit in curves if fit.unstated)],
        missing=[say("fit.refused", title=fit.title, why=fit.refused) for fit in fits if fit.refused],
        figures=[figure for fit in fits for figure in fit_figures(fit)],
        tables=[*map(fit_table, fits), *unseen_tables(searches)],
    )


def repeatabilities(values: Sequence[Value]) -> Estimates:
    """Return the standard deviation of one reading of each quantity, pooled over all its conditions.

    Its uncertainty and its interval are those of the root of a variance with so many degrees of freedom.
    """
    entries = []
    for name in dict.fromkeys(value.quantity for value in values):
        repeated = [value for value in values if value.quantity == name and value.n > 1]
        if repeated:
            squares = sum((value.n - 1) * value.scatter**2 for value in repeated)
            count = sum(value.n for value in repeated)
            pooled = float(np.sqrt(squares / (count - len(repeated))))
            free = sum(value.dof_a for value in repeated)
            entries.append(_repeatability(f"{name}_repeatability", repeated[0].unit, pooled, free, count))
    return entries


def _repeatability(name: str, unit: str, pooled: float, free: float, count: int) -> Estimate:
    std, half = of_variances(np.sqrt, free)
    return estimate(name, unit, pooled, std * pooled, {}, n=count, dof=free, factor=half / std)


def predicted(planned: Planned) -> Prediction:
    """Return repeatabilities with the uncertainties that so many readings of the declared scatter will give."""
    values = values_of(foreseen_material(planned)[0])
    names = ", ".join(str(fit["name"]) for fit in planned.campaign.get("fits", ()))
    return Prediction(repeatabilities(values), [say("predicted.no_fit", names=names)] if names else [])
