"""Calibration of the accelerometers by positions and of the gyros by turns, with the check of what the compensation
leaves.

Source: GNC-module paper section 4.2 1), equations (1) to (4) as corrected in ``estimators.six_position`` and
``bench.systems.gnc.estimators.rotations``; table 3 limits the coupling after compensation.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis.analysis import Analysis
from bench.analysis.material import Material
from bench.model.errors import FitError
from bench.systems.gnc.calibration.files import rotation_files
from bench.systems.gnc.calibration.fitted import Calibration
from bench.systems.gnc.calibration.notes import calibration_notes
from bench.systems.gnc.calibration.triad_estimates import ACCELEROMETER, GYRO, checked_coupling, triad_estimates
from bench.systems.gnc.coefficients import triad_section
from bench.systems.gnc.estimators.earth_rate import Site
from bench.systems.gnc.estimators.rotation_inputs import Declared
from bench.systems.gnc.estimators.rotations import fit_rotations
from bench.systems.gnc.estimators.triad import TriadFit
from bench.systems.gnc.limits import Limits
from bench.systems.gnc.report import matrix_table, position_figure, rotation_figures
from bench.systems.gnc.rows import (
    Floats,
    clock_of,
    gravity_g,
    power_on_of,
    sampled_rows,
    site_of,
    temperature_span,
)
from bench.systems.gnc.sample_checks import check_notes, check_table, checked, usable
from bench.systems.gnc.sets import TURNS, UPS, position_fit, rotation_record, sets_of
from bench.systems.gnc.table3 import table_3

METHODS: tuple[str, ...] = ("least_squares",)
_OF_ONE_PART = ("B-FIT-001", "B-FIT-080", "B-FIT-081", "B-FIT-082", "B-FIT-083")


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Matrices, biases, scale-factor errors and couplings of both triads; what is missing is named.

    Raises: FitError B-FIT-004 (unknown method), B-GNC-001, -003, -004, -005; that of the fit if nothing is determined.
    """
    if method not in METHODS:
        raise FitError("B-FIT-004", f"unknown method {method!r}", next_step=f"use one of: {', '.join(METHODS)}")
    rows, empty = sampled_rows(material, ("position", "rotation"))
    looked_at = checked(rows, ("gyro", "accelerometer"), material.campaign)
    good, refused = usable(looked_at)
    found = calibrate(Calibration(sets_of(good), clock_of(good), power_on_of(good)), material)
    if found.accelerometer is None and found.gyro is None and found.refused:
        raise found.refused[0]
    limits = Limits(material.campaign)
    estimates = _estimates(found, limits)
    return Analysis(
        campaign="imu_calibration",
        method=method,
        uut=dict(material.campaign["uut"]),
        estimates=estimates,
        notes=[*calibration_notes(found), *check_notes(looked_at)],
        missing=[*empty, *refused, *found.missing],
        figures=[*position_figure(found), *rotation_figures(found)],
        tables=[*matrix_table(found), table_3(estimates, material.campaign), check_table(looked_at)],
        compensation=_compensation(found),
        attachments=rotation_files(found, str(material.campaign["uut"]["serial"])),
    )


def calibrate(found: Calibration, material: Material) -> Calibration:
    """Fit what the records determine, and check it by the second set where there is one."""
    sets, site = found.sets, site_of(material.campaign)
    imu = material.campaign.get("imu") or {}
    gravity, resolution = gravity_g(material.campaign), float(imu.get("accel_resolution_g", 0.0))
    found.tilt_deg = site.tilt_std_deg
    _name_missing(found)
    if sets.positions:
        with _Part(found, "accelerometers"):
            rows = list(sets.positions.values())
            found.accelerometer = position_fit(
                rows, gravity, resolution, tilt_std_deg=found.tilt_deg, one_power_on=found.one_power_on(rows)
            )
    if found.accelerometer is not None and sets.check_positions:
        with _Part(found, "check of the accelerometers"):
            rows = list(sets.check_positions.values())
            found.accelerometer_check = position_fit(
                rows, gravity, resolution, found.accelerometer, tilt_std_deg=found.tilt_deg,
                one_power_on=found.one_power_on(rows),
            )  # fmt: skip
    _turns(found, site, float(imu.get("gyro_resolution_deg_s", 0.0)))
    return found


def _turns(found: Calibration, site: Site, resolution_deg_s: float) -> None:
    sets = found.sets
    declared = Declared(tilt_std_deg=site.tilt_std_deg, resolution_deg_s=resolution_deg_s, time_std=found.clock.std)
    clock_error = found.clock.error
    if sets.rotations:
        with _Part(found, "gyros"):
            records = [rotation_record(row, clock_error) for row in sets.rotations.values()]
            found.gyro = fit_rotations(records, site, declared)
    if found.gyro is not None and sets.check_rotations:
        with _Part(found, "check of the gyros"):
            triad = found.gyro.triad
            again = [
                rotation_record(row, clock_error, compensated(triad, row.values("gyro")))
                for row in sets.check_rotations.values()
            ]
            found.gyro_check = fit_rotations(again, site, declared)


def compensated(triad: TriadFit, indicated: Floats) -> Floats:
    """Rates after compensation, (n, 3) deg/s: w = K N - bias."""
    return triad.apply(np.asarray(indicated), bias_sign=-1)


class _Part:
    """A part of the calibration that may be refused without costing the rest; the reason is kept."""

    def __init__(self, found: Calibration, what: str) -> None:
        self._found, self._what = found, what

    def __enter__(self) -> None:
        return None

    def __exit__(self, _kind: object, error: object, _trace: object) -> bool:
        if not isinstance(error, FitError) or error.code not in _OF_ONE_PART:
            return False
        self._found.refused.append(error)
        self._found.missing.append(f"{self._what}: {error.message} ({error.code})")
        return True


def _name_missing(found: Calibration) -> None:
    sets = found.sets
    found.missing += [f"position {up} up: no record" for up in UPS if up not in sets.positions]
    found.missing += [
        f"rotation {axis.upper()}{'+' if sign > 0 else '-'}: no record"
        for axis, sign in TURNS
        if (axis, sign) not in sets.rotations
    ]
    if not sets.check_positions:
        found.missing.append("coupling of the accelerometers after compensation: no second set of positions")
    if not sets.check_rotations:
        found.missing.append("coupling of the gyros after compensation: no second set of rotations")


def _estimates(found: Calibration, limits: Limits) -> list[dict[str, Any]]:
    estimates: list[dict[str, Any]] = []
    if found.accelerometer is not None:
        count = sum(len(row.samples) for row in found.sets.positions.values())
        estimates += triad_estimates(found.accelerometer, ACCELEROMETER, count)
        if found.accelerometer_check is not None:
            both = found.accelerometer_check, found.accelerometer
            estimates += checked_coupling(*both, ACCELEROMETER, limits("accel_cross_coupling"))
    if found.gyro is not None:
        estimates += triad_estimates(found.gyro.triad, GYRO, sum(found.gyro.used.values()))
        if found.gyro_check is not None:
            both = found.gyro_check.triad, found.gyro.triad
            estimates += checked_coupling(*both, GYRO, limits("gyro_cross_coupling"))
    return estimates


def _compensation(found: Calibration) -> list[dict[str, Any]]:
    sections = []
    if found.accelerometer is not None:
        span = temperature_span(list(found.sets.positions.values()))
        sections.append(triad_section(ACCELEROMETER.kind, found.accelerometer, span))
    if found.gyro is not None:
        span = temperature_span(list(found.sets.rotations.values()))
        sections.append(triad_section(GYRO.kind, found.gyro.triad, span))
    return sections
