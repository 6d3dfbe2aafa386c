"""Decoded frames as columns: fields are cut out of the frame bytes only when somebody asks for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.frame.layout import Field, Message
from bench.model.errors import InputError

Extract = Callable[[NDArray[np.uint8], Field], NDArray[Any]]
"""Cuts one field out of the frame bytes (n, body): (n,) or (n, count), native byte order."""


class MessageBatch:
    """n frames of one message, in stream order.

    Attributes:
        offset: (n,) int64, stream offset of the first sync byte.
        ends: (n,) int64, stream offsets behind the frames where these vary on the wire beyond their "rest"; else None.
        rows: (n, body) uint8, the frames without check and without bytes of variable length.
        t_ns: (n,) int64, receive stamp of the chunk that completed the frame; None outside a link.
        counter: (n,) int64, unwrapped counter, which never falls except on a repeated frame (it then carries the
            counter of the frame it repeats); None without a counter or outside a link.
        suspect: (n,) bool, check passed but a constant differs or the counter is out of line.
    """

    __slots__ = ("_columns", "_extract", "counter", "ends", "message", "offset", "rest", "rows", "suspect", "t_ns")

    def __init__(self, message: Message, offset: NDArray[np.int64], rows: NDArray[np.uint8], rest: list[bytes] | None,
                 extract: Extract) -> None:  # fmt: skip
        self.message = message
        self.offset = offset
        self.rows = rows
        self.rest = rest
        self.ends: NDArray[np.int64] | None = None
        self.t_ns: NDArray[np.int64] | None = None
        self.counter: NDArray[np.int64] | None = None
        self._extract = extract
        self._columns: dict[str, NDArray[Any]] = {}
        self.suspect = self._constants_differ()

    def __len__(self) -> int:
        return len(self.offset)

    def raw(self, name: str) -> NDArray[Any]:
        """Raw values of a field, or of a bit range as "field.bits": (n,) or (n, count).

        Integers keep the smallest native type that holds them (u24 -> uint32): widen before subtracting. Bytes of
        variable length give an object array of bytes.
        Raises: InputError B-FRAME-022 for an unknown name.
        """
        column = self._columns.get(name)
        if column is None:
            column = self._columns[name] = self._cut(name)
        return column

    def scaled(self, name: str) -> NDArray[np.float64]:
        """Return values in the field's unit (raw * scale + offset) as float64, (n,) or (n, count); NaN if not there."""
        item = self._field(name)
        values = self.raw(name).astype(np.float64)
        if "." not in name and item.scaled:
            values = values * item.scale + item.shift
        missing = self.missing(name)
        if missing is not None:
            values[missing] = np.nan
        return values

    def missing(self, name: str) -> NDArray[np.bool_] | None:
        """Return where a frame does not hold a value of a group or of an optional part, shaped as the values are.

        None for a field that every frame holds.
        """
        item, there = self._field(name), self.there(name)
        if there is None:
            return None
        number = np.arange(item.count or 1) if item.step else np.zeros(item.count or 1)
        missing: NDArray[np.bool_] = number >= there[:, None]
        return missing[:, 0] if item.count is None else missing

    def there(self, name: str) -> NDArray[Any] | None:
        """Return how many elements of a field of a group are there, of an optional one whether; (n,), None: always."""
        item = self._field(name)
        return self.raw(item.given) if item.given else None

    def newest(self, name: str) -> float:
        """Return the value of a field in the last frame, in its unit; of an array the mean. At least one is needed.

        NaN where the frame does not hold it, or not all of it.
        """
        item = self._field(name)
        column = self.scaled(name)[-1:] if item.given else self.raw(name)
        if item.given:
            return float(column.mean())
        last = column[-1].astype(np.float64)
        if item.scaled and "." not in name:
            last = last * item.scale + item.shift
        return float(last) if column.ndim == 1 else float(np.add.reduce(last) / len(last))

    def has_scale(self, name: str) -> bool:
        """Return whether physical and raw values of a field differ."""
        return "." not in name and self._field(name).scaled

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all fields by name, in wire order."""
        return {item.name: self.raw(item.name) for item in self.message.fields}

    @staticmethod
    def join(parts: Sequence[MessageBatch]) -> MessageBatch:
        """Batches of one message that follow each other in the stream, as one; at least one is needed."""
        return parts[0] if len(parts) == 1 else JoinedBatch(parts)

    def _field(self, name: str) -> Field:
        fields = self.message.by_name
        base, dot, part = name.partition(".")
        if base not in fields or (dot and part not in fields[base].bits):
            raise InputError(
                "B-FRAME-022",
                f"the message {self.message.name!r} has no field {name!r}",
                where="frame definition",
                next_step=f"use one of: {', '.join(fields)}",
            )
        return fields[base]

    def _cut(self, name: str) -> NDArray[Any]:
        item = self._field(name)
        if item.rest:
            column = np.empty(len(self), object)
            column[:] = self.rest
            return column
        if "." not in name:
            return self._extract(self.rows, item)
        low, width = item.bits[name.partition(".")[2]]
        whole = self.raw(item.name)
        kind = whole.dtype.type
        return np.asarray((whole >> kind(low)) & kind((1 << width) - 1))

    def _constants_differ(self) -> NDArray[np.bool_]:
        different = np.zeros(len(self.offset), np.bool_)
        for item in self.message.constants:
            expected = np.frombuffer(item.constant or b"", np.uint8)
            different |= (self.rows[:, item.offset : item.offset + item.length] != expected).any(axis=1)
        return different


class JoinedBatch(MessageBatch):
    """Batches of one message that follow each other in the stream; a column is put together when it is asked for."""

    __slots__ = ("_parts",)

    def __init__(self, parts: Sequence[MessageBatch]) -> None:
        self.message = parts[0].message
        self.offset = np.concatenate([part.offset for part in parts])
        self.suspect = np.concatenate([part.suspect for part in parts])
        stamps = [part.t_ns for part in parts if part.t_ns is not None]
        self.t_ns = np.concatenate(stamps) if stamps else None
        counters = [part.counter for part in parts if part.counter is not None]
        self.counter = np.concatenate(counters) if counters else None
        ends = [part.ends for part in parts if part.ends is not None]
        self.ends = np.concatenate(ends) if ends else None
        self._columns = {}
        self._parts = parts

    def __getattr__(self, name: str) -> Any:
        """Put together what is asked for the first time."""
        if name == "rows":
            self.rows = np.concatenate([part.rows for part in self._parts])
            return self.rows
        if name == "rest":
            without = self._parts[0].rest is None
            self.rest = None if without else [value for part in self._parts for value in part.rest or []]
            return self.rest
        raise AttributeError(name)

    def _cut(self, name: str) -> NDArray[Any]:
        columns = [part.raw(name) for part in self._parts]
        for part in self._parts:
            part._columns.pop(name, None)  # not to be kept twice
        return np.concatenate(columns)


class FrameBatch(NamedTuple):
    """The yield of one feed: accepted frames by message, offsets of rejected candidates, bytes now behind us.

    ``position``: stream offset up to which every byte is decided. A rejected candidate is a full sync pattern, with
    all bytes of its frame there, whose check (or length, or type) fails and that lies inside no accepted frame.
    """

    messages: Mapping[str, MessageBatch]
    bad_offset: NDArray[np.int64]
    position: int


@dataclass
class FrameCounts:
    """Running totals of a decoder."""

    bytes: int = 0
    frames: int = 0
    bad: int = 0
    skipped_bytes: int = 0
    other: int = 0
    by_message: dict[str, int] = field(default_factory=dict)
