"""Plain readings: how well they repeat, and the polynomials that the sequence asks for.

The means of all values and their verdicts are made for every analysis alike (``bench.analysis``).

Source: JCGM 100:2008 section 4.2 (pooled scatter); docs/decisions/0031.

Of the fits that a sequence asks for: what speaks against them, tables, figures.

What plain readings will show of their repeatability, where their scatter is declared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.analysis import (
    Analysis,
    Estimate,
    Estimates,
    Evidence,
    Figure,
    Material,
    Planned,
    Prediction,
    Table,
    Value,
    estimate,
    evidence_of,
    foreseen_material,
    number,
    series,
    significant,
    unit_text,
    unseen_tables,
    value_and_uncertainty,
    values_of,
)
from bench.maths.variances import of_variances
from bench.model.errors import FitError
from bench.systems.readings.departures import departures_of_fit
from bench.systems.readings.fits import NONLINEARITY, Fitted, estimates_of, fits_of
from bench.systems.readings.wording import say

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
        Figure(say("fit.departure_title", title=fit.title), say("fit.departure"), x_label,
               say("fit.departure_axis", unit=unit), [left], fit.title),
    ]  # fmt: skip


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
