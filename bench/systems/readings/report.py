"""Tables and figures of the fits."""

from __future__ import annotations

import numpy as np

from bench.analysis import Figure, Table, number, series, unit_text
from bench.systems.readings.fits import NONLINEARITY, Fitted, powers_text

_CURVE_POINTS = 121
_HEADERS = ("against", "measured", "fitted", "departure", "u of the departure", "n")


def fit_table(fit: Fitted) -> Table:
    """Return the points of a fit, and by how much each departs from the polynomial."""
    curve, asked = fit.curve, fit.asked
    if curve is None:
        return Table(fit.title, f"No fit: {fit.refused}", _HEADERS, [])
    departure, departure_std = fit.departures
    columns = (fit.x.mean, fit.y.mean, fit.y.mean - departure, departure, departure_std, fit.y.n)
    rows = [
        [*(number(float(cell)) for cell in row[:4]), f"{row[4]:.2g}", int(row[5])] for row in zip(*columns, strict=True)
    ]
    against, name = asked["against"], _name_of_x(fit)
    lack = "" if np.isnan(curve.lack) else f", by the scatter of the readings alone as probable as {curve.lack:.2g}"
    caption = (
        f"{asked['of']} in {unit_text(asked['units'][NONLINEARITY])} against {name} in {unit_text(against['unit'])}; "
        f"{_polynomial_text(fit, name)}. Departures: chi-square {curve.chi2:.3g} at {curve.dof} degrees of "
        f"freedom by scatter and floors of the instruments{lack}"
    )
    return Table(fit.title, caption, _HEADERS, rows)


def fit_figures(fit: Fitted) -> list[Figure]:
    """Return the points with their polynomial, and what it leaves with 95 % intervals."""
    if fit.curve is None:
        return []
    asked, x = fit.asked, fit.x.mean
    x_label = f"{_name_of_x(fit)} / {unit_text(asked['against']['unit'])}"
    unit = unit_text(asked["units"][NONLINEARITY])
    dense = np.linspace(float(x.min()), float(x.max()), _CURVE_POINTS)
    drawn, _ = fit.values_at(dense)
    lines = [series("polynomial", dense, drawn), series("measured", x, fit.y.mean, "points")]
    off, std = fit.departures
    reach = 2.0 * std
    left = series("departure", x, off, "points", low=off - reach, high=off + reach)
    return [
        Figure(fit.title, "Measured points and the polynomial.", x_label, f"{asked['of']} / {unit}", lines, fit.title),
        Figure(f"Departure: {fit.title}", "What the polynomial leaves, with 95 % intervals.", x_label,
               f"departure / {unit}", [left], fit.title),
    ]  # fmt: skip


def _name_of_x(fit: Fitted) -> str:
    against = fit.asked["against"]
    return str(against.get("quantity") or against.get("condition") or "time")


def _polynomial_text(fit: Fitted, name: str) -> str:
    """Return what was fitted; of the functions of the quantities, where there are some."""
    assert fit.curve is not None
    words = {"": "{}", "log": "log({})", "reciprocal": "1/{}"}
    functions = fit.asked.get("function", ""), fit.asked["against"].get("function", "")
    y, x = (words[function].format(of) for function, of in zip(functions, (fit.asked["of"], name), strict=True))
    of = f" of {y} in {x}" if any(functions) else ""
    return f"polynomial{of} {powers_text(fit.curve.powers)}"
