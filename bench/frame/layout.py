"""A frame definition in its two forms: as the YAML says it, and compiled, where every field lies and how it is checked.

docs/adding-a-frame.md describes the YAML with examples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import Field as Limits
from pydantic import StrictBool, StringConstraints

from bench.frame.crc import Check
from bench.model.units import quantity
from bench.model.yamlio import StrictModel

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60)]
Part = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z][A-Za-z0-9_]*)?$", max_length=121)]
Whole = Annotated[int, Limits(strict=True, ge=0)]
Byte = Annotated[int, Limits(strict=True, ge=0, le=255)]
Number = Annotated[float, Limits(strict=True, allow_inf_nan=False)]
Endian = Literal["big", "little"]
Kind = Literal[
    "u8", "u16", "u24", "u32", "u40", "u48", "u56", "u64",
    "i8", "i16", "i24", "i32", "i40", "i48", "i56", "i64", "f32", "f64", "bytes",
]  # fmt: skip
MAX_FRAME_BYTES = 65_535
_INTEGER_WIDTHS = (1, 2, 4, 8)


class FieldSpec(StrictModel):
    """One field; fields follow each other on the wire without gaps.

    ``count`` makes an array; for ``bytes`` it is the length, or "rest" for everything up to the check.
    Physical value = raw * scale + offset, in ``unit``. ``constant`` fixes the value: right behind the sync bytes it
    extends the sync pattern, elsewhere a frame that differs is marked suspect. ``default`` is the raw value that the
    encoder writes where the caller gives none; the decoder ignores it. ``wrap``: how many values a counter has, a power
    of two, if its type has more; of a field with named bits, the lowest bits count. ``role``: a common counter counts
    the frames of all messages, an ``own_counter`` those of each message. ``form``: how a value of a line is written,
    if not in decimal digits: "hex"; "time", hhmmss.ss, which becomes seconds of the day; "latitude" and "longitude",
    two values, ddmm.mmmm and a letter, which become degrees, positive to north and east.
    """

    name: Name
    type: Kind
    count: Annotated[int, Limits(strict=True, ge=1, le=65_535)] | Literal["rest"] | None = None
    endian: Endian | None = None
    scale: Number | None = None
    offset: Number | None = None
    unit: Annotated[str, StringConstraints(min_length=1, max_length=20)] | None = None
    role: Literal["counter", "own_counter"] | None = None
    wrap: Annotated[int, Limits(strict=True, ge=4)] | None = None
    per: Literal["frame", "cumulative", "sample"] | None = None
    bits: dict[str, Annotated[int, Limits(strict=True)] | str] | None = None
    constant: Annotated[int, Limits(strict=True)] | str | None = None
    default: Annotated[int, Limits(strict=True)] | str | None = None
    form: Literal["hex", "time", "latitude", "longitude"] | None = None


class CheckSpec(StrictModel):
    """The check of a frame: a published CRC or checksum by name, "none", or a CRC by its parameters.

    ``over``: first and last field covered; "sync" and "end" stand for the first and the last byte before the check.
    ``field``: the common field that holds the check, which else stands behind all fields; its own bytes count as zero
    where they are covered. ``stored``: byte order of the stored value (default: the definition's).
    """

    over: Annotated[list[str], Limits(min_length=2, max_length=2)] | None = None
    field: Name | None = None
    stored: Endian | None = None
    name: str | None = None
    width: Annotated[int, Limits(strict=True, ge=1, le=64)] | None = None
    poly: Whole | None = None
    init: Whole | None = None
    refin: StrictBool | None = None
    refout: StrictBool | None = None
    xorout: Whole | None = None


class LengthSpec(StrictModel):
    """In-frame length: whole frame in bytes, first to last = value of ``field`` * ``times`` + ``plus``.

    ``field`` is a common field, or named bits of one as "field.bits".
    """

    field: Part
    times: Annotated[int, Limits(strict=True, ge=1, le=256)] = 1
    plus: Annotated[int, Limits(strict=True, ge=-65_535, le=65_535)]
    max: Annotated[int, Limits(strict=True, ge=1, le=MAX_FRAME_BYTES)]


class LinesSpec(StrictModel):
    """Lines of text, of at most ``max`` bytes with sync bytes, check and line end (LF or CR LF).

    ``separator``: each of its characters stands between two values; between values one space counts like several.
    ``check``: the character before the check, which is written in hex digits. ``more``: values may follow those listed.
    """

    separator: Annotated[str, StringConstraints(pattern=r"^( |[\t!-/:-@\[-`{-~]{1,8})$")] = ","
    check: Annotated[str, StringConstraints(pattern=r"^[!-/:-@\[-`{-~]$")] | None = None
    max: Annotated[int, Limits(strict=True, ge=1, le=4096)]
    more: StrictBool = False


class TypeSpec(StrictModel):
    """Which common field, or named bits of one as "field.bits", tells the messages of a definition apart."""

    field: Part


class MessageSpec(StrictModel):
    """One message: its value of the type field, the fields behind the common ones, a golden frame.

    In lines the value is text, in which a "?" stands for any character.
    """

    value: Whole | Annotated[str, StringConstraints(pattern=r"^[!-~]{1,60}$")]
    fields: tuple[FieldSpec, ...] = ()
    golden: str
    expect: Annotated[dict[str, Any], Limits(min_length=1)]


class CommandSpec(StrictModel):
    """A command: what it carries, and its answer behind the status byte; ``timeout``: how long the unit may take."""

    code: Byte
    timeout: Annotated[float, *quantity("s", low=1e-3, high=3600.0)] = 0.2
    request: tuple[FieldSpec, ...] = ()
    answer: tuple[FieldSpec, ...] = ()


class FrameSpec(StrictModel):
    """A frame file: either ``fields`` with one ``golden``, or common ``fields``, ``type`` and ``messages``.

    ``silence``: a frame that was begun before a longer pause of the line, and that is not whole when the line speaks
    again, is given up. ``commands``: what the payloads of the messages ``command`` and ``answer`` mean. ``trailer``:
    bytes that stand behind the check of every frame. ``other``: a frame of a type that is not listed, but whose check
    is right, is counted as such and passed over, not rejected. ``escape``: frames stand between delimiters, and bytes
    that look like one are escaped. ``lines``: frames are lines of text, and fields are their values.
    """

    frame: Annotated[str, StringConstraints(pattern=r"^[a-z0-9_]+$", max_length=60)]
    title: str | None = None
    endian: Endian | None = None
    sync: Annotated[list[Byte], Limits(max_length=255)]
    trailer: Annotated[list[Byte], Limits(min_length=1, max_length=255)] | None = None
    other: StrictBool = False
    escape: Literal["slip", "hdlc", "cobs", "dle"] | None = None
    lines: LinesSpec | None = None
    rate: Annotated[float, *quantity("Hz", low=1e-6, high=1e6)] | None = None
    silence: Annotated[float, *quantity("s", low=1e-3, high=60.0)] | None = None
    fields: Annotated[list[FieldSpec], Limits(min_length=1, max_length=1000)]
    length: LengthSpec | None = None
    type: TypeSpec | None = None
    messages: dict[Name, MessageSpec] | None = None
    commands: dict[Name, CommandSpec] | None = None
    crc: CheckSpec
    golden: str | None = None
    expect: Annotated[dict[str, Any], Limits(min_length=1)] | None = None


Span = tuple[int, int]
"""Lowest bit and number of bits."""


@dataclass(frozen=True)
class Field:
    """One field: ``offset`` bytes from the first sync byte, ``count`` elements of ``size`` bytes.

    ``kind`` is "u", "i", "f" or "b" (bytes); ``count`` is None for a single value and 0 for "rest".
    ``bits`` maps a name to (lowest bit, number of bits). Physical value = raw * scale + shift in ``unit``.
    ``wrap``: how many values a counter has, None = as many as its type. ``form``: as in FieldSpec.
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

    @property
    def length(self) -> int:
        """Bytes on the wire; 0 for "rest"."""
        return self.size * (1 if self.count is None else self.count)

    @property
    def rest(self) -> bool:
        """Whether the field takes everything up to the check."""
        return self.count == 0

    @property
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
class Message:
    """One message of a definition: all its fields from the sync bytes on, common ones first.

    ``body`` is the length without what stands behind the fields (check, trailer) and without the "rest" bytes;
    ``length`` the whole frame, 0 if it varies. The check covers [cover_start, cover_stop) of the frame; cover_stop
    None = up to the end of the fields. ``type_text``: the type of a line.
    """

    name: str
    fields: tuple[Field, ...]
    body: int
    length: int
    cover_start: int
    cover_stop: int | None
    type_value: int | None = None
    type_text: str = ""

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
    ``escape``: a key of bench.frame.escape.ESCAPES, "" where bytes on the wire are those of the frame. ``lines``: how
    frames are written as text; fields and messages then say how their values are kept, and no length is fixed.
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

    @property
    def tail(self) -> int:
        """Bytes behind the fields: the check, if no field holds it, and the trailer."""
        return (self.check.size if self.check_field is None else 0) + len(self.trailer)

    @property
    def kinds(self) -> tuple[Message, ...]:
        """All that a frame may be: the messages, and last what is not listed, if that is counted."""
        return self.messages if self.unlisted is None else (*self.messages, self.unlisted)

    @property
    def fixed(self) -> bool:
        """One message of one length, without a type: the frames of an undamaged stream form a lattice."""
        return len(self.messages) == 1 and self.length_field is None and self.type_field is None

    def canonical(self) -> dict[str, Any]:
        """JSON-able content that decides how bytes become numbers; hashed into every session."""
        check = self.check
        model = getattr(check, "model", None)
        later: dict[str, Any] = {} if self.silence_s is None else {"silence_s": self.silence_s}
        later |= {} if self.length_times == 1 else {"length_times": self.length_times}
        for name in ("length_bits", "type_bits"):
            later |= {} if getattr(self, name) is None else {name: list(getattr(self, name))}
        later |= {} if self.check_field is None else {"check_field": self.check_field.name}
        counting = any(message.counter for message in self.messages)
        later |= {"own_counters": True} if self.own_counters and counting else {}
        later |= {"escape": self.escape} if self.escape else {}
        later |= {"lines": self.lines.model_dump()} if self.lines else {}
        later |= {"trailer": self.trailer.hex()} if self.trailer else {}
        later |= {} if self.unlisted is None else {"other": True}
        return {
            "sync": self.sync.hex(),
            "check": check.name if model is None else [model.width, *_numbers(model)],
            "stored_big": self.stored_big,
            "length": None if self.length_field is None else [self.length_field.name, self.length_plus],
            "max_length": self.max_length,
            "type": None if self.type_field is None else self.type_field.name,
            "rate_Hz": self.rate_Hz,
            "messages": [_message_content(message) for message in self.messages],
            **later,
        }


def _numbers(model: Any) -> list[Any]:
    return [model.poly, model.init, model.refin, model.refout, model.xorout]


def _message_content(message: Message) -> dict[str, Any]:
    return {
        "name": message.name,
        "type_value": message.type_text or message.type_value,
        "cover": [message.cover_start, message.cover_stop],
        "fields": [field_content(item) for item in message.fields],
    }


def field_content(item: Field) -> list[Any]:
    """Return JSON-able content of a field; what was added to the language later stands there only where it is used."""
    bits = {name: list(span) for name, span in item.bits.items()}
    constant = None if item.constant is None else item.constant.hex()
    later = [*([] if item.default is None else [item.default.hex()]), *([] if item.wrap is None else [item.wrap])]
    later += [item.form] if item.form else []
    return [
        item.name, item.kind, item.size, item.count, item.offset, item.big, item.scale, item.shift, item.unit,
        item.counter, item.per, bits, constant, *later,
    ]  # fmt: skip
