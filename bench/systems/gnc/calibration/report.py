"""Report of a calibration of accelerometers and gyros: figures, tables, its conditions in sentences, and the
recordings of the rotations as the paper files them: X+1080 and X-1080, trimmed to equal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO

import numpy as np

from bench.analysis import Figure, Table, curve, no_result, with_uncertainty
from bench.maths.verdict import coverage_factor
from bench.systems.gnc.calibration.sets import Calibration, rotation_record
from bench.systems.gnc.estimators.rotations import RotationFit
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.rows import AXES, SampledRow, temperature_span
from bench.systems.gnc.unit_test.report import folder_name
from bench.systems.gnc.wording import say

WARM_degC = 0.5  # over the records of a set; sensors of this class drift by some 30 ppm and 3 deg/h per degree
_HEAD = "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"


def matrix_table(calibration: Calibration) -> list[Table]:
    """Return matrix, bias, scale-factor errors and couplings of each triad, each with its expanded uncertainty."""
    tables = []
    if calibration.accelerometer is not None:
        tables.append(_triad(say("matrix.accel"), "mg", 1e3, calibration.accelerometer))
    if calibration.gyro is not None:
        tables.append(_triad(say("matrix.gyro"), "deg/h", 3600.0, calibration.gyro.triad))
    return tables


def _triad(title: str, unit: str, factor: float, fit: TriadFit) -> Table:
    rows, reach = [], coverage_factor(fit.dof)
    for number, axis in enumerate(AXES):
        matrix = [f"{value:.6f}" for value in fit.matrix[number]]
        coupling = [
            f"{1e3 * value:.4f}" if column != number else "–" for column, value in enumerate(fit.cross_coupling[number])
        ]
        bias = with_uncertainty(factor * fit.bias[number], reach * factor * fit.bias_std[number])
        scale = with_uncertainty(fit.scale_error_ppm[number], reach * fit.scale_error_std_ppm[number])
        rows.append([axis, *matrix, bias, scale, *coupling])
    couplings = [say("matrix.head.coupling", axis=axis) for axis in AXES]
    errors = say("matrix.head.bias", unit=unit), say("matrix.head.scale")
    headers = [say("matrix.head.axis"), *(f"K {axis}" for axis in AXES), *errors, *couplings]
    return Table(title, say("matrix.caption"), headers, rows, lead=True)


def position_figure(calibration: Calibration) -> list[Figure]:
    """Return residuals of the positions."""
    fit = calibration.accelerometer
    if fit is None:
        return []
    places = np.arange(1, len(fit.residual) + 1, dtype=np.float64)
    series = [curve(axis, places, 1e6 * fit.residual[:, number], "points") for number, axis in enumerate(AXES)]
    order = ", ".join(calibration.sets.positions).replace("-", "−")
    labels = say("positions.title"), say("positions.caption", order=order), say("positions.x"), say("positions.y")
    return [Figure(*labels, series)]


def rotation_figures(calibration: Calibration) -> list[Figure]:
    """Return rates of each rotation record against time, one panel per record."""
    figures = []
    for row in calibration.sets.rotations.values():
        record = rotation_record(row)
        series = [curve(axis, record.time_s, record.rate[:, number], "line") for number, axis in enumerate(AXES)]
        labels = say("turns.caption"), say("time"), say("turns.y")
        figures.append(Figure(record.name, *labels, series, group=say("turns.group")))
    return figures


def calibration_notes(calibration: Calibration) -> list[str]:
    """Return what is missing, what widened the intervals, what they do not hold."""
    notes = no_result(calibration.missing)
    gyro = None if calibration.gyro is None else calibration.gyro.triad
    for name, fit in (("accel", calibration.accelerometer), ("gyro", gyro)):
        if fit is not None and fit.inflated:
            notes.append(say("note.inflated", name=say(f"triad.{name}"), chi2=fit.chi2, dof=fit.residual_dof))
    sets = calibration.sets
    for name, rows in ((say("set.positions"), sets.positions), (say("set.rotations"), sets.rotations)):
        notes += _of_the_unit(name, list(rows.values()), calibration)
    if calibration.gyro is not None:
        notes += _of_the_turns(calibration.gyro, calibration)
    if sets.surplus:
        notes.append(say("note.surplus", count=sets.surplus))
    if calibration.accelerometer_check or calibration.gyro_check:
        notes.append(say("note.after_compensation"))
    return [*notes, _of_the_table(calibration.tilt_deg)]


def _of_the_turns(fit: RotationFit, calibration: Calibration) -> list[str]:
    clock = calibration.clock
    notes = [say("note.clock", error=1e6 * clock.error, wide=2e6 * clock.std)]
    if fit.drift_deg_s > 0.0:
        notes.append(say("note.wandering_bias", drift=3600.0 * fit.drift_deg_s))
    notes += [say("note.cut", name=name, cut=cut) for name, cut in fit.trimmed_s.items() if cut > 0.0]
    notes += [say("note.twice", name=name, count=count) for name, count in fit.duplicates.items() if count]
    return notes


def _of_the_table(tilt_deg: float) -> str:
    return say("note.tilt", tilt=60.0 * tilt_deg) if tilt_deg else say("note.no_tilt")


def _of_the_unit(name: str, rows: Sequence[SampledRow], calibration: Calibration) -> list[str]:
    """Return what the unit went through between the records of one set."""
    if not rows:
        return []
    notes = []
    if not calibration.one_power_on(rows):
        notes.append(say("note.switched_off", name=name))
    low, high = temperature_span(rows)
    if high - low > WARM_degC:
        notes.append(say("note.warming", name=name, low=low, high=high, limit=WARM_degC))
    return notes


def rotation_files(calibration: Calibration, serial: str) -> dict[str, str]:
    """Relative path to text: ``<serial>/gyro/X+1080.csv`` ...; those the fit refused are not cut and not filed."""
    if calibration.gyro is None:
        return {}
    files = {}
    for row in calibration.sets.rotations.values():
        record = rotation_record(row)
        used = calibration.gyro.used[record.name]
        first = np.concatenate([[True], np.diff(record.counter) != 0])  # samples that came twice stand there once
        table = np.column_stack([record.time_s, record.rate])[first][:used]
        files[f"{folder_name(serial)}/gyro/{record.name}.csv"] = _csv(record.counter[first][:used], table)
    return files


def _csv(
    counter: np.ndarray[tuple[int], np.dtype[np.int64]], table: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> str:
    text = StringIO()
    text.write(_HEAD + "\n")
    for number, values in zip(counter.tolist(), table.tolist(), strict=True):
        text.write(f"{number},{values[0]:.6f},{values[1]:.6g},{values[2]:.6g},{values[3]:.6g}\n")
    return text.getvalue()
