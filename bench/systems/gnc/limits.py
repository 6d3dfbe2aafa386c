"""Limits of a GNC module: those of the technical specification, unless the sequence states others; and table 3 with all
rows of the specification and what a session measured of it.

A row that nothing here measures prints "not tested" and never PASS.

Source: GNC-module paper, table 1 (unit tests) and table 3 (specification); the coupling limit applies after
compensation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench import analysis
from bench.analysis import (
    Document,
    Estimate,
    Estimates,
    Table,
    judged,
    rule_of,
    stated_limits,
    use_of,
    with_uncertainty,
    worded_table,
)
from bench.maths.verdict import WORST_FIRST
from bench.systems.gnc.declaration import DECLARATION
from bench.systems.gnc.wording import say

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
    "gyro_scale_repeatability": 1e-3,
    "accel_scale_repeatability": 1e-3,
    "roll_error": math.inf,  # no specification states one: judged if the sequence does
}

Limits = Mapping[str, float]
NOT_TESTED = say("verdict.not_tested")
_ORDER = (*WORST_FIRST, "none")  # the worst axis speaks for the row


def limits_of(campaign: Document) -> Limits:
    """Return every limit in the base unit of its dimension (V, A, deg, deg/s, g, gauss, m, degC, 1).

    Raises: FitError B-GNC-001 for a limit of the sequence that no analysis knows, or in a unit that does not fit.
    """
    stated = stated_limits(campaign, DECLARATION.limits, "B-GNC-001", "no analysis knows it")
    return {**SPECIFIED, **stated}


@dataclass(frozen=True)
class Row:
    """One row: ``quantities`` measure it (none: nothing does), ``limit`` names the limit, ``factor`` to its unit."""

    text: str
    specified: str
    quantities: tuple[str, ...] = ()
    limit: str | None = None
    unit: str = "1"
    factor: float = 1.0


ROWS: tuple[Row, ...] = (
    Row(
        say("spec.size"),
        "26 mm x 26 mm x 32 mm",
        ("width_beyond_limits", "depth_beyond_limits", "height_beyond_limits"),
        unit="m",
    ),
    Row(say("spec.supply_voltage"), "5 %", ("supply_voltage_deviation",), "supply_voltage_deviation"),
    Row(say("spec.supply_current"), "5 %", ("supply_current_deviation",), "supply_current_deviation"),
    Row(say("spec.position"), say("spec.position.limit")),
    Row(say("spec.velocity"), say("spec.velocity.limit")),
    Row(say("spec.pulse"), "10 ns"),
    Row(say("spec.overload"), say("spec.overload.limit")),
    Row(say("spec.acceleration"), "40 g"),
    Row(say("spec.accel_range"), "50 g"),
    Row(say("spec.accel_resolution"), "1 mg"),
    Row(say("spec.accel_stability"), "", ("accel_bias_stability",), "accel_bias_stability", "mg", 1e3),
    Row(
        say("spec.accel_repeatability"),
        "",
        ("accel_scale_repeatability",),
        "accel_scale_repeatability",
    ),
    Row(say("spec.accel_coupling"), "", ("accel_coupling_compensated",), "accel_cross_coupling"),
    Row(say("spec.gyro_range"), "400 deg/s"),
    Row(say("spec.gyro_resolution"), "0.005 deg/s"),
    Row(say("spec.gyro_stability"), "", ("gyro_bias_stability",), "gyro_bias_stability", "deg/h", 3600.0),
    Row(say("spec.gyro_repeatability"), "", ("gyro_scale_repeatability",), "gyro_scale_repeatability"),
    Row(say("spec.gyro_coupling"), "", ("gyro_coupling_compensated",), "gyro_cross_coupling"),
    Row(say("spec.mag_range"), "6 gauss"),
    Row(say("spec.mag_resolution"), "120 ugauss"),
)


def table_3(estimates: Estimates, campaign: Document) -> Table:
    """Return the table; a row shows the axis that is worst, by the rule of the campaign.

    Raises: FitError B-GNC-001 (limits), B-FIT-041 (rule).
    """
    limits, rule = limits_of(campaign), rule_of(campaign.get("decision"))
    rows = [
        _row(promised, [entry for entry in estimates if entry.quantity in promised.quantities], limits, rule)
        for promised in ROWS
    ]
    heads = ["parameter", "unit", "measured", "limit", "of", "verdict"]
    tested = any(row[-1] != NOT_TESTED for row in rows)  # of nothing but "not tested" nobody reads first
    return worded_table(say, "table3", heads, rows, lead=tested)


def _row(row: Row, entries: Estimates, limits: Limits, rule: str) -> list[Any]:
    limit = row.specified if row.limit is None else f"{row.factor * limits[row.limit]:g}"
    unit = row.unit if row.quantities else "–"
    if not entries:
        return [row.text, unit, "–", limit, "–", NOT_TESTED]
    worst = min(
        (judged(entry, rule) for entry in entries), key=lambda entry: (_ORDER.index(entry.verdict), -_use(entry))
    )
    verdict = NOT_TESTED if worst.verdict == "none" else say(f"verdict.{worst.verdict}")
    place = " ".join(str(value) for name, value in worst.conditions.items() if name != "kind")
    measured = with_uncertainty(worst.value, worst.expanded_uncertainty)
    return [row.text, unit, measured, limit, place or "–", verdict]


def _use(entry: Estimate) -> float:
    """Return how much of its limits a value with its interval uses, as the table of the verdicts has it."""
    limits = analysis.limits_of(entry)
    return abs(entry.value) if limits is None else use_of(entry.value, limits, entry.expanded_uncertainty)
