"""Limits of a GNC module: those of the technical specification, unless the sequence states others.

Source: GNC-module paper, table 1 (unit tests) and table 3 (specification); the coupling limit applies after
compensation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.analysis import stated_limits
from bench.systems.gnc.declaration import DECLARATION

# in the base unit of the dimension that the declaration states
SPECIFIED: Mapping[str, float] = {
    "width": 0.026,
    "depth": 0.026,
    "height": 0.032,
    "supply_voltage": 5.0,
    "supply_voltage_deviation": 0.05,
    "supply_current": 0.49,
    "supply_current_deviation": 0.05,
    "timer_interval_error": 0.01,
    "timer_ticks": 20.0,
    "gyro_at_rest": 2.0,
    "acceleration_error": 0.1,
    "imu_temperature_low": -40.0,
    "imu_temperature_high": 85.0,
    "horizontal_error": 10.0,
    "height_error": 15.0,
    "gps_satellites": 4.0,
    "ad_tolerance": 0.02,
    "ad_ground": 0.05,
    "ad_field_low": 0.1,
    "ad_field_high": 1.5,
    "gyro_bias_stability": 10.0 / 3600.0,
    "accel_bias_stability": 2e-3,
    "gyro_cross_coupling": 1e-3,
    "accel_cross_coupling": 1e-3,
    "roll_error": math.inf,  # no specification states one: judged if the sequence does
}

Limits = Mapping[str, float]


def limits_of(campaign: Mapping[str, Any]) -> Limits:
    """Return every limit in the base unit of its dimension (V, A, deg, deg/s, g, gauss, m, degC, 1).

    Raises: FitError B-GNC-001 for a limit of the sequence that no analysis knows, or in a unit that does not fit.
    """
    stated = stated_limits(campaign, DECLARATION.limits, "B-GNC-001", "no analysis knows it")
    return {**SPECIFIED, **stated}
