"""Report of a calibration of accelerometers and gyros: figures, tables, its conditions in sentences, and the
recordings of the rotations as the paper files them: X+1080 and X-1080, trimmed to equal length.

Positions and rotations of a calibration: the first of each makes the calibration, the second one checks it; what was
fitted to them, and why the rest was not.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import StringIO

import numpy as np

from bench.analysis import Figure, Floats, Table, curve, no_result, with_uncertainty, worded_figure
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.model.lab import folder_name
from bench.systems.gnc.declaration import ACCELEROMETER, AXES, CALIBRATED, GYRO, UPS, Sensor, Shown
from bench.systems.gnc.estimators.clocks import UnitClock
from bench.systems.gnc.estimators.earth_rate import (
    RestNoise,
    RotationRecord,
    direction_of,
    rest_dof,
    static_means,
    up_in_body,
)
from bench.systems.gnc.estimators.rotations import RotationFit
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.estimators.triad import TriadFit, fit_six_position, rows_of_positions, spread_out
from bench.systems.gnc.rows import SampledRow, temperature_span
from bench.systems.gnc.wording import say

Records = Mapping[str, list[dict[Shown, SampledRow]]]  # by item, of each set
_ALONG = 0.999  # cosine between the axis that is said to be up and the one that is
WARM_degC = 0.5  # over the records of a set; sensors of this class drift by some 30 ppm and 3 deg/h per degree
_HEAD = "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"


def sets_of(rows: Sequence[SampledRow]) -> Records:
    """Return the records of each item by what they show: first set, check, and what nothing uses.

    Raises: FitError B-GNC-004 for a record whose conditions do not say what it shows.
    """
    records: Records = {sensor.item: [{}, {}] for sensor in CALIBRATED}
    for row in rows:
        shown: Shown = _up(row) if row.item == ACCELEROMETER.item else _turn(row)
        sets = records[row.item]
        if all(shown in of_set for of_set in sets):
            sets.append({})
        next(of_set for of_set in sets if shown not in of_set)[shown] = row
    return records


def _up(row: SampledRow) -> str:
    """Return the axis that points up, by the conditions; the pose must say the same."""
    up = str(row.conditions.get("up", ""))
    if up not in UPS:
        raise _unclear(row, f"'up' is {up!r}, one of {', '.join(UPS)} is due")
    seen = up_in_body(row.pose)
    if float(seen @ direction_of(up)) < _ALONG:
        text = ", ".join(f"{part:+.3f}" for part in seen)
        raise _unclear(row, f"'up' is {up!r}, but in its pose up is ({text}) in body axes")
    return up


def _turn(row: SampledRow) -> tuple[str, int]:
    axis, turn = str(row.conditions.get("axis", "")), row.conditions.get("turn_deg")
    if axis not in AXES or not isinstance(turn, int | float) or not turn:
        raise _unclear(row, f"'axis' is {axis!r} and 'turn_deg' {turn!r}: x, y or z and a signed angle are due")
    return axis, 1 if turn > 0 else -1


def _unclear(row: SampledRow, why: str) -> FitError:
    return FitError(
        "B-GNC-004",
        why,
        where=f"record {row.number}",
        next_step="correct the conditions of the record in the sequence",
    )


def rotation_record(row: SampledRow, rate: Floats, clock_error: float = 0.0) -> RotationRecord:
    """A rotation as the fit takes it, in seconds of the bench: ``clock_error`` is that of the unit's clock, relative.

    ``rate``: indicated, or after compensation for the check of it.
    """
    return RotationRecord(
        axis=str(row.conditions["axis"]),
        turn_deg=float(row.conditions["turn_deg"]),
        counter=row.samples.counter,
        time_s=row.time_s / (1.0 + clock_error),
        rate=rate,
        pose=row.pose,
        turned=str(row.conditions.get("turned", "inner")),
        begin_s=row.begin_s,
    )


def position_fit(
    rows: Sequence[SampledRow],
    outputs: list[Floats],
    gravity: float,
    resolution_g: float,
    *,
    tilt_std_deg: float = 0.0,
    one_power_on: bool = True,
    noise: SensorNoise | None = None,
) -> TriadFit:
    """Fit of the accelerometers to their outputs in records at rest, as indicated or after compensation.

    The bias changes with each power-on: if the records are of more than ``one_power_on``, the noise inside of them does
    not say how well they agree, and the intervals come from the residuals alone. ``noise``: of records that hold none.

    Raises: FitError B-FIT-001 (too few poses), B-FIT-083 (records too short), B-GNC-004.
    """
    if noise is None:
        means, covariance, dof = static_means(outputs, rows[0].rate_Hz, resolution=resolution_g)
    else:
        means, covariance, dof = _declared_means(rows, outputs, noise)
    force = gravity * np.stack([up_in_body(row.pose) for row in rows])
    if one_power_on:
        fit = fit_six_position(means, force, covariance, tilt_std_deg=tilt_std_deg)
        fit = replace(fit, dof=min(fit.dof, dof))
    else:
        fit = fit_six_position(means, force)
    return replace(fit, rows=rows_of_positions(fit, means, force, covariance, tilt_std_deg, dof))


def _declared_means(
    rows: Sequence[SampledRow], outputs: list[Floats], noise: SensorNoise
) -> tuple[Floats, Floats, float]:
    """Return the same as ``static_means``, of noise that is declared; its wandering is common to several records."""
    counts = [len(output) for output in outputs]
    rest = RestNoise(noise.density / noise.interval_s * np.eye(3), np.full(3, noise.sample_std), np.zeros(3))
    wander = noise.wander_about_mean(np.array([row.begin_s for row in rows]), noise.interval_s * np.array(counts))
    covariance = spread_out(rest.of_means(counts, noise.step)) + np.kron(wander, np.eye(3))
    return np.stack([output.mean(axis=0) for output in outputs]), covariance, rest_dof(counts, 1.0 / noise.interval_s)


@dataclass
class Calibration:
    """Records and fits, and why the rest was not fitted. ``power_on``: its number by the number of the record.

    ``fits``: of a kind, by prefix: calibration and check.   ``turns``: what the first fit of the gyros was made of.
    """

    records: Records
    clock: UnitClock
    power_on: Mapping[int, int]
    turns: RotationFit | None = None
    fits: Mapping[str, list[TriadFit]] = field(default_factory=lambda: {sensor.prefix: [] for sensor in CALIBRATED})
    missing: list[str] = field(default_factory=list)
    refused: list[FitError] = field(default_factory=list)

    def first(self, sensor: Sensor) -> list[SampledRow]:
        """Return the records that the calibration of a kind of sensor is made of."""
        return list(self.records[sensor.item][0].values())

    def calibrated(self) -> Iterator[tuple[Sensor, TriadFit]]:
        """Yield each kind of sensor that was fitted with its calibration."""
        return ((sensor, fit) for sensor in CALIBRATED for fit in self.fits[sensor.prefix][:1])

    def one_power_on(self, rows: Collection[SampledRow]) -> bool:
        """Return whether the unit was not switched off between these records."""
        return len({self.power_on[row.number] for row in rows}) <= 1


def matrix_table(calibration: Calibration) -> list[Table]:
    """Return matrix, bias, scale-factor errors and couplings of each triad, each with its expanded uncertainty."""
    return [_triad(sensor, fit) for sensor, fit in calibration.calibrated()]


def _triad(sensor: Sensor, fit: TriadFit) -> Table:
    rows, reach, factor = [], coverage_factor(fit.dof), sensor.small
    for number, axis in enumerate(AXES):
        matrix = [f"{value:.6f}" for value in fit.matrix[number]]
        coupling = [
            f"{1e3 * value:.4f}" if column != number else "–" for column, value in enumerate(fit.cross_coupling[number])
        ]
        bias = with_uncertainty(factor * fit.bias[number], reach * factor * fit.bias_std[number])
        scale = with_uncertainty(fit.scale_error_ppm[number], reach * fit.scale_error_std_ppm[number])
        rows.append([axis, *matrix, bias, scale, *coupling])
    couplings = [say("matrix.head.coupling", axis=axis) for axis in AXES]
    errors = say("matrix.head.bias", unit=sensor.small_unit), say("matrix.head.scale")
    headers = [say("head.axis"), *(f"K {axis}" for axis in AXES), *errors, *couplings]
    return Table(say(f"matrix.{sensor.prefix}"), say("matrix.caption"), headers, rows, lead=True)


def position_figure(calibration: Calibration) -> list[Figure]:
    """Return residuals of the positions."""
    figures = []
    for fit in calibration.fits[ACCELEROMETER.prefix][:1]:
        places = np.arange(1, len(fit.residual) + 1, dtype=np.float64)
        series = [curve(axis, places, 1e6 * fit.residual[:, number], "points") for number, axis in enumerate(AXES)]
        order = ", ".join(map(str, calibration.records[ACCELEROMETER.item][0])).replace("-", "−")
        figures.append(worded_figure(say, "positions", ("positions.x", "positions.y"), series, order=order))
    return figures


def rotation_figures(calibration: Calibration) -> list[Figure]:
    """Return rates of each rotation record against time, one panel per record."""
    figures = []
    for record in _rotations(calibration):
        series = [curve(axis, record.time_s, record.rate[:, number], "line") for number, axis in enumerate(AXES)]
        labels = say("turns.caption"), say("time"), say("turns.y")
        figures.append(Figure(record.name, *labels, series, group=say("turns.group")))
    return figures


def _rotations(calibration: Calibration) -> list[RotationRecord]:
    """Return the first turns as indicated, in seconds of the unit."""
    return [rotation_record(row, row.values(GYRO.kind)) for row in calibration.first(GYRO)]


def calibration_notes(calibration: Calibration, tilt_deg: float) -> list[str]:
    """Return what is missing, what widened the intervals, what they do not hold. ``tilt_deg``: that they do hold."""
    notes = no_result(calibration.missing)
    for sensor, fit in calibration.calibrated():
        if fit.inflated:
            name = say(f"triad.{sensor.prefix}")
            notes.append(say("note.inflated", name=name, chi2=fit.chi2, dof=fit.residual_dof))
    for sensor in CALIBRATED:
        notes += _of_the_unit(say(f"set.{sensor.item}s"), calibration.first(sensor), calibration)
    if calibration.turns is not None:
        notes += _of_the_turns(calibration.turns, calibration.clock)
    surplus = sum(len(of_set) for sets in calibration.records.values() for of_set in sets[2:])
    if surplus:
        notes.append(say("note.surplus", count=surplus))
    if any(len(fits) > 1 for fits in calibration.fits.values()):
        notes.append(say("note.after_compensation"))
    return [*notes, say("note.tilt", tilt=60.0 * tilt_deg) if tilt_deg else say("note.no_tilt")]


def _of_the_turns(fit: RotationFit, clock: UnitClock) -> list[str]:
    notes = [say("note.clock", error=1e6 * clock.error, wide=2e6 * clock.std)]
    if fit.drift_deg_s > 0.0:
        notes.append(say("note.wandering_bias", drift=3600.0 * fit.drift_deg_s))
    notes += [say("note.cut", name=name, cut=cut) for name, cut in fit.trimmed_s.items() if cut > 0.0]
    notes += [say("note.twice", name=name, count=count) for name, count in fit.duplicates.items() if count]
    return notes


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
    if calibration.turns is None:
        return {}
    files = {}
    for record in _rotations(calibration):
        used = calibration.turns.used[record.name]
        first = np.concatenate([[True], np.diff(record.counter) != 0])  # samples that came twice stand there once
        table = np.column_stack([record.counter, record.time_s, record.rate])[first][:used]
        text = StringIO()
        np.savetxt(text, table, "%d,%.6f,%.6g,%.6g,%.6g", header=_HEAD, comments="")
        files[f"{folder_name(serial)}/gyro/{record.name}.csv"] = text.getvalue()
    return files
