"""Tables and figures of the fits."""

from __future__ import annotations

import numpy as np

from bench.analysis import Figure, Table, number, series, significant, unit_text, value_and_uncertainty
from bench.systems.readings.fits import NONLINEARITY, Fitted, powers_text
from bench.systems.readings.wording import say

_CURVE_POINTS = 121
_HEADERS = ("against", "measured", "fitted", "departure", "u_departure", "n")


def fit_table(fit: Fitted) -> Table:
    """Return the points of a fit, and by how much each departs from the polynomial."""
    curve, asked = fit.curve, fit.asked
    headers = [say(f"fit.head.{name}") for name in _HEADERS]
    if curve is None:
        return Table(fit.title, say("fit.none", why=fit.refused), headers, [])
    departure, departure_std = fit.departures
    columns = (fit.x.mean, fit.y.mean, fit.y.mean - departure, departure, departure_std, fit.y.n)
    rows = [_row(*row) for row in zip(*columns, strict=True)]
    name = _name_of_x(fit)
    told = {
        "of": asked["of"],
        "unit": unit_text(asked["units"][NONLINEARITY]),
        "against": name,
        "against_unit": unit_text(asked["against"]["unit"]),
        "polynomial": _polynomial_text(fit, name),
        "chi2": curve.chi2,
        "dof": curve.dof,
    }
    lack = not np.isnan(curve.lack)
    caption = say("fit.caption_lack", lack=curve.lack, **told) if lack else say("fit.caption", **told)
    return Table(fit.title, caption, headers, rows)


def _row(against: float, measured: float, fitted: float, departure: float, std: float, n: int) -> list[object]:
    """Return a point: what it departs by and what it is of have the digits that the uncertainty has."""
    shown = [value_and_uncertainty(float(value), float(std))[0] for value in (measured, fitted, departure)]
    return [number(float(against)), *shown, significant(float(std)), int(n)]


def fit_figures(fit: Fitted) -> list[Figure]:
    """Return the points with their polynomial, and what it leaves with 95 % intervals."""
    if fit.curve is None:
        return []
    asked, x = fit.asked, fit.x.mean
    x_label = say("fit.axis", name=_name_of_x(fit), unit=unit_text(asked["against"]["unit"]))
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


def _name_of_x(fit: Fitted) -> str:
    against = fit.asked["against"]
    return against.get("quantity") or against.get("condition") or say("fit.time")


def _polynomial_text(fit: Fitted, name: str) -> str:
    """Return what was fitted; of the functions of the quantities, where there are some."""
    assert fit.curve is not None
    words = {"": "{}", "log": "log({})", "reciprocal": "1/{}"}
    functions = fit.asked.get("function", ""), fit.asked["against"].get("function", "")
    y, x = (words[function].format(of) for function, of in zip(functions, (fit.asked["of"], name), strict=True))
    powers = powers_text(fit.curve.powers)
    return say("polynomial.of", y=y, x=x, powers=powers) if any(functions) else say("polynomial", powers=powers)
