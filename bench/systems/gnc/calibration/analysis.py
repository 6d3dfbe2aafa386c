"""Calibration of the accelerometers by positions and of the gyros by turns, with the check of what the compensation
leaves.

Source: GNC-module paper section 4.2 1), equations (1) to (4) as corrected in ``estimators.triad`` and
``bench.systems.gnc.estimators.rotations``; table 3 limits the coupling after compensation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimates,
    Floats,
    Material,
    estimate,
    evidence_of,
    unseen_tables,
)
from bench.model.errors import FitError
from bench.systems.gnc.calibration.departures import implausible, searches_of
from bench.systems.gnc.calibration.report import (
    TURNS,
    UPS,
    Calibration,
    Sets,
    calibration_notes,
    matrix_table,
    position_figure,
    position_fit,
    rotation_figures,
    rotation_files,
    rotation_record,
    sets_of,
)
from bench.systems.gnc.coefficients import triad_section
from bench.systems.gnc.estimators.rotation_inputs import Declared
from bench.systems.gnc.estimators.rotations import fit_rotations
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.limits import Limits, limits_of, table_3
from bench.systems.gnc.rows import (
    AXES,
    check_notes,
    check_table,
    checked,
    clock_of,
    gravity_g,
    power_on_of,
    sampled_rows,
    site_of,
    temperature_span,
    usable,
    without_bad_samples,
)
from bench.systems.gnc.wording import refused, say

METHODS: tuple[str, ...] = ("least_squares",)
_OF_ONE_PART = ("B-FIT-001", "B-FIT-080", "B-FIT-081", "B-FIT-082", "B-FIT-083")


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return matrices, biases, scale-factor errors and couplings of both triads; what is missing is named.

    Raises: FitError B-GNC-001, -003, -004, -005; that of the fit if nothing is determined.
    """
    rows, empty = sampled_rows(material, ("position", "rotation"))
    looked_at = checked(rows, ("gyro", "accelerometer"), material.campaign)
    good, bad = usable(looked_at)
    good, odd = without_bad_samples(good, ("gyro", "accelerometer"))
    parts = Calibration(sets_of(good), clock_of(good), power_on_of(good))
    parts = calibrate(parts, material, sets_of([seen.row for seen in looked_at if seen.reason]))
    if parts.accelerometer is None and parts.gyro is None and parts.refused:
        raise parts.refused[0]
    limits = limits_of(material.campaign)
    estimates = estimates_of(parts, limits)
    searches = list(searches_of(parts, limits, estimates))
    return Analysis(
        "imu_calibration",
        method,
        material.campaign["uut"],
        estimates,
        evidence=[*implausible(parts, looked_at, limits), *evidence_of(searches)],
        notes=[*calibration_notes(parts), *odd, *check_notes(looked_at)],
        missing=[*empty, *bad, *parts.missing],
        figures=[*position_figure(parts), *rotation_figures(parts)],
        tables=[
            *matrix_table(parts),
            table_3(estimates, material.campaign),
            check_table(looked_at),
            *unseen_tables(searches),
        ],
        compensation=_compensation(parts),
        attachments=rotation_files(parts, str(material.campaign["uut"]["serial"])),
    )


def calibrate(parts: Calibration, material: Material, unusable: Sets | None = None) -> Calibration:
    """Fit what the records determine, and check it by the second set where there is one."""
    name_missing(parts, unusable)
    fit_positions(parts, material.campaign)
    fit_turns(parts, material.campaign)
    return parts


def fit_positions(parts: Calibration, campaign: Document, noise: SensorNoise | None = None) -> None:
    """Fit the accelerometers to the positions and to those of the check. ``noise``: of records that hold none."""
    sets, gravity = parts.sets, gravity_g(campaign)
    resolution = float((campaign.get("imu") or {}).get("accel_resolution_g", 0.0))
    parts.tilt_deg = site_of(campaign).tilt_std_deg
    if sets.positions:
        with _Part(parts, say("triad.accel")):
            rows = list(sets.positions.values())
            parts.accelerometer = position_fit(
                rows, gravity, resolution, tilt_std_deg=parts.tilt_deg, one_power_on=parts.one_power_on(rows),
                noise=noise,
            )  # fmt: skip
    if parts.accelerometer is not None and sets.check_positions:
        with _Part(parts, say("triad.check", triad=say("triad.accel"))):
            rows = list(sets.check_positions.values())
            parts.accelerometer_check = position_fit(
                rows, gravity, resolution, parts.accelerometer, tilt_std_deg=parts.tilt_deg,
                one_power_on=parts.one_power_on(rows), noise=noise,
            )  # fmt: skip


def fit_turns(parts: Calibration, campaign: Document, noise: SensorNoise | None = None) -> None:
    """Fit the gyros to the turns and to those of the check. ``noise``: of records that hold none."""
    sets, site, clock_error = parts.sets, site_of(campaign), parts.clock.error
    resolution = float((campaign.get("imu") or {}).get("gyro_resolution_deg_s", 0.0))
    declared = Declared(tilt_std_deg=site.tilt_std_deg, resolution_deg_s=resolution, time_std=parts.clock.std)
    if sets.rotations:
        with _Part(parts, say("triad.gyro")):
            records = [rotation_record(row, clock_error) for row in sets.rotations.values()]
            parts.gyro = fit_rotations(records, site, declared, noise)
    if parts.gyro is not None and sets.check_rotations:
        with _Part(parts, say("triad.check", triad=say("triad.gyro"))):
            triad = parts.gyro.triad
            again = [
                rotation_record(row, clock_error, compensated(triad, row.values("gyro")))
                for row in sets.check_rotations.values()
            ]
            parts.gyro_check = fit_rotations(again, site, declared, noise)


def compensated(triad: TriadFit, indicated: Floats) -> Floats:
    """Return rates after compensation, (n, 3) deg/s: w = K N - bias."""
    return triad.apply(np.asarray(indicated), bias_sign=-1)


class _Part:
    """A part of the calibration that may be refused without costing the rest; the reason is kept."""

    def __init__(self, parts: Calibration, what: str) -> None:
        self._parts, self._what = parts, what

    def __enter__(self) -> None:
        return None

    def __exit__(self, _kind: object, error: object, _trace: object) -> bool:
        if not isinstance(error, FitError) or error.code not in _OF_ONE_PART:
            return False
        self._parts.refused.append(error)
        self._parts.missing.append(refused(self._what, error.message, error.code))
        return True


def name_missing(parts: Calibration, unusable: Sets | None = None) -> None:
    """Add a sentence for each record that a calibration and its check need and that is not there.

    ``unusable``: records that have one already.
    """
    sets, told = parts.sets, unusable or Sets()
    parts.missing += [say("missing.position", up=up) for up in UPS if up not in {*sets.positions, *told.positions}]
    parts.missing += [
        say("missing.rotation", axis=axis.upper(), sign="+" if sign > 0 else "-")
        for axis, sign in TURNS
        if (axis, sign) not in {*sets.rotations, *told.rotations}
    ]
    if not sets.check_positions:
        parts.missing.append(say("missing.check_positions"))
    if not sets.check_rotations:
        parts.missing.append(say("missing.check_rotations"))


def estimates_of(parts: Calibration, limits: Limits) -> Estimates:
    """Return the estimates of what was fitted."""
    estimates: Estimates = []
    if parts.accelerometer is not None:
        count = sum(len(row.samples) for row in parts.sets.positions.values())
        estimates += _triad_estimates(parts.accelerometer, _ACCELEROMETER, count)
        if parts.accelerometer_check is not None:
            both = parts.accelerometer_check, parts.accelerometer
            estimates += _checked(*both, _ACCELEROMETER, limits)
    if parts.gyro is not None:
        estimates += _triad_estimates(parts.gyro.triad, _GYRO, sum(parts.gyro.used.values()))
        if parts.gyro_check is not None:
            both = parts.gyro_check.triad, parts.gyro.triad
            estimates += _checked(*both, _GYRO, limits)
    return estimates


def _compensation(parts: Calibration) -> list[dict[str, Any]]:
    sections = []
    if parts.accelerometer is not None:
        span = temperature_span(list(parts.sets.positions.values()))
        sections.append(triad_section(_ACCELEROMETER.kind, parts.accelerometer, span))
    if parts.gyro is not None:
        span = temperature_span(list(parts.sets.rotations.values()))
        sections.append(triad_section(_GYRO.kind, parts.gyro.triad, span))
    return sections


_OF_TWO = 2.0**0.5  # from the difference of two values to their standard deviation


@dataclass(frozen=True)
class _Triad:
    """How the estimates of a triad are named. ``bias_factor``: from the unit of the fit to ``bias_unit``."""

    prefix: str
    kind: str
    bias_unit: str
    bias_factor: float


_ACCELEROMETER = _Triad("accel", "accelerometer", "g", 1.0)
_GYRO = _Triad("gyro", "gyro", "deg/h", 3600.0)


def _triad_estimates(fit: TriadFit, triad: _Triad, count: int) -> Estimates:
    """Matrix K (true input per indicated), bias, scale-factor errors and couplings of S = K^-1; none of them judged.

    Bias of gyros: w = K N - bias; of accelerometers: a = K N + bias. ``count``: samples that went into it.
    """
    entries: Estimates = []
    common: dict[str, Any] = {"n": count, "dof": fit.dof}
    for row, name in enumerate(AXES):
        for column, other in enumerate(AXES):
            place = {"kind": triad.kind, "row": name, "column": other}
            value, std = fit.matrix[row, column], fit.matrix_std[row, column]
            entries.append(estimate(f"{triad.prefix}_matrix", "1", value, std, place, **common))
    for row, name in enumerate(AXES):
        place = {"kind": triad.kind, "axis": name}
        value, std = triad.bias_factor * fit.bias[row], triad.bias_factor * fit.bias_std[row]
        entries.append(estimate(f"{triad.prefix}_bias", triad.bias_unit, value, std, place, **common))
        value, std = fit.scale_error_ppm[row], fit.scale_error_std_ppm[row]
        entries.append(estimate(f"{triad.prefix}_scale_error", "ppm", value, std, place, **common))
    return entries + _coupling(fit, triad, f"{triad.prefix}_cross_coupling", None, common)


def _checked(check: TriadFit, calibration: TriadFit, triad: _Triad, limits: Limits) -> Estimates:
    """Coupling and scale factors that an independent set of records shows after compensation, against their limits.

    The uncertainty of the coupling is that of the check; the error of the calibration itself is what is being looked
    for. The repeatability is the standard deviation of the scale factors of both sets, with the sign of the change.
    """
    count = check.residual_dof + 12
    common: dict[str, Any] = {"n": count, "dof": min(check.dof, calibration.dof)}
    entries = _coupling(
        check, triad, f"{triad.prefix}_coupling_compensated", limits[f"{triad.prefix}_cross_coupling"], common
    )
    quantity = f"{triad.prefix}_scale_repeatability"
    for row, name in enumerate(AXES):
        change = check.matrix[row, row] - 1.0
        std = np.hypot(check.matrix_std[row, row], calibration.matrix_std[row, row])
        place = {"kind": triad.kind, "axis": name}
        entries.append(
            estimate(quantity, "1", change / _OF_TWO, std / _OF_TWO, place, limit=limits[quantity], **common)
        )
    return entries


def _coupling(fit: TriadFit, triad: _Triad, quantity: str, limit: float | None, common: dict[str, Any]) -> Estimates:
    return [
        estimate(
            quantity, "1", fit.cross_coupling[row, column], fit.cross_coupling_std[row, column],
            {"kind": triad.kind, "row": AXES[row], "column": AXES[column]}, limit=limit, **common,
        )
        for row in range(3)
        for column in range(3)
        if row != column
    ]  # fmt: skip
