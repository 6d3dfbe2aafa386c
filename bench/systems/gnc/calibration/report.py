"""Report of a calibration of accelerometers and gyros: figures, tables, its conditions in sentences, and the
recordings of the rotations as the paper files them: X+1080 and X-1080, trimmed to equal length.

Positions and rotations of a calibration: the first of each makes the calibration, the second one checks it; what was
fitted to them, and why the rest was not.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import StringIO
from typing import TypeVar

import numpy as np

from bench.analysis import Figure, Floats, Table, curve, no_result, with_uncertainty, worded_figure
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.model.lab import folder_name
from bench.systems.gnc.estimators.clocks import UnitClock
from bench.systems.gnc.estimators.earth_rate import RestNoise, RotationRecord, rest_dof, static_means, up_in_body
from bench.systems.gnc.estimators.rotations import RotationFit
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.estimators.triad import TriadFit, fit_six_position, rows_of_positions, spread_out
from bench.systems.gnc.rows import AXES, SampledRow, temperature_span
from bench.systems.gnc.wording import say

Key = TypeVar("Key")
UPS = tuple(f"{sign}{axis}" for axis in AXES for sign in "+-")
TURNS = tuple((axis, sign) for axis in AXES for sign in (1, -1))
_ALONG = 0.999  # cosine between the axis that is said to be up and the one that is
WARM_degC = 0.5  # over the records of a set; sensors of this class drift by some 30 ppm and 3 deg/h per degree
_HEAD = "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"


@dataclass
class Sets:
    """Records by what they show: ``positions`` by "+x" ..., ``rotations`` by ("x", 1) ..., the same for the check.

    ``surplus``: records of a third time and later, which nothing uses.
    """

    positions: dict[str, SampledRow] = field(default_factory=dict)
    rotations: dict[tuple[str, int], SampledRow] = field(default_factory=dict)
    check_positions: dict[str, SampledRow] = field(default_factory=dict)
    check_rotations: dict[tuple[str, int], SampledRow] = field(default_factory=dict)
    surplus: int = 0


def sets_of(rows: Sequence[SampledRow]) -> Sets:
    """Sort the records of a session. Raises: FitError B-GNC-004 for one whose conditions do not say what it shows."""
    sets = Sets()
    for row in rows:
        if row.item == "position":
            _put(sets, row, _up(row), sets.positions, sets.check_positions)
        elif row.item == "rotation":
            _put(sets, row, _turn(row), sets.rotations, sets.check_rotations)
    return sets


def _put(sets: Sets, row: SampledRow, key: Key, first: dict[Key, SampledRow], second: dict[Key, SampledRow]) -> None:
    if key not in first:
        first[key] = row
    elif key not in second:
        second[key] = row
    else:
        sets.surplus += 1


def _up(row: SampledRow) -> str:
    """Return the axis that points up, by the conditions; the pose must say the same."""
    up = str(row.conditions.get("up", ""))
    if up not in UPS:
        raise _unclear(row, f"'up' is {up!r}, one of {', '.join(UPS)} is due")
    direction = np.zeros(3)
    direction[AXES.index(up[1])] = 1.0 if up[0] == "+" else -1.0
    seen = up_in_body(row.pose)
    if float(seen @ direction) < _ALONG:
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


def rotation_record(row: SampledRow, clock_error: float = 0.0, rate: Floats | None = None) -> RotationRecord:
    """A rotation as the fit takes it, in seconds of the bench: ``clock_error`` is that of the unit's clock, relative.

    ``rate`` replaces the indicated rates, for the check of the compensation.
    """
    return RotationRecord(
        axis=str(row.conditions["axis"]),
        turn_deg=float(row.conditions["turn_deg"]),
        counter=row.samples.counter,
        time_s=row.time_s / (1.0 + clock_error),
        rate=row.values("gyro") if rate is None else rate,
        pose=row.pose,
        turned=str(row.conditions.get("turned", "inner")),
        begin_s=row.begin_s,
    )


def position_fit(
    rows: Sequence[SampledRow],
    gravity: float,
    resolution_g: float,
    calibration: TriadFit | None = None,
    *,
    tilt_std_deg: float = 0.0,
    one_power_on: bool = True,
    noise: SensorNoise | None = None,
) -> TriadFit:
    """Fit of the accelerometers to records at rest, after compensation by ``calibration`` if there is one.

    The bias changes with each power-on: if the records are of more than ``one_power_on``, the noise inside of them does
    not say how well they agree, and the intervals come from the residuals alone. ``noise``: of records that hold none.

    Raises: FitError B-FIT-001 (too few poses), B-FIT-083 (records too short), B-GNC-004.
    """
    outputs = [row.values("accelerometer") for row in rows]
    if calibration is not None:
        outputs = [calibration.apply(output, bias_sign=1) for output in outputs]
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
    rows: Sequence[SampledRow], outputs: Sequence[Floats], noise: SensorNoise
) -> tuple[Floats, Floats, float]:
    """Return the same as ``static_means``, of noise that is declared; its wandering is common to several records."""
    counts = [len(output) for output in outputs]
    rest = RestNoise(noise.density / noise.interval_s * np.eye(3), np.full(3, noise.sample_std), np.zeros(3))
    wander = noise.wander_about_mean(np.array([row.begin_s for row in rows]), noise.interval_s * np.array(counts))
    covariance = spread_out(rest.of_means(counts, noise.step)) + np.kron(wander, np.eye(3))
    return np.stack([output.mean(axis=0) for output in outputs]), covariance, rest_dof(counts, 1.0 / noise.interval_s)


@dataclass
class Calibration:
    """Fits of both triads, and why the rest was not. ``power_on``: its number by the number of the record."""

    sets: Sets
    clock: UnitClock
    power_on: Mapping[int, int]
    tilt_deg: float = 0.0
    accelerometer: TriadFit | None = None
    gyro: RotationFit | None = None
    accelerometer_check: TriadFit | None = None
    gyro_check: RotationFit | None = None
    missing: list[str] = field(default_factory=list)
    refused: list[FitError] = field(default_factory=list)

    def one_power_on(self, rows: Collection[SampledRow]) -> bool:
        """Return whether the unit was not switched off between these records."""
        return len({self.power_on[row.number] for row in rows}) <= 1


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
    headers = [say("head.axis"), *(f"K {axis}" for axis in AXES), *errors, *couplings]
    return Table(title, say("matrix.caption"), headers, rows, lead=True)


def position_figure(calibration: Calibration) -> list[Figure]:
    """Return residuals of the positions."""
    fit = calibration.accelerometer
    if fit is None:
        return []
    places = np.arange(1, len(fit.residual) + 1, dtype=np.float64)
    series = [curve(axis, places, 1e6 * fit.residual[:, number], "points") for number, axis in enumerate(AXES)]
    order = ", ".join(calibration.sets.positions).replace("-", "−")
    return [worded_figure(say, "positions", ("positions.x", "positions.y"), series, order=order)]


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
    tilt_deg = calibration.tilt_deg
    return [*notes, say("note.tilt", tilt=60.0 * tilt_deg) if tilt_deg else say("note.no_tilt")]


def _of_the_turns(fit: RotationFit, calibration: Calibration) -> list[str]:
    clock = calibration.clock
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
