"""The whole history as one table: CSV with exact numbers, or Parquet."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, select

from bench.analysis import Estimate, limits_of
from bench.model.clock import utc_text
from bench.store.database import reading
from bench.store.reading import stored_estimates
from bench.store.rows import check_form, columns_of, write_rows
from bench.store.selection import Filters, selected
from bench.store.tables import report_revisions, result_sets

COLUMNS = columns_of(
    (
        "session", "session_sha256", "started_utc", "campaign", "uut_model", "uut_serial", "simulated", "revision",
        "newest", "method", "software", "quantity", "unit", "value", "std_uncertainty", "coverage_factor",
        "expanded_uncertainty", "n", "dropped", "limit", "verdict", "channel", "temperature_degC",
        "unit_temperature_degC", "conditions", "low", "high",
    ),
    simulated="bool", revision="int64", newest="bool", value="double", std_uncertainty="double",
    coverage_factor="double", expanded_uncertainty="double", n="int64", dropped="int64", limit="double",
    channel="int64", temperature_degC="double", unit_temperature_degC="double", low="double", high="double",
)  # fmt: skip
_HEAD = ("session", "session_sha256", "campaign", "uut_model", "uut_serial", "simulated")
_CONDITIONS = ("channel", "temperature_degC", "unit_temperature_degC")


def export_history(url: str, filters: Filters, path: Path) -> int:
    """Write every estimate of every revision, one a row; the suffix of the file says the form.

    Returns: number of rows.
    Raises:  StoreError B-STORE-012 for another suffix, or Parquet without its library; OSError;
             B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    check_form(path)
    with reading(url) as connection:
        return write_rows(path, COLUMNS, _rows(connection, filters))


def _rows(connection: Connection, filters: Filters) -> Iterator[dict[str, Any]]:
    for calibration in connection.execute(selected(connection, filters)).mappings().all():
        revisions = (
            select(report_revisions, result_sets.c.method)
            .join(result_sets, result_sets.c.id == report_revisions.c.result_set_id)
            .where(report_revisions.c.calibration_id == calibration["id"])
            .order_by(report_revisions.c.number)
        )
        for revision in connection.execute(revisions).mappings().all():
            head = {
                **{name: calibration[name] for name in _HEAD},
                "started_utc": utc_text(calibration["started_utc_ns"]),
                "revision": revision["number"],
                "newest": revision["number"] == calibration["revision"],
                "method": revision["method"],
                "software": revision["software"],
            }
            for estimate in stored_estimates(connection, revision["result_set_id"]):
                if filters.quantity in (None, estimate.quantity):
                    yield {**head, **_estimate(estimate)}


def _estimate(estimate: Estimate) -> dict[str, Any]:
    conditions = estimate.conditions
    text = json.dumps(conditions, sort_keys=True, ensure_ascii=False)
    ends = limits_of(estimate) or (-math.inf, math.inf)
    limits = {name: end if math.isfinite(end) else None for name, end in zip(("low", "high"), ends, strict=True)}
    return {**estimate.document, **{name: conditions.get(name) for name in _CONDITIONS}, "conditions": text, **limits}
