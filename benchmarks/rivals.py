"""What a script for one unit does with frames of a layout: a loop over struct, and the package construct."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from itertools import groupby
from typing import Any

from bench.frame import FrameDefinition
from bench.frame.layout import Field, Layout, Message, Part, Span

Read = Callable[[bytes], object]
"""Takes all fields out of one frame."""
_CODES = {"u1": "B", "u2": "H", "u4": "I", "u8": "Q", "i1": "b", "i2": "h", "i4": "i", "i8": "q", "f4": "f", "f8": "d"}


def one_by_one(definition: FrameDefinition, readers: Mapping[str, Read], stream: bytes) -> int:
    """Find and check one frame after the other (find, crcmod or sum), and have its fields read; gives the frames."""
    layout = definition.layout
    if layout.lines is not None:
        return sum(1 for _ in _lines(layout, stream))
    frames = at = 0
    bodies = {message.type_value: message for message in layout.messages}
    while (at := stream.find(layout.pattern, at)) >= 0 and at + layout.header <= len(stream):
        message = bodies[_number(stream, at, layout.type_field, layout.type_bits)]
        size = message.length
        if layout.length_field is not None:
            stated = _number(stream, at, layout.length_field, layout.length_bits) or 0
            size = stated * layout.length_times + layout.length_plus
        frame = stream[at : at + size]
        if not _checked(layout, frame, message.cover_start, message.cover_stop):
            at += 1
            continue
        readers[message.name](frame)
        frames += 1
        at += size
    return frames


def _lines(layout: Layout, stream: bytes) -> Iterator[list[float | str]]:
    """Yield the values of the lines whose check is right, numbers as floats."""
    for line in stream.split(b"\r\n"):
        body, _, due = line[1:].rpartition(b"*")
        if due and layout.check.of(body) == int(due, 16):
            yield [_value(text) for text in body.decode().split(",")]


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def struct_readers(definition: FrameDefinition) -> dict[str, Read]:
    """Return for each message what takes its fields out with struct."""
    return {message.name: _struct_reader(message, definition.layout) for message in definition.layout.messages}


def _struct_reader(message: Message, layout: Layout) -> Read:
    fixed = [item for item in message.fields if not message.parts or item.offset + item.length <= message.head]
    codes = [(_take(item), item.offset) for item in fixed if item.packed is None and item.kind != "b"]
    runs = [(run[0].offset, run[-1].offset + run[-1].length, run) for run in _runs(fixed)]

    def read(frame: bytes) -> None:
        for take, offset in codes:
            take(frame, offset)
        for start, stop, run in runs:
            _bits(frame[start:stop], run)
        at = message.head
        for part in message.parts:
            at = _read_part(part, message, frame, at, len(frame) - layout.tail)

    return read


def _read_part(part: Part, message: Message, frame: bytes, at: int, stop: int) -> int:
    inside = [item for item in message.fields if part.at <= item.offset < part.at + part.size]
    if part.kind == "items":
        size_of = {item.number: item for item in part.items}
        while at < stop:
            number, size = struct.unpack_from(f">{'H' if part.id_size == 2 else 'B'}B", frame, at)
            at += part.id_size + part.length_size
            for field in message.fields if number in size_of else ():
                if size_of[number].at < field.offset <= size_of[number].at + size_of[number].size:
                    _take(field)(frame, at + field.offset - size_of[number].at - 1)
            at += size
        return at
    sets = 1 if part.by is None else _number(frame, 0, part.by, part.bits) or 0
    for _ in range(sets):
        for item in inside:
            if item.packed is None:
                _take(item, 1)(frame, at + item.offset - part.at)
        for run in _runs(inside):
            _bits(frame[at : at + part.size], run)
        at += part.size
    return at


def _bits(packed: bytes, run: list[Field]) -> list[int]:
    whole, left = int.from_bytes(packed, "big" if run[0].big else "little"), 8 * len(packed)
    values = []
    for item in run:
        left -= item.width
        values.append(whole >> left & (1 << item.width) - 1)
    return values


def _runs(fields: list[Field]) -> list[list[Field]]:
    """Return integers that are no whole bytes, as far as they follow each other."""
    return [list(run) for odd, run in groupby(fields, lambda item: item.packed is not None) if odd]


def _take(item: Field, count: int | None = None) -> Callable[[bytes, int], object]:
    """Return what takes ``count`` elements of a field out of a frame, from a byte on."""
    return _taking(item.kind, item.size, count or item.count or 1, item.big)


@cache
def _taking(kind: str, size: int, elements: int, big: bool) -> Callable[[bytes, int], object]:
    if f"{kind}{size}" in _CODES:
        return struct.Struct(f"{'>' if big else '<'}{elements}{_CODES[f'{kind}{size}']}").unpack_from
    order: Any = "big" if big else "little"
    ends = range(size, size * elements + 1, size)

    def take(frame: bytes, at: int) -> list[int]:
        return [int.from_bytes(frame[at + end - size : at + end], order, signed=kind == "i") for end in ends]

    return take


def _number(stream: bytes, at: int, item: Field | None, bits: Span | None) -> int | None:
    if item is None:
        return None
    begin = at + item.offset
    value = int.from_bytes(stream[begin : begin + item.length], "big" if item.big else "little")
    if item.packed is not None:
        value = value >> (8 * item.length - sum(item.packed) if item.big else item.packed[0]) & (1 << item.width) - 1
    return value if bits is None else value >> bits[0] & (1 << bits[1]) - 1


def _checked(layout: Layout, frame: bytes, start: int, stop: int | None) -> bool:
    size, end = layout.check.size, len(frame) - layout.tail
    at = end if layout.check_field is None else layout.check_field.offset
    stored = int.from_bytes(frame[at : at + size], "big" if layout.stored_big else "little")
    return layout.check.of(frame[start : end if stop is None else stop]) == stored


def construct_readers(definition: FrameDefinition, construct: Any) -> dict[str, Read]:
    """Return for each message what takes its fields out with construct."""
    return {
        message.name: partial(_parse, _struct_of(message, definition.layout, construct), definition.layout.tail)
        for message in definition.layout.messages
    }


def _parse(layout: Any, tail: int, frame: bytes) -> object:
    return layout.parse(frame[: len(frame) - tail])


def _struct_of(message: Message, layout: Layout, construct: Any) -> Any:
    head = [item for item in message.fields if not message.parts or item.offset + item.length <= message.head]
    first = min([item.offset for item in head if item.offset >= len(layout.sync)], default=0)
    members = [construct.Bytes(first), *_members(head, construct)] if not layout.sync_at else _members(head, construct)
    for part in message.parts:
        inside = [item for item in message.fields if part.at <= item.offset < part.at + part.size]
        body = construct.Struct(*_members(inside, construct, single=part.kind == "group"))
        said = partial(_said, part)
        if part.kind == "items":
            members.append(part.name / construct.GreedyRange(_item_of(part, message, construct)))
        elif part.kind == "group":
            members.append(part.name / construct.Array(said, body))
        else:
            members.append(part.name / construct.If(said, body))
    return construct.Struct(*members)


def _said(part: Part, context: Any) -> int:
    if part.by is None:
        return 1
    value = int(context[part.by.name])
    return value if part.bits is None else value >> part.bits[0] & (1 << part.bits[1]) - 1


def _item_of(part: Part, message: Message, construct: Any) -> Any:
    bodies = {}
    for item in part.items:
        fields = [field for field in message.fields if item.at < field.offset <= item.at + item.size]
        bodies[item.number] = construct.Struct(*_members(fields, construct))
    number, length = construct.BytesInteger(part.id_size), construct.BytesInteger(part.length_size)
    switch = construct.Switch(construct.this.number, bodies, default=construct.GreedyBytes)
    return construct.Struct(
        "number" / number, "length" / length, "body" / construct.FixedSized(construct.this.length, switch)
    )


def _members(fields: list[Field], construct: Any, single: bool = False) -> list[Any]:
    """Return construct's fields; ``single``: one set of a group."""
    members = []
    for odd, run in groupby(fields, lambda item: item.packed is not None):
        items = list(run)
        members += (
            [_bit_struct(items, construct)] if odd else [item.name / _kind(item, construct, single) for item in items]
        )
    return members


def _bit_struct(run: list[Field], construct: Any) -> Any:
    integers = [item.name / construct.BitsInteger(item.width, signed=item.kind == "i") for item in run]
    if run[0].big:
        return construct.Embedded(construct.BitStruct(*integers)) if hasattr(construct, "Embedded") else (
            "bits" / construct.BitStruct(*integers)
        )  # fmt: skip
    return "bits" / construct.ByteSwapped(construct.BitStruct(*reversed(integers)))


def _kind(item: Field, construct: Any, single: bool) -> Any:
    if item.kind == "b":
        return construct.GreedyBytes if item.rest else construct.Bytes(item.length)
    if item.kind == "f":
        kind = getattr(construct, f"Float{8 * item.size}{'b' if item.big else 'l'}")
    else:
        kind = construct.BytesInteger(item.size, signed=item.kind == "i", swapped=not item.big)
        if item.size in (1, 2, 4, 8):
            order = "b" if item.big else "l"
            kind = getattr(construct, f"Int{8 * item.size}{'s' if item.kind == 'i' else 'u'}{order}")
    return kind if item.count is None or single else construct.Array(item.count, kind)
