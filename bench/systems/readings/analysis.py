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
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Estimate,
    Estimates,
    Evidence,
    Figure,
    Labels,
    Material,
    Planned,
    Prediction,
    Residuals,
    Searched,
    Table,
    Value,
    Words,
    departures_of,
    estimate,
    evidence_of,
    foreseen_material,
    number,
    search,
    series,
    significant,
    unit_text,
    unseen_tables,
    value_and_uncertainty,
    values_of,
)
from bench.maths.arrays import Floats
from bench.maths.variances import of_variances
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.readings.estimators.polynomial import Points
from bench.systems.readings.fits import NONLINEARITY, Fitted, estimates_of, fits_of
from bench.systems.readings.wording import say

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
METHODS: tuple[str, ...] = ("polynomial",)


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
