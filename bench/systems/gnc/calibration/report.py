"""Figures and tables of a calibration of accelerometers and gyros."""

from __future__ import annotations

import numpy as np

from bench.analysis import Figure, Table, curve, with_uncertainty
from bench.systems.gnc.calibration.fitted import Calibration
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.rows import AXES
from bench.systems.gnc.sets import rotation_record


def matrix_table(calibration: Calibration) -> list[Table]:
    """Return matrix, bias, scale-factor errors and couplings of each triad, each with its expanded uncertainty."""
    tables = []
    if calibration.accelerometer is not None:
        tables.append(_triad("Accelerometers: a = K N + bias", "mg", 1e3, calibration.accelerometer))
    if calibration.gyro is not None:
        tables.append(_triad("Gyros: w = K N - bias", "deg/h", 3600.0, calibration.gyro.triad))
    return tables


def _triad(title: str, unit: str, factor: float, fit: TriadFit) -> Table:
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
    return Table(title, caption, headers, rows, lead=True)


def position_figure(calibration: Calibration) -> list[Figure]:
    """Return residuals of the positions."""
    fit = calibration.accelerometer
    if fit is None:
        return []
    places = np.arange(1, len(fit.residual) + 1, dtype=np.float64)
    series = [curve(axis, places, 1e6 * fit.residual[:, number], "points") for number, axis in enumerate(AXES)]
    order = ", ".join(calibration.sets.positions)
    return [Figure("Residuals of the positions", f"Up, in this order: {order}.", "position", "residual, ug", series)]


def rotation_figures(calibration: Calibration) -> list[Figure]:
    """Return rates of each rotation record against time, one panel per record."""
    figures = []
    for row in calibration.sets.rotations.values():
        record = rotation_record(row)
        series = [curve(axis, record.time_s, record.rate[:, number], "line") for number, axis in enumerate(AXES)]
        caption = "Indicated rates while the table turns each axis forth and back."
        figures.append(Figure(record.name, caption, "time, s", "rate, deg/s", series, group="rotations"))
    return figures
