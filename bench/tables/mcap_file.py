"""One MCAP file of tables for Foxglove and PlotJuggler: a channel for each, JSON messages with a JSON Schema.

Each row is a message at its UTC. Any MCAP reader finds channels and times through the summary.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import __version__
from bench.tables.columns import T_MONO, UNITS
from bench.tables.library import library, pandas
from bench.tables.plain import flat, words_of

if TYPE_CHECKING:
    from pandas import DataFrame, Series

CHUNK_BYTES = 1_000_000


def json_schema(topic: str, block: DataFrame) -> dict[str, Any]:
    """Return the JSON Schema of a table's rows: type of each column, its unit as description.

    Foxglove takes one type for each property: what may be absent is left out of a message, not null.
    """
    names = words_of(block)
    columns = {name: _json_type(block[column]) for column, name in names.items()}
    for column, unit in block.attrs[UNITS].items():
        columns[names[column]]["description"] = unit
    return {"type": "object", "title": topic, "properties": columns}


def _json_type(column: Series) -> dict[str, Any]:
    kinds = pandas().api.types
    if kinds.is_bool_dtype(column.dtype):
        return {"type": "boolean"}
    if kinds.is_numeric_dtype(column.dtype):
        return {"type": "number"}  # an "integer" counts as 32 bits in Foxglove
    return {"type": "object", "properties": {}} if _holds_objects(column) else {"type": "string"}


def _holds_objects(column: Series) -> bool:
    return column.dtype == object and len(column) > 0 and all(isinstance(value, dict) for value in column)


class _Channel:
    """A table of the file."""

    def __init__(self, file: McapFile, number: int) -> None:
        self._file, self._number = file, number

    def write(self, block: DataFrame) -> None:
        """Append rows, each at its time."""
        self._file.write(self._number, block)

    def close(self) -> None:
        """Nothing: the file is finished as a whole."""


class McapFile:
    """Writes an MCAP file, lz4 chunks of about a megabyte. ``offset_ns``: UTC minus the monotonic time of rows."""

    def __init__(self, path: Path, offset_ns: int) -> None:
        self._stream = path.open("wb")
        self._offset_ns, self._last_ns = offset_ns, 0
        mcap = library("mcap.writer")
        self._writer = mcap.Writer(
            self._stream, chunk_size=CHUNK_BYTES, compression=mcap.CompressionType.LZ4, enable_data_crcs=True
        )
        self._writer.start(library=f"inertial-bench {__version__}")

    def channel(self, topic: str, block: DataFrame) -> _Channel:
        """Begin a table; ``block`` has its columns."""
        name, schema = topic.strip("/").replace("/", "."), json.dumps(json_schema(topic, block)).encode()
        number = self._writer.register_schema(name, "jsonschema", schema)
        return _Channel(self, self._writer.register_channel(topic, "json", number, {"session": block.attrs["session"]}))

    def write(self, number: int, block: DataFrame) -> None:
        """Append rows, each at its time; those that have none, such as estimates, at the last one before."""
        timed = block[T_MONO].tolist() if T_MONO in block else [self._last_ns - self._offset_ns] * len(block)
        t_utc_ns = [t_ns + self._offset_ns for t_ns in timed]
        self._last_ns = max([self._last_ns, *t_utc_ns])
        pairs = zip(*(_pairs(name, block[column]) for column, name in words_of(block).items()), strict=True)
        for t_ns, row in zip(t_utc_ns, pairs, strict=True):
            text = "{" + ",".join(filter(None, row)) + "}"
            self._writer.add_message(number, t_ns, text.encode(), t_ns)

    def close(self) -> None:
        """Write summary and footer."""
        self._writer.finish()
        self._stream.close()

    def abandon(self) -> None:
        """Let go of a file that will not be finished."""
        self._stream.close()


def _pairs(name: str, column: Series) -> list[str]:
    """Return the cells of a column as JSON behind its name, "" for what is absent or not finite."""
    key = f"{json.dumps(name)}:"
    if pandas().api.types.is_datetime64_any_dtype(column.dtype):
        return [f'{key}"{stamp.isoformat()}"' for stamp in column]
    if column.dtype == object and not _holds_objects(column):
        column = flat(column.to_frame()).iloc[:, 0]
    values = column.tolist()
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "iu":
        return [f"{key}{value}" for value in values]
    if isinstance(column.dtype, np.dtype) and column.dtype.kind == "f":
        return [f"{key}{value!r}" if math.isfinite(value) else "" for value in values]
    absent = column.isna().tolist()
    return ["" if gone else f"{key}{json.dumps(value)}" for value, gone in zip(values, absent, strict=True)]
