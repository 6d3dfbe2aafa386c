"""What the analysis is told of the unit under test and of the place where the bench stands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.units import read_quantity
from bench.plan.language import Egi, Imu, Inertial, Sequence, Site, UnitUnderTest


def unit_constants(model: Sequence, serial: str) -> dict[str, Any]:
    """Entries of the manifest's section "campaign", in base units; what the sequence does not say is left out."""
    found: dict[str, Any] = {}
    if model.uut is not None:
        found |= {"uut": {"model": model.uut.model, "serial": serial}, **_converter(model.uut)}
        if model.uut.imu is not None:
            found["imu"] = _sensors(model.uut.imu)
        if model.uut.inertial is not None:
            found["inertial"] = _inertial(model.uut.inertial)
        if model.uut.egi is not None:
            found["egi"] = _reference(model.uut.egi)
        if model.uut.latency is not None:
            latency = model.uut.latency
            found["latency"] = {"egi_s": latency.egi, "imu_s": latency.imu, "std_s": latency.uncertainty}
        if model.uut.limits:
            found["limits"] = {name: _limit(text) for name, text in model.uut.limits.items()}
    if model.site is not None:
        found["site"] = _site(model.site)
    return found


def _converter(uut: UnitUnderTest) -> dict[str, float]:
    constants = {
        "temperature_sensor_u95_degC": uut.temperature_sensor_uncertainty,
        "af_clock_Hz": uut.af_clock,
        "fg_Hz": uut.function_generator,
        "master_Hz": uut.master_clock,
    }
    return _stated(constants)


def _sensors(imu: Imu) -> dict[str, float]:
    return {
        "gyro_range_deg_s": imu.gyro_range,
        "gyro_resolution_deg_s": imu.gyro_resolution,
        "accel_range_g": imu.accelerometer_range,
        "accel_resolution_g": imu.accelerometer_resolution,
        "mag_range_gauss": imu.magnetometer_range,
        "mag_resolution_gauss": imu.magnetometer_resolution,
    }


def _inertial(inertial: Inertial) -> dict[str, float]:
    return {
        "accel_bias_g": inertial.accelerometer_bias,
        "velocity_walk_g_rtHz": inertial.velocity_walk_per_rtHz,
        "gyro_bias_deg_s": inertial.gyro_bias,
        "angle_walk_deg_rth": inertial.angle_walk_per_rth,
    }


def _reference(egi: Egi) -> dict[str, float]:
    return {
        "velocity_m_s": egi.velocity,
        "level_deg": egi.level,
        "heading_deg": egi.heading,
        "wander_s": egi.wander,
        "heading_wander_s": egi.heading_wander,
    }


def _limit(text: str) -> dict[str, Any]:
    value, unit = read_quantity(text) or (0.0, "")
    return {"value": value, "unit": unit}


def _site(site: Site) -> dict[str, float]:
    constants = {
        "latitude_deg": site.latitude,
        "longitude_deg": site.longitude,
        "height_m": site.height,
        "gravity_m_s2": site.gravity,
        "azimuth_deg": site.azimuth,
        "azimuth_std_deg": site.azimuth_uncertainty,
        "tilt_std_deg": site.tilt,
    }
    return _stated(constants)


def _stated(constants: Mapping[str, float | None]) -> dict[str, float]:
    return {name: value for name, value in constants.items() if value is not None}
