"""Estimates in the form of results.json, and their conversion to currents and sensor units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.campaigns.constants import Channel
from bench.fit import coverage_factor, verdict


def estimate(
    quantity: str,
    unit: str,
    value: float,
    std_uncertainty: float,
    conditions: Mapping[str, Any],
    *,
    n: int,
    dropped: int = 0,
    limit: float | None = None,
) -> dict[str, Any]:
    """One entry of the flat list of results.json: 95 % interval of a normal distribution, verdict against ``limit``.

    The covariance is known beforehand (not estimated from the residuals), so the coverage factor is the normal one.
    """
    factor = coverage_factor()
    expanded = factor * float(std_uncertainty)
    return {
        "quantity": quantity,
        "unit": unit,
        "value": float(value),
        "std_uncertainty": float(std_uncertainty),
        "coverage_factor": factor,
        "expanded_uncertainty": expanded,
        "conditions": dict(conditions),
        "n": int(n),
        "dropped": int(dropped),
        "limit": limit,
        "verdict": verdict(float(value), expanded, limit),
    }


def at_full_scale(entry: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    """A scale-factor error in ppm as what it makes of the full-scale input: nanoampere and the sensor's unit.

    ``bias`` estimates (ampere) are converted through the sensor's nominal sensitivity.
    """
    if entry["unit"] == "ppm":
        to_nA, to_sensor = channel.full_scale_A * 1e3, channel.sensor_full_scale * 1e-6
    else:
        to_nA, to_sensor = 1e9, channel.sensor_full_scale / channel.full_scale_A
    return {
        "quantity": entry["quantity"],
        "conditions": dict(entry["conditions"]),
        "unit": entry["unit"],
        "value": entry["value"],
        "expanded_uncertainty": entry["expanded_uncertainty"],
        "full_scale_nA": entry["value"] * to_nA,
        "full_scale_expanded_nA": entry["expanded_uncertainty"] * to_nA,
        "full_scale_sensor": entry["value"] * to_sensor,
        "full_scale_expanded_sensor": entry["expanded_uncertainty"] * to_sensor,
        "sensor_unit": channel.sensor_unit,
    }
