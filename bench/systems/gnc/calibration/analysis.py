"""Calibration of the accelerometers by positions and of the gyros by turns, with the check of what the compensation
leaves.

Source: GNC-module paper section 4.2 1), equations (1) to (4) as corrected in ``estimators.triad`` and
``bench.systems.gnc.estimators.rotations``; table 3 limits the coupling after compensation.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimates,
    Material,
    estimate,
    evidence_of,
    unseen_tables,
)
from bench.model.errors import FitError
from bench.systems.gnc.calibration.departures import implausible, searches_of
from bench.systems.gnc.calibration.report import (
    Calibration,
    Records,
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
from bench.systems.gnc.declaration import ACCELEROMETER, AXES, CALIBRATED, GYRO, Sensor, Shown
from bench.systems.gnc.estimators.rotation_inputs import Declared
from bench.systems.gnc.estimators.rotations import fit_rotations
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.limits import Limits, limits_of, table_3
from bench.systems.gnc.rows import (
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

METHODS = ("least_squares",)
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
    name_missing(parts, sets_of([seen.row for seen in looked_at if seen.reason]))
    for sensor in CALIBRATED:
        fit_triad(parts, sensor, material.campaign)
    if not any(parts.fits.values()) and parts.refused:
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
        notes=[*calibration_notes(parts, site_of(material.campaign).tilt_std_deg), *odd, *check_notes(looked_at)],
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


def fit_triad(parts: Calibration, sensor: Sensor, campaign: Document, noise: SensorNoise | None = None) -> None:
    """Fit a kind of sensor to its records, and to those of the check what the first fit leaves of them.

    A part that is refused does not cost the rest; the reason is kept. ``noise``: of records that hold none.
    """
    gravity, site, fits = gravity_g(campaign), site_of(campaign), parts.fits[sensor.prefix]
    resolution, clock = float((campaign.get("imu") or {}).get(sensor.resolution, 0.0)), parts.clock
    what = say(f"triad.{sensor.prefix}")
    for of_set in parts.records[sensor.item][:2]:
        rows = list(of_set.values())
        if not rows:
            return
        outputs = [row.values(sensor.kind) for row in rows]
        if fits:
            what = say("triad.check", triad=what)
            outputs = [fits[0].apply(output, bias_sign=sensor.bias_sign) for output in outputs]
        try:
            if sensor is ACCELEROMETER:
                triad = position_fit(
                    rows, outputs, gravity, resolution, tilt_std_deg=site.tilt_std_deg,
                    one_power_on=parts.one_power_on(rows), noise=noise,
                )  # fmt: skip
            else:
                declared = Declared(tilt_std_deg=site.tilt_std_deg, resolution_deg_s=resolution, time_std=clock.std)
                records = [rotation_record(row, rate, clock.error) for row, rate in zip(rows, outputs, strict=True)]
                turns = fit_rotations(records, site, declared, noise)
                parts.turns, triad = parts.turns or turns, turns.triad
        except FitError as error:
            if error.code not in _OF_ONE_PART:
                raise
            parts.refused.append(error)
            parts.missing.append(refused(what, error.message, error.code))
            return
        fits.append(triad)


def name_missing(parts: Calibration, unusable: Records | None = None) -> None:
    """Add a sentence for each record that a calibration and its check need and that is not there.

    ``unusable``: records that have one already.
    """
    checks = []
    for sensor in CALIBRATED:
        first, check = parts.records[sensor.item][:2]
        there = {*first, *(unusable[sensor.item][0] if unusable else ())}
        parts.missing += [_no_record(shown) for shown in sensor.due if shown not in there]
        checks += [] if check else [say(f"missing.check_{sensor.item}s")]
    parts.missing += checks


def _no_record(shown: Shown) -> str:
    if isinstance(shown, str):
        return say("missing.position", up=shown)
    axis, sign = shown
    return say("missing.rotation", axis=axis.upper(), sign="+" if sign > 0 else "-")


def estimates_of(parts: Calibration, limits: Limits) -> Estimates:
    """Return the estimates of what was fitted."""
    estimates: Estimates = []
    for sensor, first in parts.calibrated():
        used = [len(row.samples) for row in parts.first(sensor)]
        if sensor is GYRO and parts.turns is not None:
            used = list(parts.turns.used.values())
        estimates += _triad_estimates(first, sensor, sum(used))
        for check in parts.fits[sensor.prefix][1:]:
            estimates += _checked(check, first, sensor, limits)
    return estimates


def _compensation(parts: Calibration) -> list[dict[str, Any]]:
    return [
        triad_section(sensor.kind, first, temperature_span(parts.first(sensor))) for sensor, first in parts.calibrated()
    ]


_OF_TWO = 2.0**0.5  # from the difference of two values to their standard deviation


def _triad_estimates(fit: TriadFit, sensor: Sensor, count: int) -> Estimates:
    """Matrix K (true input per indicated), bias, scale-factor errors and couplings of S = K^-1; none of them judged.

    Bias of gyros: w = K N - bias; of accelerometers: a = K N + bias. ``count``: samples that went into it.
    """
    entries: Estimates = []
    common: dict[str, Any] = {"n": count, "dof": fit.dof}
    for row, name in enumerate(AXES):
        for column, other in enumerate(AXES):
            place = {"kind": sensor.kind, "row": name, "column": other}
            value, std = fit.matrix[row, column], fit.matrix_std[row, column]
            entries.append(estimate(f"{sensor.prefix}_matrix", "1", value, std, place, **common))
    for row, name in enumerate(AXES):
        place = {"kind": sensor.kind, "axis": name}
        value, std = sensor.bias_factor * fit.bias[row], sensor.bias_factor * fit.bias_std[row]
        entries.append(estimate(f"{sensor.prefix}_bias", sensor.bias_unit, value, std, place, **common))
        value, std = fit.scale_error_ppm[row], fit.scale_error_std_ppm[row]
        entries.append(estimate(f"{sensor.prefix}_scale_error", "ppm", value, std, place, **common))
    return entries + _coupling(fit, sensor, f"{sensor.prefix}_cross_coupling", None, common)


def _checked(check: TriadFit, calibration: TriadFit, sensor: Sensor, limits: Limits) -> Estimates:
    """Coupling and scale factors that an independent set of records shows after compensation, against their limits.

    The uncertainty of the coupling is that of the check; the error of the calibration itself is what is being looked
    for. The repeatability is the standard deviation of the scale factors of both sets, with the sign of the change.
    """
    count = check.residual_dof + 12
    common: dict[str, Any] = {"n": count, "dof": min(check.dof, calibration.dof)}
    entries = _coupling(
        check, sensor, f"{sensor.prefix}_coupling_compensated", limits[f"{sensor.prefix}_cross_coupling"], common
    )
    quantity = f"{sensor.prefix}_scale_repeatability"
    for row, name in enumerate(AXES):
        change = check.matrix[row, row] - 1.0
        std = np.hypot(check.matrix_std[row, row], calibration.matrix_std[row, row])
        place = {"kind": sensor.kind, "axis": name}
        entries.append(
            estimate(quantity, "1", change / _OF_TWO, std / _OF_TWO, place, limit=limits[quantity], **common)
        )
    return entries


def _coupling(fit: TriadFit, sensor: Sensor, quantity: str, limit: float | None, common: dict[str, Any]) -> Estimates:
    return [
        estimate(
            quantity, "1", fit.cross_coupling[row, column], fit.cross_coupling_std[row, column],
            {"kind": sensor.kind, "row": AXES[row], "column": AXES[column]}, limit=limit, **common,
        )
        for row in range(3)
        for column in range(3)
        if row != column
    ]  # fmt: skip
