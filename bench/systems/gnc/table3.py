"""Table 3 of the GNC-module paper: every row of the specification, with what this session measured of it.

A row that nothing here measures prints "not tested" and never PASS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.analysis import Table, judged, rule_of, with_uncertainty
from bench.systems.gnc.limits import Limits, limits_of

NOT_TESTED = "not tested"
_ORDER = ("fail", "conditional_fail", "conditional_pass", "pass", "none")  # the worst axis speaks for the row


@dataclass(frozen=True)
class Row:
    """One row: ``quantity`` measures it (None: nothing does), ``limit`` names the limit, ``factor`` to its unit."""

    text: str
    specified: str
    quantity: str | None = None
    limit: str | None = None
    unit: str = "1"
    factor: float = 1.0


ROWS: tuple[Row, ...] = (
    Row("size of the module", "26 mm x 26 mm x 32 mm"),
    Row("supply voltage, deviation from 5 V", "5 %", "supply_voltage_deviation", "supply_voltage_deviation"),
    Row("supply current, deviation from 0.49 A", "5 %", "supply_current_deviation", "supply_current_deviation"),
    Row("position, 1 sigma", "10 m horizontal, 15 m vertical"),
    Row("velocity, 1 sigma", "0.1 m/s horizontal, 0.2 m/s vertical"),
    Row("pulse per second", "10 ns"),
    Row("overload", "at least 20 000 g"),
    Row("acceleration range", "40 g"),
    Row("accelerometer: range", "50 g"),
    Row("accelerometer: resolution", "1 mg"),
    Row("accelerometer: bias stability, 1 sigma", "", "accel_bias_stability", "accel_bias_stability", "mg", 1e3),
    Row("accelerometer: scale-factor repeatability, 1 sigma", "0.001"),
    Row("accelerometer: coupling after compensation", "", "accel_coupling_compensated", "accel_cross_coupling"),
    Row("gyro: range", "400 deg/s"),
    Row("gyro: resolution", "0.005 deg/s"),
    Row("gyro: bias stability, 1 sigma", "", "gyro_bias_stability", "gyro_bias_stability", "deg/h", 3600.0),
    Row("gyro: scale-factor repeatability, 1 sigma", "0.001"),
    Row("gyro: coupling after compensation", "", "gyro_coupling_compensated", "gyro_cross_coupling"),
    Row("magnetometer: range", "6 gauss"),
    Row("magnetometer: resolution", "120 ugauss"),
)


def table_3(estimates: Sequence[Mapping[str, Any]], campaign: Mapping[str, Any]) -> Table:
    """Return the table; a row shows the axis that is worst, by the rule of the campaign.

    Raises: FitError B-GNC-001 (limits), B-FIT-041 (rule).
    """
    limits, rule = limits_of(campaign), rule_of(campaign.get("decision"))
    rows = [
        _row(promised, [entry for entry in estimates if entry["quantity"] == promised.quantity], limits, rule)
        for promised in ROWS
    ]
    title = "Table 3: specification of the module"
    caption = "Worst axis with its expanded uncertainty; what this session does not measure is not tested."
    headers = ["parameter", "unit", "measured ± U", "limit", "axis", "verdict"]
    tested = any(row[-1] != NOT_TESTED for row in rows)  # of nothing but "not tested" nobody reads first
    return Table(title, caption, headers, rows, lead=tested)


def _row(row: Row, entries: list[Mapping[str, Any]], limits: Limits, rule: str) -> list[Any]:
    limit = row.specified if row.limit is None else f"{row.factor * limits[row.limit]:g}"
    unit = "–" if row.quantity is None else row.unit
    if not entries:
        return [row.text, unit, "–", limit, "–", NOT_TESTED]
    worst = min(
        (judged(entry, rule) for entry in entries),
        key=lambda entry: (_ORDER.index(entry["verdict"]), -abs(entry["value"])),
    )
    verdict = NOT_TESTED if worst["verdict"] == "none" else str(worst["verdict"]).upper().replace("_", " ")
    place = " ".join(str(value) for name, value in worst["conditions"].items() if name != "kind")
    measured = with_uncertainty(worst["value"], worst["expanded_uncertainty"])
    return [row.text, unit, measured, limit, place or "–", verdict]
