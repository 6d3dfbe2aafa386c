"""Limits of a data sheet that the analyses know: a wrong name must not cost a whole campaign.

The analyses live floors above; a test holds these names to theirs.
"""

from __future__ import annotations

from collections.abc import Mapping

from bench.model.units import parse_quantity
from bench.model.yamlio import Document
from bench.plan.findings import Findings, suggestion
from bench.plan.language import Sequence

DIMENSIONS: Mapping[str, str] = {
    "width": "m",
    "depth": "m",
    "height": "m",
    "supply_voltage": "V",
    "supply_voltage_deviation": "1",
    "supply_current": "A",
    "supply_current_deviation": "1",
    "timer_interval_error": "1",
    "timer_ticks": "1",
    "gyro_at_rest": "deg/s",
    "acceleration_error": "g",
    "imu_temperature_low": "degC",
    "imu_temperature_high": "degC",
    "horizontal_error": "m",
    "height_error": "m",
    "gps_satellites": "1",
    "ad_tolerance": "1",
    "ad_ground": "V",
    "ad_field_low": "gauss",
    "ad_field_high": "gauss",
    "gyro_bias_stability": "deg/s",
    "accel_bias_stability": "g",
    "gyro_cross_coupling": "1",
    "accel_cross_coupling": "1",
    "roll_error": "deg",
}

OF_ANALYSES: Mapping[str, Mapping[str, str]] = {
    "fog_north": {"azimuth_error": "deg"},
    "rlg_lock_in": {"alignment_error": "deg", "alignment_time": "s"},
    "time_sync": {"time_offset_uncertainty": "s", "stamps_difference": "s"},
}  # those whose limits are not those of a GNC module


def check_limits(document: Document[Sequence], findings: Findings) -> None:
    """Note limits that no analysis knows, with the unit of something else, or of errors not above 0 (B-PLAN-093)."""
    uut = document.model.uut
    known = OF_ANALYSES.get(document.model.analysis, DIMENSIONS)
    for name, text in ({} if uut is None else uut.limits).items():
        where = document.where(("uut", "limits", name))
        if name not in known:
            message = f"no analysis knows the limit {name!r}{suggestion(name, known)}"
            if document.model.analysis in OF_ANALYSES:
                message = f"the analysis {document.model.analysis} knows no limit {name!r}{suggestion(name, known)}"
            findings.add("B-PLAN-093", where, message, f"use one of: {', '.join(known)}")
            continue
        try:
            value = parse_quantity(text, known[name])
        except ValueError as error:
            findings.add("B-PLAN-093", where, f"limit {name}: {error}")
            continue
        if document.model.analysis in OF_ANALYSES and not value > 0.0:
            findings.add("B-PLAN-093", where, f"limit {name}: {text} is not above zero")
