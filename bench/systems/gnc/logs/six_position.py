"""Six positions and one turn about each axis from an imported log, as hand-held calibrations take them.

Source: GNC-module paper equation (2) with its column of ones; Ferraris, Grimaldi and Parvis 1995 (turns from rest).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimates,
    Evidence,
    Floats,
    Material,
    Table,
    estimate,
    no_result,
    with_uncertainty,
)
from bench.maths.arrays import rms
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.declaration import AXES, UPS
from bench.systems.gnc.estimators.earth_rate import RotationRecord, direction_of, static_means
from bench.systems.gnc.estimators.rotation_inputs import Declared
from bench.systems.gnc.estimators.rotations import fit_turns_from_rest
from bench.systems.gnc.estimators.triad import TriadFit, fit_six_position
from bench.systems.gnc.logs.log import ImuLog, imu_log, own_axes, stuck_sensors, without_lone_samples
from bench.systems.gnc.rows import STANDARD_GRAVITY_M_S2
from bench.systems.gnc.wording import refused, say

METHODS = ("least_squares",)
_QUANTITIES = {"accelerometer": ("accel_matrix", "accel_bias"), "gyro": ("gyro_matrix", "gyro_bias")}
_OF_ONE_PART = ("B-FIT-001", "B-FIT-080", "B-FIT-081", "B-FIT-082", "B-FIT-083")


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return matrix and bias of the accelerometers from the positions, of the gyros from the turns.

    Raises: FitError B-GNC-006, -007; B-FIT-001 if the positions determine no matrix.
    """
    log = imu_log(material)
    positions = [stretch for stretch in log.segments if stretch.get("item") == "position"]
    rotations = [stretch for stretch in log.segments if stretch.get("item") == "rotation"]
    if not positions:
        raise FitError(
            "B-GNC-007",
            "the mapping names no stretch of the log in which an axis points up",
            next_step="name them under 'segments' (docs/importing.md)",
        )
    at = {"accelerometer": positions} | ({} if log.gyro is None else {"gyro": [*positions, *rotations]})
    log, lone, evidence = without_lone_samples(log, dict.fromkeys(at, positions), _QUANTITIES)
    accelerometer = _accelerometer(log, positions)
    missing = [say("missing.stretch", up=up) for up in UPS if up not in {stretch["up"] for stretch in positions}]
    gyro = _gyro(log, positions, rotations, missing) if rotations else None
    unit = "g" if log.accel_unit == "g" else "m/s2"
    estimates = _estimates(accelerometer, "accel", "accelerometer", unit, log.accel_unit)
    if gyro is not None:
        estimates += _estimates(gyro, "gyro", "gyro", "deg/s", log.gyro_unit)
    return Analysis(
        "imu_six_position",
        method,
        material.campaign["uut"],
        estimates,
        notes=[
            *no_result(missing),
            *lone,
            say("log.six_uncertainty"),
            say("log.six_turns"),
        ],
        missing=missing,
        tables=_tables(accelerometer, gyro, unit),
        evidence=[*evidence, *_evidence(log, at, accelerometer, gyro)],
    )


def _evidence(
    log: ImuLog, at: Mapping[str, Sequence[Document]], accelerometer: TriadFit, gyro: TriadFit | None
) -> list[Evidence]:
    stretches = {kind: [log.of(kind)[log.rows(stretch)] for stretch in segments] for kind, segments in at.items()}
    found = own_axes("accel", accelerometer) + ([] if gyro is None else own_axes("gyro", gyro))
    return [*found, *stuck_sensors(stretches, _QUANTITIES)]


def _accelerometer(log: ImuLog, positions: list[Document]) -> TriadFit:
    means = np.stack([log.accel[log.rows(stretch)].mean(axis=0) for stretch in positions])
    size = log.gravity / STANDARD_GRAVITY_M_S2 if log.accel_unit == "g" else log.gravity
    force = np.stack([size * direction_of(str(stretch["up"])) for stretch in positions])
    return fit_six_position(means, force)


def _gyro(log: ImuLog, positions: list[Document], rotations: list[Document], missing: list[str]) -> TriadFit | None:
    if log.gyro is None:
        missing.append(say("missing.no_gyros"))
        return None
    rest = [log.gyro[log.rows(stretch)] for stretch in positions]
    try:
        means, covariances, _ = static_means(rest, log.rate_Hz)
        counts = np.array([len(stretch) for stretch in rest], np.float64)
        share = counts / counts.sum()
        mean = share @ means
        density = np.tensordot(share, covariances * counts[:, None, None], axes=1) / log.rate_Hz
        covariance = density * log.rate_Hz / counts.sum()
        records = [_record(log, log.gyro, stretch) for stretch in rotations]
        return fit_turns_from_rest(records, mean, covariance, density, Declared())
    except FitError as error:
        if error.code not in _OF_ONE_PART:
            raise
        missing.append(refused(say("triad.gyro"), error.message, error.code))
        return None


def _record(log: ImuLog, gyro: Floats, segment: Document) -> RotationRecord:
    rows = log.rows(segment)
    numbers = np.arange(rows.start, rows.stop, dtype=np.int64)
    time_s = log.t_s[rows] - log.t_s[rows.start]
    return RotationRecord(str(segment["axis"]), float(segment["turn_deg"]), numbers, time_s, gyro[rows])


def _estimates(fit: TriadFit, prefix: str, kind: str, unit: str, read: str) -> Estimates:
    """Return matrix (true input per indicated) and bias; unit of the matrix: 1 where both are the same."""
    per = "1" if unit == read else f"{unit}/{'count' if read == '1' else read}"
    entries: Estimates = []
    count = len(fit.residual)
    for row, name in enumerate(AXES):
        for column, other in enumerate(AXES):
            place = {"kind": kind, "row": name, "column": other}
            value, std = fit.matrix[row, column], fit.matrix_std[row, column]
            entries.append(estimate(f"{prefix}_matrix", per, value, std, place, n=count, dof=fit.dof))
        about = {"kind": kind, "axis": name}
        entries.append(estimate(f"{prefix}_bias", unit, fit.bias[row], fit.bias_std[row], about, n=count, dof=fit.dof))
    return entries


def _tables(accelerometer: TriadFit, gyro: TriadFit | None, unit: str) -> list[Table]:
    tables = []
    for title, fit, bias_unit in (
        (say("matrix.accel"), accelerometer, unit),
        (say("matrix.gyro"), gyro, "deg/s"),
    ):
        if fit is not None:
            reach = coverage_factor(fit.dof) * fit.bias_std
            rows = [
                [axis, *(f"{value:.6f}" for value in fit.matrix[k]), with_uncertainty(fit.bias[k], reach[k])]
                for k, axis in enumerate(AXES)
            ]
            key = "log.six.residual" if fit.residual_dof else "log.six.no_residual"
            caption = say(key, rms=rms(fit.residual), unit=bias_unit)
            bias = say("matrix.head.bias", unit=bias_unit)
            headers = [say("head.axis"), *(f"K {axis}" for axis in AXES), bias]
            tables.append(Table(title, caption, headers, rows, lead=True))
    return tables
