"""Frames whose contents vary: groups, optional parts, items, fields behind bytes of variable length.

What stands in such a frame becomes a row of fixed length, in which every field has its place, so that all behind it is
as for other frames. What a frame does not hold is NaN where it is a float, else zero, and its number says so.

Why the bytes behind sync bytes are no frame: for golden frames, and for what a capture holds that is bad.
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple

import numpy as np

from bench.frame.layout import Item, Layout, Message, Part, read_part
from bench.model.errors import InputError

Contents = tuple[bytes, bytes]
"""Row of a frame, and its bytes of variable length."""


def unpacked(message: Message, frame: bytes, stop: int) -> Contents | str:
    """Return what stands in a frame before byte ``stop``, or why it does not fit the message."""
    row, rest, at = bytearray(message.blank), b"", message.head
    row[:at] = frame[:at]
    for part in message.parts:
        size = stop - at - part.behind if part.open_ended else _held(part, row)
        if not part.open_ended and size < 0:
            return _too_many(part, row)
        if size < 0 or at + size > stop:
            return f"holds too few bytes for {part.name!r}"
        if part.kind == "items":
            problem = _take_items(part, frame[at : at + size], row)
            if problem:
                return problem
        elif part.kind == "rest":
            rest = frame[at : at + size]
        else:
            size = min(size, part.size) if part.kind == "cut" else size
            row[part.at : part.at + size] = frame[at : at + size]
        at += size
    return (bytes(row), rest) if at == stop else f"holds {stop - at} bytes behind its last field"


def wire_length(message: Message, head: bytes) -> int:
    """Return how long a frame is up to its last field, as what it begins with says; 0 if that makes no sense."""
    length = message.head
    for part in message.parts:
        size = _held(part, head)
        if size < 0:
            return 0
        length += size
    return length


def why_no_length(message: Message, head: bytes) -> str:
    """Return why what a frame begins with makes no sense; empty if it does."""
    return next((_too_many(part, head) for part in message.parts if _held(part, head) < 0), "")


def packed(message: Message, row: bytes, rest: bytes) -> bytes:
    """Return the frame of a row, up to its last field. Raises: InputError B-FRAME-021 for too many sets of a group."""
    wire = row[: message.head]
    for part in message.parts:
        if part.kind == "rest":
            wire += rest
        elif part.kind == "items":
            wire += b"".join(_written(part, item, row) for item in part.items if row[item.at])
        elif part.kind == "cut":
            wire += row[part.at : part.at + 1] + row[part.at + 1 : part.at + part.size].rstrip(b"\0")
        else:
            size = _held(part, row)
            if size < 0:
                text = f"{part.name!r} has more than {part.most} sets"
                raise InputError("B-FRAME-021", text, where="frame encoder", next_step="raise its 'max'")
            wire += row[part.at : part.at + size]
    return wire


def _stated(part: Part, row: bytes | bytearray) -> int:
    """Return what a frame says of a part; 1 where nothing has to be said."""
    if part.by is None:
        return 1
    return read_part(row, part.by, part.bits)


def _too_many(part: Part, row: bytes | bytearray) -> str:
    return f"states {_stated(part, row)} sets of {part.name!r}, 'max' is {part.most}"


def _held(part: Part, row: bytes | bytearray) -> int:
    """Return how many bytes of a part a frame holds, -1 if they are more than its row has."""
    value = _stated(part, row)
    if part.kind == "optional":
        return part.size if value else 0
    return part.size * value if value <= part.most else -1


def _take_items(part: Part, body: bytes, row: bytearray) -> str:
    """Put the items that are listed where their row has them; gives why they do not fit, "" if they do."""
    listed = {item.number: item for item in part.items}
    at, head = 0, part.id_size + part.length_size
    while at < len(body):
        if at + head > len(body):
            return f"ends within the head of an item of {part.name!r}"
        first = part.length_size if part.length_first else part.id_size
        pair = [int.from_bytes(body[low:high], part.order) for low, high in ((at, at + first), (at + first, at + head))]
        size, number = pair if part.length_first else reversed(pair)
        size += part.plus
        at += head
        if not 0 <= size <= len(body) - at:
            return f"ends within the item 0x{number:x} of {part.name!r}"
        item = listed.get(number)
        if item is not None and size != item.size:
            return f"states {size} bytes for the item {item.name!r}, which has {item.size}"
        if item is not None and row[item.at]:
            return f"holds the item {item.name!r} twice"
        if item is not None:
            row[item.at : item.at + 1 + size] = b"\1" + body[at : at + size]
        at += size
    missing = next((item.name for item in part.items if item.required and not row[item.at]), "")
    return f"lacks the item {missing!r}" if missing else ""


def _written(part: Part, item: Item, row: bytes) -> bytes:
    number = item.number.to_bytes(part.id_size, part.order)
    length = (item.size - part.plus).to_bytes(part.length_size, part.order)
    return (length + number if part.length_first else number + length) + row[item.at + 1 : item.at + 1 + item.size]


def blank_row(message: Message) -> bytes:
    """Return the row of a frame that holds nothing that it need not hold."""
    row = bytearray(message.body)
    for field in message.fields:
        if field.given and field.kind == "f":
            nan = struct.pack(field.float_code, np.nan)
            for element in range(field.count or 1):
                at, _ = field.place(element)
                row[at : at + field.size] = nan
    return bytes(row)


Cause = Literal["check", "length", "type", "trailer", "contents", "escape", "unknown"]


class Refusal(NamedTuple):
    """What is wrong, and the rest of a sentence whose subject is the frame: value and limit."""

    cause: Cause
    text: str


def why_refused(layout: Layout, candidate: bytes, due: Message | None = None, exact: bool = False) -> Refusal | None:
    """Return why bytes that begin like a frame are none; None if they are one.

    Args:   due: the message that a golden frame has to be.   exact: nothing may stand behind the frame.
    """
    read = measured(layout, candidate, due)
    if isinstance(read, Refusal):
        return read
    message, length = read
    if len(candidate) < length:
        return Refusal("length", f"is {length} bytes long, of which {len(candidate)} are there")
    if exact and length != len(candidate):
        return Refusal("length", f"states {length} bytes and has {len(candidate)}")
    return why_none(layout, message, candidate[:length])


def why_none(layout: Layout, message: Message, frame: bytes) -> Refusal | None:
    """Return what is wrong with check, trailer or contents of a frame; None if nothing is."""
    length = len(frame)
    right, computed, stored = checks_of(layout, message, frame)
    if not right:
        stop = length - layout.tail if message.cover_stop is None else message.cover_stop
        digits = 2 * layout.check.size
        return Refusal(
            "check",
            f"fails its check: {layout.check.name} over bytes {message.cover_start} to {stop - 1} is "
            f"0x{computed:0{digits}x}, the frame holds 0x{stored:0{digits}x}",
        )
    if not frame.endswith(layout.trailer):
        return Refusal("trailer", f"does not end with {layout.trailer.hex(' ')}")
    contents = unpacked(message, frame, length - layout.tail) if message.parts else ""
    return Refusal("contents", contents) if isinstance(contents, str) and contents else None


def measured(layout: Layout, candidate: bytes, due: Message | None = None) -> tuple[Message, int] | Refusal:
    """Return message and length of what begins like a frame, by its first ``header`` bytes."""
    message = _message_of(layout, candidate, due)
    if isinstance(message, Refusal):
        return message
    length = _length_of(layout, candidate, message)
    return length if isinstance(length, Refusal) else (message, length)


def _message_of(layout: Layout, candidate: bytes, due: Message | None) -> Message | Refusal:
    if layout.type_field is None:
        return layout.messages[0]
    value = read_part(candidate, layout.type_field, layout.type_bits)
    message = next((item for item in layout.messages if item.type_value == value), layout.unlisted)
    if message is not None and due in (None, message):
        return message
    listed = layout.messages if due is None else (due,)
    texts = [f"{item.type_value} (0x{item.type_value or 0:x}, {item.name!r})" for item in listed[:6]]
    more = " …" if len(listed) > len(texts) else ""
    return Refusal("type", f"states the type {value} (0x{value:x}), due is {' or '.join(texts)}{more}")


def _length_of(layout: Layout, candidate: bytes, message: Message) -> int | Refusal:
    length, least = message.length or len(candidate), message.least + layout.tail
    if layout.says_its_length:
        fields = wire_length(message, candidate[: layout.header])
        if not fields:
            return Refusal("contents", why_no_length(message, candidate[: layout.header]))
        length = fields + layout.tail
    elif layout.length_field is not None:
        stated = read_part(candidate, layout.length_field, layout.length_bits)
        length = stated * layout.length_times + layout.length_plus
        by = f"states {length} bytes ({layout.length_field.name} is {stated})"
        if length > layout.max_length:
            return Refusal("length", f"{by}, 'length: max' is {layout.max_length}")
        if length < least or message.length not in (0, length):
            return Refusal("length", f"{by}, {message.name!r} has {'' if message.length else 'at least '}{least}")
    elif length < least:
        return Refusal("length", f"is {length} bytes long, {message.name!r} has at least {least}")
    return length


def checks_of(layout: Layout, message: Message, frame: bytes) -> tuple[bool, int, int]:
    """Return whether the check of a frame is right, the one computed and the one that it holds."""
    size, end = layout.check.size, len(frame) - layout.tail
    at = end if layout.check_field is None else layout.check_field.offset
    stop = end if message.cover_stop is None else message.cover_stop
    blank = frame if layout.check_field is None else frame[:at] + bytes(size) + frame[at + size :]
    computed = layout.check.of(blank[message.cover_start : stop] + message.extra)
    stored = int.from_bytes(frame[at : at + size], "big" if layout.stored_big else "little")
    return computed == stored, computed, stored
