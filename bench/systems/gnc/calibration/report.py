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

WARM_degC = 0.5  # over the records of a set; sensors of this class drift by some 30 ppm and 3 deg/h per degree
_HEAD = "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"


def matrix_table(calibration: Calibration) -> list[Table]:
    """Return matrix, bias, scale-factor errors and couplings of each triad, each with its expanded uncertainty."""
    tables = []
    if calibration.accelerometer is not None:
        tables.append(_triad("Accelerometers: a = K N + bias", "mg", 1e3, calibration.accelerometer))
    if calibration.gyro is not None:
        tables.append(_triad("Gyros: w = K N - bias", "deg/h", 3600.0, calibration.gyro.triad))
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
    couplings = [f"coupling from {axis}, 1e-3" for axis in AXES]
    caption = (
        "K: true input per indicated; rows are sensors, columns axes. Scale-factor error and coupling are those of the "
        "sensor itself, before compensation; intervals of 95 %."
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


def calibration_notes(calibration: Calibration) -> list[str]:
    """Return what is missing, what widened the intervals, what they do not hold."""
    notes = no_result(calibration.missing)
    gyro = None if calibration.gyro is None else calibration.gyro.triad
    for name, fit in (("accelerometers", calibration.accelerometer), ("gyros", gyro)):
        if fit is not None and fit.inflated:
            notes.append(
                f"The residuals of the {name} are larger than noise and resolution explain (chi-square {fit.chi2:.0f} "
                f"with {fit.residual_dof} degrees of freedom); the intervals were widened for it. A tilt of the table "
                "from pose to pose looks like this."
            )
    for name, rows in (("positions", calibration.sets.positions), ("rotations", calibration.sets.rotations)):
        notes += _of_the_unit(name, list(rows.values()), calibration)
    if calibration.gyro is not None:
        notes += _of_the_turns(calibration.gyro, calibration)
    if calibration.sets.surplus:
        notes.append(f"{calibration.sets.surplus} records of a third time and later were not used.")
    if calibration.accelerometer_check or calibration.gyro_check:
        notes.append(
            "Coupling after compensation is what these coefficients leave, and its interval that of the second set: "
            "another calibration of the unit has other coefficients and leaves something else."
        )
    return [*notes, _of_the_table(calibration.tilt_deg)]


def _of_the_turns(fit: RotationFit, calibration: Calibration) -> list[str]:
    clock = calibration.clock
    notes = [
        f"The unit's clock is {1e6 * clock.error:+.1f} ± {2e6 * clock.std:.1f} ppm fast against the bench clock; "
        "the integrals are in seconds of the bench."
    ]
    if fit.drift_deg_s > 0.0:
        notes.append(
            f"From one rotation to the next the gyros' bias differs by {3600.0 * fit.drift_deg_s:.1f} deg/h "
            "more than noise explains (standard deviation); it is in the intervals."
        )
    cut_s = {name: cut for name, cut in fit.trimmed_s.items() if cut > 0.0}
    notes += [f"{name}: {cut:.3f} s were cut off its end, so that both directions are of equal length."
              for name, cut in cut_s.items()]  # fmt: skip
    notes += [f"{name}: {count} samples that came twice were left out."
              for name, count in fit.duplicates.items() if count]  # fmt: skip
    return notes


def _of_the_table(tilt_deg: float) -> str:
    if tilt_deg:
        return (
            f"A tilt of {60.0 * tilt_deg:.3g} arcmin (standard uncertainty, about each axis of each pose) is included; "
            "angles of turn and gravity are taken as stated."
        )
    return (
        "Angles of the table and gravity are taken as stated: their uncertainty is not included. A tilt of 1 arcmin "
        "puts the couplings off by some 200 ppm; 'tilt' of the site states it."
    )


def _of_the_unit(name: str, rows: Sequence[SampledRow], calibration: Calibration) -> list[str]:
    """Return what the unit went through between the records of one set."""
    if not rows:
        return []
    notes = []
    if not calibration.one_power_on(rows):
        notes.append(
            f"The unit was switched off between the {name}: each power-on has its own bias. Intervals were taken from "
            f"how well the {name} agree; for the best ones take all {name} again without a break."
        )
    low, high = temperature_span(rows)
    if high - low > WARM_degC:
        notes.append(
            f"The unit's temperature moved from {low:.2f} to {high:.2f} degC over the {name} (more than {WARM_degC:g} "
            "degC): bias and scale drift with it, and no interval holds that; let it warm up longer."
        )
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
