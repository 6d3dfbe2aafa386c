"""A frame definition compiled: where every field lies, and how a frame is checked.

One element of a field, by the standard library.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bench.frame.crc import Check
from bench.frame.spec import Endian, LinesSpec
from bench.model.arrays import Integers

_INTEGER_WIDTHS = (1, 2, 4, 8)

Span = tuple[int, int]
"""Lowest bit and number of bits."""
OFFSET = "offset"
"""Column of a table that says where a frame begins; no field has this name."""


@dataclass(frozen=True)
class Field:
    """One field: ``offset`` bytes from the first sync byte, ``count`` elements of ``size`` bytes.

    ``kind`` is "u", "i", "f" or "b" (bytes); ``count`` is None for a single value and 0 for "rest".
    ``bits`` maps a name to (lowest bit, number of bits). Physical value = raw * scale + shift in ``unit``.
    ``wrap``: how many values a counter has, None = as many as its type. ``form``: as in FieldSpec. ``packed``: first
    bit within the first byte, and bits of an element, of integers that are no whole bytes; "big" counts from the
    highest bit of a byte. ``step``: bytes from one element to the next, where they are of a group. ``given``: the
    field, or named bits of one as "field.bits", that says how many elements are there (of a group) or whether they are;
    "" if they always are.
    """

    name: str
    kind: str
    size: int
    count: int | None
    offset: int
    big: bool
    scale: float = 1.0
    shift: float = 0.0
    unit: str = ""
    counter: bool = False
    per: str = ""
    bits: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    constant: bytes | None = None
    default: bytes | None = None
    wrap: int | None = None
    form: str = ""
    packed: Span | None = None
    step: int = 0
    given: str = ""

    @cached_property
    def elements(self) -> int:
        """Elements, of a single value one; 0 for "rest"."""
        return 1 if self.count is None else self.count

    @cached_property
    def length(self) -> int:
        """Bytes on the wire, those that it shares with its neighbours included; 0 for "rest"."""
        first, width = self.packed or (0, self.width)
        if self.step:
            return (self.elements - 1) * self.step + -(-(first + width) // 8)
        return -(-(first + width * self.elements) // 8)

    @cached_property
    def end(self) -> int:
        """The byte behind it."""
        return self.offset + self.length

    @cached_property
    def span(self) -> slice:
        """Its bytes in a frame."""
        return slice(self.offset, self.end)

    @cached_property
    def order(self) -> Endian:
        """Order of the bytes of an element."""
        return "big" if self.big else "little"

    @cached_property
    def float_code(self) -> str:
        """How ``struct`` writes an element that is a float."""
        return (">" if self.big else "<") + ("f" if self.size == 4 else "d")

    @cached_property
    def bounds(self) -> tuple[int, int]:
        """Least and greatest raw value of an element that is no float."""
        most = (1 << self.width) - 1
        return (-(most >> 1) - 1, most >> 1) if self.kind == "i" else (0, most)

    @cached_property
    def width(self) -> int:
        """Bits of an element."""
        return 8 * self.size if self.packed is None else self.packed[1]

    def place(self, element: int) -> tuple[int, int]:
        """Return where an element begins: bytes from the beginning of the frame, bits from there."""
        first, width = self.packed or (0, self.width)
        if self.step:
            return self.offset + element * self.step, first
        at, odd = divmod(first + element * width, 8)
        return self.offset + at, odd

    @cached_property
    def begins(self) -> list[tuple[int, Integers, Integers]]:
        """Elements that begin at one bit of a byte: that bit, their numbers, their bytes from the frame's beginning."""
        at, odd = np.array([self.place(element) for element in range(self.elements)]).T
        return [(bit, alike := np.flatnonzero(odd == bit), at[alike]) for bit in np.unique(odd).tolist()]

    @cached_property
    def rest(self) -> bool:
        """Whether the field takes everything up to the check."""
        return self.count == 0

    @property
    def is_text(self) -> bool:
        """Whether its bytes are characters, filled up with zeros."""
        return self.form == "text"

    @cached_property
    def scaled(self) -> bool:
        """Whether physical and raw values differ."""
        return self.scale != 1.0 or self.shift != 0.0

    @cached_property
    def dtype(self) -> str:
        """numpy type of a raw element in memory, native byte order."""
        if self.kind == "b":
            return "u1"
        width = next(width for width in _INTEGER_WIDTHS if width >= self.size)
        return f"{self.kind}{width}"


@dataclass(frozen=True)
class Item:
    """An item: its id; ``at``: where the row of a frame has whether it is there (a byte), and behind that its bytes."""

    name: str
    number: int
    at: int
    size: int
    required: bool


@dataclass(frozen=True)
class Part:
    """What stands at no fixed place of a frame, and where its row has it: ``size`` bytes from ``at`` on.

    ``kind``: "plain", fields; "group", up to ``most`` times ``size`` bytes; "optional"; "items"; "cut", fields whose
    zeros at the end are not sent; "rest", bytes of variable length, which no row has. ``by``, ``bits``: what says how
    often or whether it is there. ``behind``: bytes of the parts behind one that is open-ended. ``length_first``,
    ``plus``: as in ItemsSpec.
    """

    kind: str
    name: str
    at: int
    size: int
    most: int = 1
    by: Field | None = None
    bits: Span | None = None
    behind: int = 0
    items: tuple[Item, ...] = ()
    id_size: int = 0
    length_size: int = 0
    order: Endian = "little"
    length_first: bool = False
    plus: int = 0

    @property
    def open_ended(self) -> bool:
        """Whether it takes all that the parts behind it leave."""
        return self.kind in ("items", "rest", "cut")


@dataclass(frozen=True)
class Message:
    """One message of a definition: all its fields from the beginning of the frame on, common ones first.

    ``body`` is the length without what stands behind the fields (check, trailer) and without the "rest" bytes;
    ``length`` the whole frame, 0 if it varies. The check covers [cover_start, cover_stop) of the frame; cover_stop
    None = up to the end of the fields. ``type_text``: the type of a line. With ``parts``, the first ``head`` bytes
    stand as in the row of a frame, which else is made of its parts; ``body`` is then the length of that row, and
    ``blank`` the row without any part. ``extra``: what the check covers behind that, and that is not sent.
    """

    name: str
    fields: tuple[Field, ...]
    body: int
    length: int
    cover_start: int
    cover_stop: int | None
    type_value: int | None = None
    type_text: str = ""
    parts: tuple[Part, ...] = ()
    head: int = 0
    blank: bytes = b""
    extra: bytes = b""

    @property
    def least(self) -> int:
        """The fewest bytes before the tail."""
        return self.head + sum(part.size for part in self.parts if part.kind == "plain") if self.parts else self.body

    @cached_property
    def by_name(self) -> dict[str, Field]:
        """Fields by name."""
        return {item.name: item for item in self.fields}

    @cached_property
    def counter(self) -> Field | None:
        """The counter field, if the message has one."""
        return next((item for item in self.fields if item.counter), None)

    @cached_property
    def constants(self) -> tuple[Field, ...]:
        """Fields whose value the definition fixes."""
        return tuple(item for item in self.fields if item.constant is not None)

    @cached_property
    def rest(self) -> Field | None:
        """The field of variable length, if the message has one."""
        return next((item for item in self.fields if item.rest), None)


@dataclass(frozen=True)
class Layout:
    """Everything the engines need; ``pattern`` = sync bytes and the constants right behind them.

    ``header``: bytes that must be there before length and message are known. ``shared_counter``: all messages count
    with the same counter; ``own_counters``: the common counter is of each message. ``length_bits``, ``type_bits``:
    lowest bit and number of bits, where these are no whole field. ``check_field`` holds the check where it does not
    stand behind the fields. ``unlisted``: the common fields as a message, where frames of other types are counted.
    ``sync_at``: where the pattern stands. ``escape``: a key of bench.frame.packets.ESCAPES, "" where bytes on the wire
    are those of the frame. ``lines``: how frames are written as text; fields and messages then say how their values are
    kept, and no length is fixed.
    """

    sync: bytes
    pattern: bytes
    header: int
    messages: tuple[Message, ...]
    check: Check
    stored_big: bool
    length_field: Field | None
    length_plus: int
    max_length: int
    type_field: Field | None
    shared_counter: bool
    rate_Hz: float | None
    silence_s: float | None = None
    own_counters: bool = False
    length_times: int = 1
    length_bits: Span | None = None
    type_bits: Span | None = None
    check_field: Field | None = None
    trailer: bytes = b""
    unlisted: Message | None = None
    escape: str = ""
    lines: LinesSpec | None = None
    sync_at: int = 0

    @cached_property
    def tail(self) -> int:
        """Bytes behind the fields: the check, if no field holds it, and the trailer."""
        return (self.check.size if self.check_field is None else 0) + len(self.trailer)

    @cached_property
    def kinds(self) -> tuple[Message, ...]:
        """All that a frame may be: the messages, and last what is not listed, if that is counted."""
        return self.messages if self.unlisted is None else (*self.messages, self.unlisted)

    @cached_property
    def told(self) -> tuple[Message, ...]:
        """All whose frames a decoder gives: the messages, and what is not listed where it counts with them."""
        return self.kinds if self.shared_counter else self.messages

    @property
    def fixed(self) -> bool:
        """One message of one length, without a type: the frames of an undamaged stream form a lattice."""
        single = len(self.messages) == 1 and not self.messages[0].parts
        return single and self.length_field is None and self.type_field is None

    @property
    def says_its_length(self) -> bool:
        """Whether the counts and flags in the head of a frame say how long it is."""
        return self.length_field is None and not self.escape and bool(self.messages[0].parts)

    def canonical(self) -> dict[str, Any]:
        """JSON-able content that decides how bytes become numbers; hashed into every session."""
        check = self.check
        model = getattr(check, "model", None)
        counting = any(message.counter for message in self.messages)
        later = {
            "silence_s": self.silence_s,
            "length_times": self.length_times if self.length_times > 1 else None,
            "length_bits": self.length_bits,
            "type_bits": self.type_bits,
            "check_field": self.check_field and self.check_field.name,
            "own_counters": self.own_counters and counting,
            "escape": self.escape,
            "lines": self.lines and self.lines.model_dump(),
            "sync_at": self.sync_at,
            "trailer": self.trailer.hex(),
            "other": self.unlisted is not None,
        }
        return {
            "sync": self.sync.hex(),
            "check": check.name if model is None else [model.width, *_numbers(model)],
            "stored_big": self.stored_big,
            "length": None if self.length_field is None else [self.length_field.name, self.length_plus],
            "max_length": self.max_length,
            "type": None if self.type_field is None else self.type_field.name,
            "rate_Hz": self.rate_Hz,
            "messages": [_message_content(message) for message in self.messages],
            **{name: value for name, value in later.items() if value},
        }


def _numbers(model: Any) -> list[Any]:
    return [model.poly, model.init, model.refin, model.refout, model.xorout]


def _message_content(message: Message) -> dict[str, Any]:
    return {
        "name": message.name,
        "type_value": message.type_text or message.type_value,
        "cover": [message.cover_start, message.cover_stop],
        "fields": [field_content(item) for item in message.fields],
        **({"parts": [_part_content(part) for part in message.parts]} if message.parts else {}),
        **({"extra": message.extra.hex()} if message.extra else {}),
    }


def _part_content(part: Part) -> list[Any]:
    items = [[item.name, item.number, item.at, item.size, item.required] for item in part.items]
    by = None if part.by is None else part.by.name
    later = [part.length_first, part.plus] if part.length_first or part.plus else []
    size = [part.id_size, part.length_size, part.order == "big", *later]
    return [part.kind, part.at, part.size, part.most, by, part.bits, items, *size]


def field_content(item: Field) -> list[Any]:
    """Return JSON-able content of a field; what was added to the language later stands there only where it is used."""
    bits = {name: list(span) for name, span in item.bits.items()}
    constant = None if item.constant is None else item.constant.hex()
    later = [*([] if item.default is None else [item.default.hex()]), *([] if item.wrap is None else [item.wrap])]
    later += [item.form] if item.form else []
    later += [list(item.packed)] if item.packed else []
    later += [item.step, item.given] if item.given else []
    return [
        item.name, item.kind, item.size, item.count, item.offset, item.big, item.scale, item.shift, item.unit,
        item.counter, item.per, bits, constant, *later,
    ]  # fmt: skip


def read_element(frame: bytes | bytearray, item: Field, element: int = 0) -> Any:
    """Return the raw value of one element of a field: a whole number or a float."""
    at, odd = item.place(element)
    size = -(-(odd + item.width) // 8)
    raw = frame[at : at + size]
    if item.kind == "f":
        return struct.unpack(item.float_code, raw)[0]
    if item.packed is None:
        return int.from_bytes(raw, item.order, signed=item.kind == "i")
    low = 8 * size - odd - item.width if item.big else odd
    value = int.from_bytes(raw, item.order) >> low & (1 << item.width) - 1
    return value - (1 << item.width) if item.kind == "i" and value >> item.width - 1 else value


def read_part(frame: bytes | bytearray, item: Field, bits: Span | None) -> int:
    """Return the whole number of a field, or of some bits of it."""
    return int(part_of(read_element(frame, item), bits))


def part_of(value: Any, bits: Span | None) -> Any:
    """Return some bits of whole numbers, or the numbers."""
    return value if bits is None else value >> bits[0] & (1 << bits[1]) - 1
