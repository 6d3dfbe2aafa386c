"""What no data of a GNC module's calibration can show: it changes every reading as the wanted quantity would.

Source: docs/method-uncertainty.md; sizes from the sequence where it states them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.systems import Assumption, assumed
from bench.systems.gnc.wording import say

_TURN_deg = 1080.0  # of the published sequences
_TRIAD = ("matrix", "bias", "scale_error", "cross_coupling")
_GYRO = tuple(f"gyro_{name}" for name in _TRIAD)
_ACCEL = tuple(f"accel_{name}" for name in _TRIAD)
_PLANE = ("mag_offset", "mag_gain", "mag_angle", "mag_radius")
_SPHERE = ("mag_hard_iron", "mag_soft_iron")


def of_calibration(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a calibration of accelerometers and gyros takes for granted."""
    return [
        _gravity(campaign),
        assumed(say, "table_angle", _GYRO, turn=_TURN_deg),
        _mounting(campaign),
        assumed(say, "temperature_sensor"),
        _latitude(campaign),
    ]


def of_bias(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a measurement of bias and its stability takes for granted."""
    return [assumed(say, "temperature_sensor"), assumed(say, "table_at_rest")]


def of_magnetometer(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a calibration of the magnetometer takes for granted."""
    return [
        assumed(say, "magnetic_surroundings", (*_PLANE, *_SPHERE)),
        assumed(say, "field_strength", ("mag_radius", "mag_soft_iron")),
        assumed(say, "axes_of_the_correction", ("mag_soft_iron", "mag_angle")),
        assumed(say, "temperature_sensor"),
    ]


def _gravity(campaign: Mapping[str, Any]) -> Assumption:
    gravity = (campaign.get("site") or {}).get("gravity_m_s2")
    if gravity is None:
        return assumed(say, "local_gravity", _ACCEL)
    return assumed(say, "local_gravity", _ACCEL, taken="taken_stated", gravity=float(gravity))


def _mounting(campaign: Mapping[str, Any]) -> Assumption:
    tilt_deg = float((campaign.get("site") or {}).get("tilt_std_deg", 0.0))
    return assumed(
        say,
        "mounting",
        (*_ACCEL, *_GYRO),
        taken="taken_stated" if tilt_deg else "taken",
        unseen="unseen_stated" if tilt_deg else "unseen",
        arcmin=1e6 * math.radians(1.0 / 60.0),
        tilt=60.0 * tilt_deg,
        wide=120.0 * tilt_deg,
    )


def _latitude(campaign: Mapping[str, Any]) -> Assumption:
    latitude = (campaign.get("site") or {}).get("latitude_deg")
    if latitude is None:
        return assumed(say, "earth_rate", ("gyro_bias",))
    return assumed(say, "earth_rate", ("gyro_bias",), taken="taken_stated", latitude=float(latitude))
