"""One MCAP file of tables for Foxglove and PlotJuggler: a channel for each, JSON messages with a JSON Schema.

Each row is a message at its UTC. Any MCAP reader finds channels and times through the summary.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench import __version__
from bench.record import mcap_format as mcap
from bench.tables.columns import T_MONO, UNITS
from bench.tables.library import pandas
from bench.tables.plain import flat, words_of

if TYPE_CHECKING:
    from pandas import DataFrame, Series

CHUNK_BYTES = 1_000_000
_SCHEMA = 0x03
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_FIXED = _MESSAGE.size - mcap.RECORD.size


class _Channel:
    """A table: its records in the file, and how many of its messages are written."""

    def __init__(self, file: McapFile, topic: str, block: DataFrame) -> None:
        self._file, self.messages = file, 0
        self.number = number = len(file.channels) + 1
        name, schema = topic.strip("/").replace("/", "."), json.dumps(json_schema(topic, block)).encode()
        head = number.to_bytes(2, "little")
        described = head + mcap.text(name) + mcap.text("jsonschema") + len(schema).to_bytes(4, "little") + schema
        self.schema = mcap.record(_SCHEMA, described)
        self.channel = mcap.channel(number, topic, "json", {"session": block.attrs["session"]}, number)

    def write(self, block: DataFrame) -> None:
        """Append rows, each at its time."""
        self._file.write(self, block)

    def close(self) -> None:
        """Nothing: the file is finished as a whole."""


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


class McapFile:
    """Writes an MCAP file, lz4 chunks of about a megabyte. ``offset_ns``: UTC minus the monotonic time of rows."""

    def __init__(self, path: Path, offset_ns: int) -> None:
        self._stream = path.open("wb")
        self._offset_ns, self._last_ns = offset_ns, 0
        self.channels: list[_Channel] = []
        self._parts: list[bytes] = []
        self._size = 0
        self._entries: dict[int, list[int]] = {}
        self._indexes: list[bytes] = []
        self._span: tuple[int, int] | None = None
        self._crc = self._at = 0
        self._put(mcap.MAGIC + mcap.header("", f"inertial-bench {__version__}"))

    def channel(self, topic: str, block: DataFrame) -> _Channel:
        """Begin a table; ``block`` has its columns."""
        made = _Channel(self, topic, block)
        self.channels.append(made)
        self._put(made.schema + made.channel)
        return made

    def write(self, channel: _Channel, block: DataFrame) -> None:
        """Append rows, each at its time; those that have none, such as estimates, at the last one before."""
        timed = block[T_MONO].tolist() if T_MONO in block else [self._last_ns - self._offset_ns] * len(block)
        t_utc_ns = [t_ns + self._offset_ns for t_ns in timed]
        self._last_ns = max([self._last_ns, *t_utc_ns])
        pairs = zip(*(_pairs(name, block[column]) for column, name in words_of(block).items()), strict=True)
        for t_ns, row in zip(t_utc_ns, pairs, strict=True):
            text = "{" + ",".join(filter(None, row)) + "}"
            self._message(channel, t_ns, text.encode())
            if self._size >= CHUNK_BYTES:
                self._flush()

    def _message(self, channel: _Channel, t_ns: int, payload: bytes) -> None:
        length = _MESSAGE_FIXED + len(payload)
        head = _MESSAGE.pack(mcap.MESSAGE, length, channel.number, channel.messages & 0xFFFFFFFF, t_ns, t_ns)
        self._entries.setdefault(channel.number, []).extend((t_ns, self._size))
        self._parts += (head, payload)
        self._size += len(head) + len(payload)
        channel.messages += 1

    def _flush(self) -> None:
        """Write the messages so far as a chunk with its indexes."""
        if not self._parts:
            return
        records = b"".join(self._parts)
        times = [t_ns for entries in self._entries.values() for t_ns in entries[::2]]
        span = min(times), max(times)
        parts, _, index = mcap.chunk_of(records, span, self._entries, self._at)
        self._put(b"".join(parts))
        self._indexes.append(index)
        before = self._span or span
        self._span = (min(before[0], span[0]), max(before[1], span[1]))
        self._parts, self._size, self._entries = [], 0, {}

    def close(self) -> None:
        """Write data end, summary and footer."""
        self._flush()
        counts = {channel.number: channel.messages for channel in self.channels}
        groups = [
            (_SCHEMA, b"".join(channel.schema for channel in self.channels)),
            (mcap.CHANNEL, b"".join(channel.channel for channel in self.channels)),
            (mcap.STATISTICS, self._statistics(counts)),
            (mcap.CHUNK_INDEX, b"".join(self._indexes)),
        ]
        self._put(mcap.ending(self._crc, self._at, groups))
        self._stream.close()

    def abandon(self) -> None:
        """Let go of a file that will not be finished."""
        self._stream.close()

    def _statistics(self, counts: dict[int, int]) -> bytes:
        return mcap.statistics(len(counts), len(self._indexes), self._span or (0, 0), counts, schemas=len(counts))

    def _put(self, block: bytes) -> None:
        self._stream.write(block)
        self._crc = zlib.crc32(block, self._crc)
        self._at += len(block)


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
