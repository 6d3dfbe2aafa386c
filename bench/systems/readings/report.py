"""Tables and figures of the fits."""

from __future__ import annotations

import numpy as np

from bench.analysis import Figure, Table, number, series, unit_text
from bench.systems.readings.fits import Fitted

_CURVE_POINTS = 121
_HEADERS = ("against", "measured", "fitted", "departure", "u of the departure", "n")


def fit_table(fit: Fitted) -> Table:
    """Return the points of a fit, and by how much each departs from the polynomial."""
    curve, asked = fit.curve, fit.asked
    if curve is None:
        return Table(fit.title, f"No fit: {fit.refused}", _HEADERS, [])
    columns = (fit.x.mean, fit.y.mean, curve.fitted, curve.departure, curve.departure_std, fit.y.n)
    rows = [
        [*(number(float(cell)) for cell in row[:4]), f"{row[4]:.2g}", int(row[5])] for row in zip(*columns, strict=True)
    ]
    against = asked["against"]
    name = against.get("quantity") or against.get("condition") or "time"
    lack = "" if np.isnan(curve.lack) else f", by the scatter of the readings alone as probable as {curve.lack:.2g}"
    caption = (
        f"{asked['of']} in {unit_text(asked['units']['c0'])} against {name} in {unit_text(against['unit'])}, "
        f"polynomial of degree {asked['degree']}. Departures: chi-square {curve.chi2:.3g} at {curve.dof} degrees of "
        f"freedom by scatter and floors of the instruments{lack}"
    )
    return Table(fit.title, caption, _HEADERS, rows)


def fit_figures(fit: Fitted) -> list[Figure]:
    """Return the points with their polynomial, and what it leaves with 95 % intervals."""
    if fit.curve is None:
        return []
    asked, x = fit.asked, fit.x.mean
    against = asked["against"]
    name = against.get("quantity") or against.get("condition") or "time"
    x_label, unit = f"{name} / {unit_text(against['unit'])}", unit_text(asked["units"]["c0"])
    dense = np.linspace(float(x.min()), float(x.max()), _CURVE_POINTS)
    drawn = np.polynomial.polynomial.polyval(dense, fit.curve.coefficients)
    lines = [series("polynomial", dense, drawn), series("measured", x, fit.y.mean, "points")]
    off, reach = fit.curve.departure, 2.0 * fit.curve.departure_std
    left = series("departure", x, off, "points", low=off - reach, high=off + reach)
    return [
        Figure(fit.title, "Measured points and the polynomial.", x_label, f"{asked['of']} / {unit}", lines, fit.title),
        Figure(f"Departure: {fit.title}", "What the polynomial leaves, with 95 % intervals.", x_label,
               f"departure / {unit}", [left], fit.title),
    ]  # fmt: skip
