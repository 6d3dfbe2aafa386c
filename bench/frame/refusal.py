"""Why the bytes behind sync bytes are no frame: for golden frames, and for what a capture holds that is bad."""

from __future__ import annotations

from typing import Literal, NamedTuple

from bench.frame.layout import Layout, Message, read_part
from bench.frame.parts import unpacked, why_no_length, wire_length

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
