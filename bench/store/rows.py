"""Rows as a file for other tools: CSV with exact numbers, or Parquet."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bench.store.errors import StoreError

Row = dict[str, Any]
Columns = Sequence[tuple[str, str]]  # name, type as Parquet calls it
FORMATS = (".csv", ".parquet")
_BATCH = 50_000


def columns_of(names: Iterable[str], **kinds: str) -> Columns:
    """Return columns by name, with the type of those that are no text."""
    return tuple((name, kinds.get(name, "string")) for name in names)


def check_form(path: Path) -> None:
    """Refuse a file that cannot be. Raises: StoreError B-STORE-012: another suffix, or Parquet is not installed."""
    if path.suffix not in FORMATS:
        raise StoreError("B-STORE-012", "is neither .csv nor .parquet", where=path, next_step="name such a file")
    if path.suffix == ".parquet" and find_spec("pyarrow") is None:
        raise StoreError(
            "B-STORE-012",
            "Parquet needs a library that is not installed",
            where=path,
            next_step="install it with: pip install 'inertial-bench[parquet]', or export to .csv",
        )


def write_rows(path: Path, columns: Columns, rows: Iterable[Row]) -> int:
    """Write rows; the suffix of the file says the form. The same rows give the same bytes.

    Returns: number of rows.
    Raises:  StoreError B-STORE-012; OSError.
    """
    check_form(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".part")
    write = _write_csv if path.suffix == ".csv" else _write_parquet
    try:
        count = write(unfinished, columns, rows)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return count


def _write_csv(path: Path, columns: Columns, rows: Iterable[Row]) -> int:
    """Numbers as the shortest text that is read back as the same number; an absent one is empty."""
    count = 0
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [name for name, _ in columns], extrasaction="ignore")
        writer.writeheader()
        for row in rows:
            writer.writerow(row)
            count += 1
    return count


def _write_parquet(path: Path, columns: Columns, rows: Iterable[Row]) -> int:
    import pyarrow as pa
    import pyarrow.parquet as pq

    types = {"string": pa.string(), "bool": pa.bool_(), "int64": pa.int64(), "double": pa.float64()}
    schema = pa.schema([(name, types[kind]) for name, kind in columns])
    count = 0
    with pq.ParquetWriter(path, schema) as writer:
        held: list[Row] = []
        for row in rows:
            held.append({name: row[name] for name, _ in columns})
            count += 1
            if len(held) == _BATCH:
                writer.write_table(pa.Table.from_pylist(held, schema=schema))
                held = []
        writer.write_table(pa.Table.from_pylist(held, schema=schema))
    return count
