"""What a data sheet and a site declare of noise and field, as predictions take it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis import Floats
from bench.model.errors import FitError
from bench.systems.gnc.estimators.sensor_noise import SensorNoise
from bench.systems.gnc.rows import SENSORS
from bench.systems.gnc.wording import say

_WALKS = {"gyro": "gyro_random_walk_deg_rt_s", "accelerometer": "accel_random_walk_g_rt_s"}
_STEPS = {"gyro": "gyro_resolution_deg_s", "accelerometer": "accel_resolution_g"}


def noise_of(campaign: Mapping[str, Any], kind: str, missing: list[str]) -> SensorNoise | None:
    """Return the declared noise of the "gyro" or "accelerometer"; None, and what to declare, without one.

    A sensor of no noise and no step would have no uncertainty: it counts as not declared.
    """
    imu = campaign.get("imu") or {}
    if not (imu.get(_WALKS[kind], 0.0) or (_WALKS[kind] in imu and imu.get(_STEPS[kind], 0.0))):
        missing.append(say(f"predicted.no_noise.{kind}"))
        return None
    wandering = [(float(size), float(time_s)) for size, time_s in imu.get(f"{SENSORS[kind]}_wandering", ())]
    step = float(imu.get(_STEPS[kind], 0.0))
    return SensorNoise(float(imu[_WALKS[kind]]), wandering, step, 1.0 / float(campaign["rate_Hz"]))


def magnetic_noise(campaign: Mapping[str, Any]) -> float:
    """Return the standard deviation of a reading of the magnetometer with its rounding, gauss.

    Raises: FitError B-GNC-008 if it is not declared, or declared to be nothing.
    """
    imu = campaign.get("imu") or {}
    noise = float(imu.get("mag_noise_gauss", 0.0))
    rounding = float(imu.get("mag_resolution_gauss", 0.0)) / math.sqrt(12.0) if "mag_noise_gauss" in imu else 0.0
    if not math.hypot(noise, rounding) > 0.0:
        raise _not_declared("magnetometer_noise", "uut: imu", "0.5 mgauss")
    return math.hypot(noise, rounding)


def field_local_gauss(campaign: Mapping[str, Any]) -> Floats:
    """Return the magnetic field of the site, East, North, Up. Raises: FitError B-GNC-008 if it is not declared."""
    field = (campaign.get("site") or {}).get("magnetic_field")
    if field is None:
        raise _not_declared("magnetic_field", "site", "{size: 0.43 gauss, inclination: 55 deg, declination: -4 deg}")
    dip, east = math.radians(field["inclination_deg"]), math.radians(field["declination_deg"])
    level = math.cos(dip)
    return float(field["size_gauss"]) * np.array([level * math.sin(east), level * math.cos(east), -math.sin(dip)])


def _not_declared(name: str, section: str, example: str) -> FitError:
    return FitError(
        "B-GNC-008",
        f"{name} is not declared, so nothing can be predicted",
        where=f"sequence: {section}",
        next_step=f"declare {name} in the section '{section}', such as {name}: {example}",
    )
