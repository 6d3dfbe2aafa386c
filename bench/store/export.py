"""The whole history as one table: CSV with exact numbers, or Parquet."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, select

from bench.analysis import limits_of
from bench.store.database import reading
from bench.store.errors import StoreError
from bench.store.reading import stored_estimates, utc_text
from bench.store.selection import Filters, selected
from bench.store.tables import report_revisions, result_sets

# name, type as Parquet calls it
COLUMNS = (
    ("session", "string"), ("session_sha256", "string"), ("started_utc", "string"), ("campaign", "string"),
    ("uut_model", "string"), ("uut_serial", "string"), ("simulated", "bool"), ("revision", "int64"),
    ("newest", "bool"), ("method", "string"), ("software", "string"), ("quantity", "string"), ("unit", "string"),
    ("value", "double"), ("std_uncertainty", "double"), ("coverage_factor", "double"),
    ("expanded_uncertainty", "double"), ("n", "int64"), ("dropped", "int64"), ("limit", "double"),
    ("verdict", "string"), ("channel", "int64"), ("temperature_degC", "double"), ("unit_temperature_degC", "double"),
    ("conditions", "string"), ("low", "double"), ("high", "double"),
)  # fmt: skip
FORMATS = (".csv", ".parquet")
_CONDITIONS = ("channel", "temperature_degC", "unit_temperature_degC")
_BATCH = 50_000


def export_history(url: str, filters: Filters, path: Path) -> int:
    """Write every estimate of every revision, one a row; the suffix of the file says the form.

    Returns: number of rows.
    Raises:  StoreError B-STORE-012 for another suffix, or Parquet without its library; OSError;
             B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    if path.suffix not in FORMATS:
        raise StoreError("B-STORE-012", "is neither .csv nor .parquet", where=str(path), next_step="name such a file")
    if path.suffix == ".parquet" and find_spec("pyarrow") is None:
        raise StoreError(
            "B-STORE-012",
            "Parquet needs a library that is not installed",
            where=str(path),
            next_step="install it with: pip install 'inertial-bench[parquet]', or export to .csv",
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".part")
    write = _write_csv if path.suffix == ".csv" else _write_parquet
    with reading(url) as connection:
        count = write(_rows(connection, filters), unfinished)
    unfinished.replace(path)
    return count


def _rows(connection: Connection, filters: Filters) -> Iterator[dict[str, Any]]:
    for calibration in connection.execute(selected(connection, filters)).mappings().all():
        revisions = (
            select(report_revisions.c.number, report_revisions.c.result_set_id, result_sets.c.method)
            .add_columns(report_revisions.c.software)
            .join(result_sets, result_sets.c.id == report_revisions.c.result_set_id)
            .where(report_revisions.c.calibration_id == calibration["id"])
            .order_by(report_revisions.c.number)
        )
        for revision in connection.execute(revisions).mappings().all():
            head = {
                **{name: calibration[name] for name in ("session", "session_sha256", "campaign", "uut_model")},
                **{name: calibration[name] for name in ("uut_serial", "simulated")},
                "started_utc": utc_text(calibration["started_utc_ns"]),
                "revision": revision["number"],
                "newest": revision["number"] == calibration["revision"],
                "method": revision["method"],
                "software": revision["software"],
            }
            for estimate in stored_estimates(connection, revision["result_set_id"]):
                if filters.quantity in (None, estimate["quantity"]):
                    yield {**head, **_estimate(estimate)}


def _estimate(estimate: dict[str, Any]) -> dict[str, Any]:
    conditions = estimate["conditions"]
    text = json.dumps(conditions, sort_keys=True, ensure_ascii=False)
    ends = limits_of(estimate) or (-math.inf, math.inf)
    limits = {name: end if math.isfinite(end) else None for name, end in zip(("low", "high"), ends, strict=True)}
    return {**estimate, **{name: conditions.get(name) for name in _CONDITIONS}, "conditions": text, **limits}


def _write_csv(rows: Iterator[dict[str, Any]], path: Path) -> int:
    """Numbers as the shortest text that is read back as the same number; an absent one is empty."""
    names = [name for name, _ in COLUMNS]
    count = 0
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, names, extrasaction="ignore")
        writer.writeheader()
        for row in rows:
            writer.writerow(row)
            count += 1
    return count


def _write_parquet(rows: Iterator[dict[str, Any]], path: Path) -> int:
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = {"string": pa.string(), "bool": pa.bool_(), "int64": pa.int64(), "double": pa.float64()}
    schema = pa.schema([(name, types[kind]) for name, kind in COLUMNS])
    count = 0
    with pq.ParquetWriter(path, schema) as writer:
        held: list[dict[str, Any]] = []
        for row in rows:
            held.append({name: row[name] for name, _ in COLUMNS})
            count += 1
            if len(held) == _BATCH:
                writer.write_table(pa.Table.from_pylist(held, schema=schema))
                held = []
        writer.write_table(pa.Table.from_pylist(held, schema=schema))
    return count
