"""Limits of a GNC module: those of the technical specification, unless the sequence states others.

Source: GNC-module paper, table 1 (unit tests) and table 3 (specification); the coupling limit applies after
compensation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.analysis import stated_limits

# name -> (dimension, value in its base unit)
SPECIFIED: Mapping[str, tuple[str, float]] = {
    "width": ("m", 0.026),
    "depth": ("m", 0.026),
    "height": ("m", 0.032),
    "supply_voltage": ("V", 5.0),
    "supply_voltage_deviation": ("1", 0.05),
    "supply_current": ("A", 0.49),
    "supply_current_deviation": ("1", 0.05),
    "timer_interval_error": ("1", 0.01),
    "timer_ticks": ("1", 20.0),
    "gyro_at_rest": ("deg/s", 2.0),
    "acceleration_error": ("g", 0.1),
    "imu_temperature_low": ("degC", -40.0),
    "imu_temperature_high": ("degC", 85.0),
    "horizontal_error": ("m", 10.0),
    "height_error": ("m", 15.0),
    "gps_satellites": ("1", 4.0),
    "ad_tolerance": ("1", 0.02),
    "ad_ground": ("V", 0.05),
    "ad_field_low": ("gauss", 0.1),
    "ad_field_high": ("gauss", 1.5),
    "gyro_bias_stability": ("deg/s", 10.0 / 3600.0),
    "accel_bias_stability": ("g", 2e-3),
    "gyro_cross_coupling": ("1", 1e-3),
    "accel_cross_coupling": ("1", 1e-3),
    "roll_error": ("deg", math.inf),  # no specification states one: judged if the sequence does
}


DIMENSIONS: Mapping[str, str] = {name: dimension for name, (dimension, _) in SPECIFIED.items()}
Limits = Mapping[str, float]


def limits_of(campaign: Mapping[str, Any]) -> Limits:
    """Return every limit in the base unit of its dimension (V, A, deg, deg/s, g, gauss, m, degC, 1).

    Raises: FitError B-GNC-001 for a limit of the sequence that no analysis knows, or in a unit that does not fit.
    """
    stated = stated_limits(campaign, DIMENSIONS, "B-GNC-001", "no analysis knows it", two_sided=True)
    return {name: value for name, (_, value) in SPECIFIED.items()} | stated
