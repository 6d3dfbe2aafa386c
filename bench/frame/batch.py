"""Rows of frame bytes: fields and checks read and written; decoded frames as columns, cut when somebody asks for them.

A field is read and written where it stands, as numbers at a stride or as bytes in one piece, never byte by byte.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from bench.frame.layout import Field, Layout, Message
from bench.frame.parts import unpacked
from bench.model.arrays import Array, Flags, Floats, Integers, Octets
from bench.model.errors import InputError


class MessageBatch:
    """n frames of one message, in stream order.

    Attributes:
        offset: (n,) int64, stream offset of the first sync byte.
        ends: (n,) int64, stream offsets behind the frames.
        rows: (n, body) uint8, the frames without check and without bytes of variable length.
        t_ns: (n,) int64, receive stamp of the chunk that completed the frame; None outside a link.
        counter: (n,) int64, unwrapped counter, which never falls except on a repeated frame (it then carries the
            counter of the frame it repeats); None without a counter or outside a link.
        suspect: (n,) bool, check passed but a constant differs or the counter is out of line.
    """

    __slots__ = ("_columns", "counter", "ends", "message", "offset", "rest", "rows", "suspect", "t_ns")

    def __init__(self, message: Message, offset: Integers, rows: Octets, rest: list[bytes] | None) -> None:
        self.message = message
        self.offset = offset
        self.rows = rows
        self.rest = rest
        self.ends = offset
        self.t_ns: Integers | None = None
        self.counter: Integers | None = None
        self._columns: dict[str, Array] = {}
        self.suspect = self._constants_differ()

    def __len__(self) -> int:
        return len(self.offset)

    def raw(self, name: str) -> Array:
        """Raw values of a field, or of a bit range as "field.bits": (n,) or (n, count).

        Integers keep the smallest native type that holds them (u24 -> uint32): widen before subtracting. Bytes of
        variable length give an object array of bytes.
        Raises: InputError B-FRAME-022 for an unknown name.
        """
        column = self._columns.get(name)
        if column is None:
            column = self._columns[name] = self._cut(name)
        return column

    def scaled(self, name: str) -> Floats:
        """Return values in the field's unit (raw * scale + offset) as float64, (n,) or (n, count); NaN if not there."""
        item = self._field(name)
        with np.errstate(all="ignore"):  # what a frame holds may be any number
            values = self.raw(name).astype(np.float64)
            if "." not in name and item.scaled:
                values = values * item.scale + item.shift
        missing = self.missing(name)
        if missing is not None:
            values[missing] = np.nan
        return values

    def missing(self, name: str) -> Flags | None:
        """Return where a frame does not hold a value of a group or of an optional part, shaped as the values are.

        None for a field that every frame holds.
        """
        item, there = self._field(name), self.there(name)
        if there is None:
            return None
        number = np.arange(item.count or 1) if item.step else np.zeros(item.count or 1)
        missing: Flags = number >= there[:, None]
        return missing[:, 0] if item.count is None else missing

    def there(self, name: str) -> Array | None:
        """Return how many elements of a field of a group are there, of an optional one whether; (n,), None: always."""
        item = self._field(name)
        return self.raw(item.given) if item.given else None

    def newest(self, name: str) -> float:
        """Return the value of a field in the last frame, in its unit; of an array the mean. At least one is needed.

        NaN where the frame does not hold it, or not all of it.
        """
        return float(self.scaled(name)[-1].mean())

    def has_scale(self, name: str) -> bool:
        """Return whether physical and raw values of a field differ."""
        return "." not in name and self._field(name).scaled

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

    def _cut(self, name: str) -> Array:
        item = self._field(name)
        if item.rest:
            column = np.empty(len(self), object)
            column[:] = self.rest
            return column
        if "." not in name:
            return extract_column(self.rows, item)
        low, width = item.bits[name.partition(".")[2]]
        whole = self.raw(item.name)
        kind = whole.dtype.type
        return np.asarray((whole >> kind(low)) & kind((1 << width) - 1))

    def _constants_differ(self) -> Flags:
        different = np.zeros(len(self.offset), np.bool_)
        for item in self.message.constants:
            expected = np.frombuffer(item.constant or b"", np.uint8)
            different |= (self.rows[:, item.span] != expected).any(axis=1)
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
        self.ends = np.concatenate([part.ends for part in parts])
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

    def _cut(self, name: str) -> Array:
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
    bad_offset: Integers
    position: int


@dataclass
class FrameCounts:
    """Running totals of a decoder."""

    bytes: int = 0
    frames: int = 0
    bad: int = 0
    skipped_bytes: int = 0
    other: int = 0


class Decoder:
    """What all engines have in common; they give the same results on any input and any chunking.

    ``_tail``: the bytes from stream offset ``_position`` on, which are not decided yet.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._tail = b""
        self._position = 0
        self.counts = FrameCounts()

    def feed(self, chunk: bytes, final: bool = False, before: int = 0) -> FrameBatch:
        """Decode what can be decided of the tail and these bytes; the rest waits for the next feed.

        ``final``: nothing will follow.   ``before``: stream offset up to which nothing waits.
        """
        raise NotImplementedError

    def finish(self) -> FrameBatch:
        """End of the stream: candidates whose bytes never came are no frames."""
        return self.feed(b"", final=True)

    def give_up(self, before: int) -> FrameBatch:
        """Reject what was begun before the stream offset ``before`` and is not whole yet, byte by byte."""
        return self.feed(b"", before=before)

    def _decided(
        self, messages: Mapping[str, MessageBatch], numbers: Sequence[int], bad: Integers, stream: bytes, consumed: int
    ) -> FrameBatch:
        """Count frames by kind and rejected candidates (stream offsets); keep the bytes behind ``consumed``."""
        listed = len(self._layout.messages)
        self.counts.frames += sum(numbers[:listed])
        self.counts.other += sum(numbers[listed:])
        self.counts.bad += len(bad)
        self._tail = stream[consumed:]
        self._position += consumed
        return FrameBatch(messages, bad, self._position)


def extract_column(rows: Octets, item: Field) -> Array:
    """Raw values of a field: (n,) or (n, count), native byte order; bytes give (n, count) uint8.

    Args: rows: (n, body) uint8, any strides between rows; at least one byte stands before the field (the sync).
    """
    if item.kind == "b":
        return rows[:, item.span].copy()
    width, apart = np.dtype(item.dtype).itemsize, item.packed or item.step
    if item.size == width and not apart:
        column = _natural(rows, item)
    elif item.kind == "u" and item.elements == 1 and item.big and item.end >= width and not apart:
        column = _overlapped(rows, item)
    else:
        column = _scattered(rows, item)
    return column.reshape(len(rows)) if item.count is None else column


def store_column(rows: Octets, item: Field, values: Array) -> None:
    """Write values of a field that fit it: (n, count), (1, count), or (n, 1) or (1, 1) where all elements are alike."""
    if values.shape[1] != item.elements:
        values = np.broadcast_to(values, (len(values), item.elements))
    if item.packed or item.step:
        _store_bits(rows, item, values)
        return
    target = rows[:, item.span]
    wire = np.ascontiguousarray(values, _wire(item))
    width = wire.itemsize
    if item.size == width:  # all elements in one piece
        target.view(f"V{item.length}")[:] = wire.view(f"V{item.length}")
        return
    surplus = width - item.size if item.big else 0
    packed = wire.view(np.uint8).reshape(*wire.shape, width)[..., surplus : surplus + item.size]
    target.view(f"V{item.size}")[:] = packed.view(f"V{item.size}")[..., 0]


def _wire(item: Field) -> np.dtype[Any]:
    return np.dtype(item.dtype).newbyteorder(">" if item.big else "<")


def _natural(rows: Octets, item: Field) -> Array:
    place, wire = rows[:, item.span], _wire(item)
    if item.elements > 1:
        place = np.ascontiguousarray(place.view(f"V{item.length}"))
    return place.view(wire).astype(item.dtype).reshape(len(rows), item.elements)


def _overlapped(rows: Octets, item: Field) -> Array:
    """A big-endian u24/u40.. read as a wider integer that begins in the byte before it; the surplus is masked off."""
    width = np.dtype(item.dtype).itemsize
    wide = rows[:, item.offset + item.size - width : item.offset + item.size].view(f">u{width}").astype(f"u{width}")
    return np.asarray(wide & wide.dtype.type((1 << (8 * item.size)) - 1))


def _scattered(rows: Octets, item: Field) -> Array:
    """Elements that are no whole bytes or lie apart: the bytes that hold one, shifted to its lowest bit."""
    column = np.empty((len(rows), item.elements), np.uint64)
    for begin, alike, at in item.begins:
        size = -(-(begin + item.width) // 8)
        value = np.zeros((len(rows), len(alike)), np.uint64)
        for index in range(size):
            value = value << np.uint64(8) | rows[:, at + (index if item.big else size - 1 - index)]
        column[:, alike] = value >> np.uint64(8 * size - begin - item.width if item.big else begin)
    if item.kind == "f":
        return column.astype(f"u{item.size}").view(item.dtype)
    unused = np.uint64(64 - item.width)
    column <<= unused
    signed = column.view(np.int64) if item.kind == "i" else column
    return (signed >> signed.dtype.type(unused)).astype(item.dtype)


def _store_bits(rows: Octets, item: Field, values: Array) -> None:
    """Set the bits of elements that are no whole bytes or lie apart; those of their neighbours stay."""
    values = np.ascontiguousarray(values, item.dtype)
    if item.kind == "f":
        values = values.view(f"u{item.size}")
    for element in range(values.shape[1]):
        at, odd = item.place(element)
        size = -(-(odd + item.width) // 8)
        value = values[:, element].astype(np.uint64) & np.uint64((1 << item.width) - 1)
        value <<= np.uint64(8 * size - odd - item.width if item.big else odd)
        for index in range(size):
            shift = 8 * (size - 1 - index if item.big else index)
            rows[:, at + index] |= (value >> np.uint64(shift) & np.uint64(255)).astype(np.uint8)


def rows_of_frames(message: Message, frames: Iterable[bytes], tail: int) -> tuple[Octets, list[bytes] | None]:
    """Return rows (n, body) uint8 of frames that fit, and their bytes of variable length if the message has any."""
    if message.parts:
        found = [unpacked(message, frame, len(frame) - tail) for frame in frames]
        contents = [content for content in found if not isinstance(content, str)]
    else:
        contents = [(frame[: message.body], frame[message.body : len(frame) - tail]) for frame in frames]
    rows = np.frombuffer(b"".join(row for row, _ in contents), np.uint8).reshape(len(contents), message.body)
    return rows, None if message.rest is None else [rest for _, rest in contents]


def are_right(layout: Layout, message: Message, rows: Octets) -> Flags:
    """Return for each frame (n, length) whether its check and its trailer are right, (n,)."""
    right = extract_column(rows, _stored(layout, rows.shape[1])) == _computed(layout, message, rows)
    if layout.trailer:
        right &= (rows[:, -len(layout.trailer) :] == np.frombuffer(layout.trailer, np.uint8)).all(axis=1)
    return np.asarray(right)


def seal(layout: Layout, message: Message, rows: Octets) -> None:
    """Write the check and the trailer of frames (n, length) whose fields are there."""
    if layout.trailer:
        rows[:, -len(layout.trailer) :] = np.frombuffer(layout.trailer, np.uint8)
    if layout.check.size:
        store_column(rows, _stored(layout, rows.shape[1]), _computed(layout, message, rows)[:, np.newaxis])


def _stored(layout: Layout, length: int) -> Field:
    """Return where the check stands in a frame of that length."""
    at = length - layout.tail if layout.check_field is None else layout.check_field.offset
    return _check_at(layout.check.size, at, layout.stored_big)


@lru_cache(maxsize=512)
def _check_at(size: int, at: int, big: bool) -> Field:
    return Field("check", "u", size, None, at, big)


def _computed(layout: Layout, message: Message, rows: Octets) -> Array:
    length = rows.shape[1]
    stop = length - layout.tail if message.cover_stop is None else message.cover_stop
    covered = rows[:, message.cover_start : stop]
    held = None if layout.check_field is None else layout.check_field.offset - message.cover_start
    if held is not None and 0 <= held < covered.shape[1]:
        covered = covered.copy()
        covered[:, held : held + layout.check.size] = 0
    if message.extra:
        extra = np.frombuffer(message.extra, np.uint8)
        covered = np.hstack((covered, np.broadcast_to(extra, (len(covered), len(extra)))))
    return layout.check.of_rows(covered)
