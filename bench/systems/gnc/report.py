"""Figures and tables of a calibration of accelerometers and gyros."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis.numbers import with_uncertainty
from bench.systems.gnc.rows import AXES, Floats
from bench.systems.gnc.sets import rotation_record

if TYPE_CHECKING:
    from bench.systems.gnc.calibration.fitted import Calibration
    from bench.systems.gnc.estimators.triad import TriadFit

Documents = list[dict[str, Any]]
DRAWN = 600  # points of a curve


def matrix_table(found: Calibration) -> Documents:
    """Matrix, bias, scale-factor errors and couplings of each triad, each with its expanded uncertainty."""
    tables = []
    if found.accelerometer is not None:
        tables.append(_triad("Accelerometers: a = K N + bias", "mg", 1e3, found.accelerometer))
    if found.gyro is not None:
        tables.append(_triad("Gyros: w = K N - bias", "deg/h", 3600.0, found.gyro.triad))
    return tables


def _triad(title: str, unit: str, factor: float, fit: TriadFit) -> dict[str, Any]:
    rows = []
    for number, axis in enumerate(AXES):
        matrix = [f"{value:.6f}" for value in fit.matrix[number]]
        coupling = [
            f"{1e3 * value:.4f}" if column != number else "–" for column, value in enumerate(fit.cross_coupling[number])
        ]
        bias = with_uncertainty(factor * fit.bias[number], 2 * factor * fit.bias_std[number])
        scale = with_uncertainty(fit.scale_error_ppm[number], 2 * fit.scale_error_std_ppm[number])
        rows.append([axis, *matrix, bias, scale, *coupling])
    couplings = [f"coupling from {axis}, 1e-3" for axis in AXES]
    caption = (
        "K: true input per indicated; rows are sensors, columns axes. Scale-factor error and coupling are those of the "
        "sensor itself, before compensation; intervals of two standard uncertainties."
    )
    headers = ["axis", *(f"K {axis}" for axis in AXES), f"bias, {unit}", "scale-factor error, ppm", *couplings]
    return {"title": title, "caption": caption, "headers": headers, "rows": rows, "lead": True}


def position_figure(found: Calibration) -> Documents:
    """Residuals of the positions."""
    fit = found.accelerometer
    if fit is None:
        return []
    places = np.arange(1, len(fit.residual) + 1, dtype=np.float64)
    series = [curve(axis, places, 1e6 * fit.residual[:, number], "points") for number, axis in enumerate(AXES)]
    order = ", ".join(found.sets.positions)
    return [
        {
            "title": "Residuals of the positions",
            "caption": f"Up, in this order: {order}.",
            "x_label": "position",
            "y_label": "residual, ug",
            "series": series,
        }
    ]


def rotation_figures(found: Calibration) -> Documents:
    """Rates of each rotation record against time, one panel per record."""
    figures = []
    for row in found.sets.rotations.values():
        record = rotation_record(row)
        series = [curve(axis, record.time_s, record.rate[:, number], "line") for number, axis in enumerate(AXES)]
        figures.append(
            {
                "title": record.name,
                "caption": "Indicated rates while the table turns each axis forth and back.",
                "x_label": "time, s",
                "y_label": "rate, deg/s",
                "series": series,
                "group": "rotations",
            }
        )
    return figures


def curve(label: str, x: Floats, y: Floats, style: str) -> dict[str, Any]:
    """A series of a figure, thinned to what can be seen."""
    step = max(1, len(x) // DRAWN)
    return {"label": label, "x": x[::step].tolist(), "y": y[::step].tolist(), "style": style}
