"""What no data of a GNC module's calibration can show: it changes every reading as the wanted quantity would.

Source: docs/decisions/0025-doubt.md; sizes from the sequence where it states them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption

_TURN_deg = 1080.0  # of the published sequences
_TRIAD = ("matrix", "bias", "scale_error", "cross_coupling")
_GYRO = tuple(f"gyro_{name}" for name in _TRIAD)
_ACCEL = tuple(f"accel_{name}" for name in _TRIAD)
_PLANE = ("mag_offset", "mag_gain", "mag_angle", "mag_radius")
_SPHERE = ("mag_hard_iron", "mag_soft_iron")


def of_calibration(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a calibration of accelerometers and gyros takes for granted."""
    return [_gravity(campaign), _table_angle(), _mounting(campaign), _warm(), _latitude(campaign)]


def of_bias(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a measurement of bias and its stability takes for granted."""
    return [_warm(), _still()]


def of_magnetometer(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a calibration of the magnetometer takes for granted."""
    return [_surroundings(), _field_strength(), _frame(), _warm()]


def _gravity(campaign: Mapping[str, Any]) -> Assumption:
    gravity = (campaign.get("site") or {}).get("gravity_m_s2")
    stated = "as the sequence states it" if gravity is None else f"{float(gravity):.5g} m/s2"
    return Assumption(
        "local_gravity",
        f"Local gravity is {stated}.",
        "Any error of it: all positions change alike. A formula of latitude and height without a survey is off by tens "
        "of ppm.",
        "Scale factors of the accelerometers are off by the same part: 100 ppm of gravity is 100 ppm, 0.1 mg at 1 g.",
        "A gravimeter, or a unit with known scale factors in the same positions.",
        _ACCEL,
    )


def _table_angle() -> Assumption:
    return Assumption(
        "table_angle",
        "The table turns by the angle that the records name.",
        f"Any error that all turns share, and one of a single turn below some 0.1 deg of {_TURN_deg:g} deg.",
        "Scale factors of the gyros are off by the same part: 0.1 deg in all turns of 1080 deg is 93 ppm.",
        "An autocollimator with a mirror or polygon on the table before and after whole turns.",
        _GYRO,
    )


def _mounting(campaign: Mapping[str, Any]) -> Assumption:
    tilt_deg = float((campaign.get("site") or {}).get("tilt_std_deg", 0.0))
    if tilt_deg:
        granted = (
            f"The unit stands along the axes of the table within {60.0 * tilt_deg:.3g} arcmin (standard deviation)."
        )
        unseen = f"A tilt that all poses share, of any size; {120.0 * tilt_deg:.3g} arcmin of it are in the intervals."
    else:
        granted = "The unit stands along the axes of the table; the sequence states no tilt."
        unseen = "A tilt that all poses share, of any size; one of a single pose below some 1 arcmin."
    return Assumption(
        "mounting",
        granted,
        unseen,
        f"Couplings are off by the tilt in radians: 1 arcmin is {1e6 * math.radians(1.0 / 60.0):.0f} ppm. Scale "
        "factors are off by half its square.",
        "The same positions with the unit turned by 180 deg on its plate, or an autocollimator on a face of the unit.",
        (*_ACCEL, *_GYRO),
    )


def _warm() -> Assumption:
    return Assumption(
        "temperature_sensor",
        "The unit's own thermometer shows the temperature of the sensors.",
        "Any error of its scale or zero, and a lag between thermometer and sensors.",
        "The temperature for which the coefficients hold is off by as much; values at another temperature are off by "
        "some 30 ppm/degC (scale) and 3 deg/h/degC (gyro bias) times that.",
        "A reference thermometer on the unit, and the calibration repeated at another temperature.",
    )


def _latitude(campaign: Mapping[str, Any]) -> Assumption:
    latitude = (campaign.get("site") or {}).get("latitude_deg")
    stated = "as the sequence states them" if latitude is None else f"as stated (latitude {float(latitude):.4g} deg)"
    return Assumption(
        "earth_rate",
        f"Latitude and azimuth of the table are {stated}.",
        "About 1 deg of either: the Earth turns by 15 deg/h.",
        "The bias of the gyros is off by up to 0.26 deg/h for each degree.",
        "A survey of the site; a theodolite on the axis of the table; the bias in two opposite headings.",
        ("gyro_bias",),
    )


def _still() -> Assumption:
    return Assumption(
        "table_at_rest",
        "The table stands still and does not vibrate.",
        "A turn slower than the bias wanders; vibration that the sensors rectify.",
        "It is bias: 1 deg/h of creep is 1 deg/h.",
        "The same measurement on a pier, or a second unit beside it.",
    )


def _surroundings() -> Assumption:
    return Assumption(
        "magnetic_surroundings",
        "Nothing magnetic turns with the unit, and the field is the same wherever and as long as the unit is turned.",
        "Iron and magnets on the moving part of the table, of any size; a gradient over the way of the unit, a drift "
        "or a wandering below the noise.",
        "They are taken for hard and soft iron of the unit: 1 mgauss of a magnetised screw is 1 mgauss of offset, and "
        "steel that adds 0.2 % to the field is 0.2 % of gain, or 0.1 deg of angle.",
        "The same campaign with the unit turned by 180 deg on its plate, and a scalar magnetometer along its way.",
        (*_PLANE, *_SPHERE),
    )


def _field_strength() -> Assumption:
    return Assumption(
        "field_strength",
        "The size of the field is not known: the correction keeps volumes.",
        "Any scale that all three axes share.",
        "mag_radius is in units of axis X; soft iron holds ratios of the axes alone.",
        "A scalar (proton) magnetometer at the place of the unit.",
        ("mag_radius", "mag_soft_iron"),
    )


def _frame() -> Assumption:
    return Assumption(
        "axes_of_the_correction",
        "The correction turns the axes least (symmetric soft iron).",
        "A turn of all three axes together, of any size: it leaves the size of the field as it is.",
        "Directions after correction are off by that turn; sizes are not.",
        "Roll angles against the table (mag_roll_error), about all three axes.",
        ("mag_soft_iron", "mag_angle"),
    )
