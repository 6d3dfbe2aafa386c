"""What no recording of two units can show, by name, with the size that passes unseen.

Sizes are those that the checks of a recording see in half of all cases, for a turn of 90 deg in 8 s at 100 m/s and
units as the sequences state them (docs/time-sync.md); larger stated errors hide as much more.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption, assumed
from bench.systems.time_sync.wording import say

_QUANTILE = 3.9  # standard deviations at which a check of a recording speaks
_MS = 1e3
_OFFSETS = ("time_offset", "time_offset_uncertainty")
_STAMPS = ("time_offset_from_stamps", "time_offset_drift", "clock_rate")
# seen in half of all cases: offset step s, drift s/s, age of velocities s, lever arm m, axes deg, scales
_STEP_s, _DRIFT, _AGE_s, _LEVER_m, _AXES_deg = 0.7e-3, 160e-6, 1.3e-3, 0.11, 0.007
_GYRO, _ACCELEROMETER = 3.4e-4, 4.5e-4
_VELOCITY_m_s, _LEVEL_deg = 0.017, 0.0013  # errors of the EGI with which these were seen


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a recording takes for granted, from the section "campaign" of its plan or manifest."""
    stated = campaign.get("egi") or {}
    worse = float(stated.get("velocity_m_s", _VELOCITY_m_s)) / _VELOCITY_m_s
    tilted = float(stated.get("level_deg", _LEVEL_deg)) / _LEVEL_deg
    drift_ppm = 1e6 * _DRIFT * worse
    return [
        _latency(campaign.get("latency")),
        assumed(say, "one_offset", _OFFSETS, step=_MS * _STEP_s * worse, drift=drift_ppm),
        assumed(say, "one_age", _OFFSETS, age=_MS * _AGE_s * worse),
        assumed(say, "one_place", _OFFSETS, lever=_LEVER_m * worse),
        assumed(say, "same_axes", (*_OFFSETS, "accel_bias"), axes=_AXES_deg * tilted),
        assumed(
            say,
            "scales_of_inertial_unit",
            (*_OFFSETS, "gyro_bias", "accel_bias"),
            gyro=1e6 * _GYRO,
            accelerometer=1e6 * _ACCELEROMETER,
        ),
        assumed(say, "steady_delay", (*_STAMPS, *_OFFSETS), drift=drift_ppm),
        assumed(say, "errors_as_stated", _OFFSETS),
    ]


def _latency(stated: Mapping[str, Any] | None) -> Assumption:
    quantities = (*_OFFSETS, "time_offset_from_stamps")
    if stated is None:
        return assumed(say, "latency_as_stated", quantities, unseen="unseen_unstated")
    seen_ms = _MS * _QUANTILE * math.sqrt(2.0) * float(stated["std_s"])
    return assumed(say, "latency_as_stated", quantities, seen=seen_ms)
