"""A frame definition as the YAML says it.

docs/adding-a-frame.md describes the YAML with examples.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, StrictBool, StringConstraints, Tag, model_validator
from pydantic import Field as Limits

from bench.model.units import quantity
from bench.model.yamlio import StrictModel, characters

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60)]
Part = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*(\.[A-Za-z][A-Za-z0-9_]*)?$", max_length=121)]
Integer = Annotated[int, Limits(strict=True)]
Whole = Annotated[Integer, Limits(ge=0)]
Count = Annotated[Integer, Limits(ge=1)]
Byte = Annotated[Whole, Limits(le=255)]
Number = Annotated[float, Limits(strict=True, allow_inf_nan=False)]
Endian = Literal["big", "little"]
Expected = Annotated[dict[str, Any], Limits(min_length=1)]
Kind = Annotated[str, StringConstraints(pattern=r"^([ui]([1-9]|[1-5][0-9]|6[0-4])|f32|f64|bytes)$")]
MAX_FRAME_BYTES = 65_535
_CONTENTS = ("group", "optional", "items")


class FieldSpec(StrictModel):
    """One field; fields follow each other on the wire without gaps.

    ``type``: an integer may have 1 to 64 bits and begin at any bit; "big" begins with the highest bit of a byte.
    ``count`` makes an array; for ``bytes`` it is the length, or "rest" for everything up to the check.
    Physical value = raw * scale + offset, in ``unit``. ``constant`` fixes the value: right behind the sync bytes it
    extends the sync pattern, elsewhere a frame that differs is marked suspect. ``default`` is the raw value that the
    encoder writes where the caller gives none; the decoder ignores it. ``wrap``: how many values a counter has, a power
    of two, if its type has more; of a field with named bits, the lowest bits count. ``role``: a common counter counts
    the frames of all messages, an ``own_counter`` those of each message. ``form``: how a value of a line is written,
    if not in decimal digits: "hex"; "time", hhmmss.ss, which becomes seconds of the day; "latitude" and "longitude",
    two values, ddmm.mmmm and a letter, which become degrees, positive to north and east. "text" says of bytes in any
    frame that they are characters, filled up with zeros; those of a line always are.
    """

    name: Name
    type: Kind
    count: Annotated[Count, Limits(le=65_535)] | Literal["rest"] | None = None
    endian: Endian | None = None
    scale: Number | None = None
    offset: Number | None = None
    unit: Annotated[str, characters(20)] | None = None
    role: Literal["counter", "own_counter"] | None = None
    wrap: Annotated[Integer, Limits(ge=4)] | None = None
    per: Literal["frame", "cumulative", "sample"] | None = None
    bits: dict[Name, Integer | str] | None = None
    constant: Integer | str | None = None
    default: Integer | str | None = None
    form: Literal["hex", "time", "latitude", "longitude", "text"] | None = None

    @model_validator(mode="before")
    @classmethod
    def _stands_alone(cls, value: Any) -> Any:
        nested = isinstance(value, dict) and next((key for key in _CONTENTS if key in value), "")
        if nested:
            raise ValueError(f"{nested!r} cannot stand inside a group, an optional part or an item: only fields can")
        return value


Fields = Annotated[tuple[FieldSpec, ...], Limits(max_length=100)]
SomeFields = Annotated[Fields, Limits(min_length=1)]


class GroupSpec(StrictModel):
    """Fields that stand several times, one set behind the other: as often as the field ``count`` says, ``max`` at most.

    ``count``, a field in front of them or named bits of one as "field.bits".
    """

    group: Name
    count: Part
    max: Annotated[Count, Limits(le=4096)]
    fields: SomeFields


class OptionalSpec(StrictModel):
    """Fields that stand there if the field ``when`` in front of them, or named bits of one, are not zero."""

    optional: Name
    when: Part
    fields: SomeFields


class ItemSpec(StrictModel):
    """An item by its id; a frame without one that is ``required`` is bad."""

    id: Whole
    required: StrictBool = False
    fields: Fields = ()


class ItemsSpec(StrictModel):
    """Items in any order, each with its id, the bytes of its body, and its body, up to the end or the fields behind.

    Those that are not listed are passed over. The name of an item is a column: 1 where the frame holds it.
    ``length_first``: the length stands in front of the id. ``plus``: the body has as many bytes more than it says.
    """

    items: Name
    id: Literal["u8", "u16", "u24", "u32"]
    length: Literal["u8", "u16", "u24", "u32"]
    length_first: StrictBool = False
    plus: Annotated[Integer, Limits(ge=-8, le=0)] = 0
    endian: Endian | None = None
    of: Annotated[dict[Name, ItemSpec], Limits(min_length=1, max_length=200)]


def _kind_of(value: object) -> str:
    keys = value if isinstance(value, dict) else ()
    return next((f"<{key}>" for key in _CONTENTS if key in keys), "<field>")


AnyField = Annotated[
    Annotated[FieldSpec, Tag("<field>")]
    | Annotated[GroupSpec, Tag("<group>")]
    | Annotated[OptionalSpec, Tag("<optional>")]
    | Annotated[ItemsSpec, Tag("<items>")],
    Discriminator(_kind_of),
]


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
    width: Annotated[Count, Limits(le=64)] | None = None
    poly: Whole | None = None
    init: Whole | None = None
    refin: StrictBool | None = None
    refout: StrictBool | None = None
    xorout: Whole | None = None


class LengthSpec(StrictModel):
    """In-frame length: whole frame in bytes, first to last = value of ``field`` * ``times`` + ``plus``.

    ``field`` is a common field, or named bits of one as "field.bits". ``cut``: zeros at the end of the fields of a
    message are not sent, but for the first byte behind the common ones.
    """

    field: Part
    cut: StrictBool = False
    times: Annotated[Count, Limits(le=256)] = 1
    plus: Annotated[Integer, Limits(ge=-65_535, le=65_535)]
    max: Annotated[Count, Limits(le=MAX_FRAME_BYTES)]


class LinesSpec(StrictModel):
    """Lines of text, of at most ``max`` bytes with sync bytes, check and line end (LF or CR LF).

    ``separator``: each of its characters stands between two values; between values one space counts like several.
    ``check``: the character before the check, which is written in hex digits. ``more``: values may follow those listed.
    """

    separator: Annotated[str, StringConstraints(pattern=r"^( |[\t!-/:-@\[-`{-~]{1,8})$")] = ","
    check: Annotated[str, StringConstraints(pattern=r"^[!-/:-@\[-`{-~]$")] | None = None
    max: Annotated[Count, Limits(le=4096)]
    more: StrictBool = False


class TypeSpec(StrictModel):
    """Which common field, or named bits of one as "field.bits", tells the messages of a definition apart."""

    field: Part


class MessageSpec(StrictModel):
    """One message: its value of the type field, the fields behind the common ones, a golden frame.

    In lines the value is text, in which a "?" stands for any character. ``extra``: bytes that the check covers behind
    all others, and that are not sent.
    """

    value: Whole | Annotated[str, StringConstraints(pattern=r"^[!-~]{1,60}$")]
    fields: tuple[AnyField, ...] = ()
    extra: Annotated[list[Byte], Limits(min_length=1, max_length=8)] | None = None
    golden: str
    expect: Expected


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
    bytes that stand behind the check of every frame. ``sync_at``: bytes in front of the sync bytes; the first fields
    are there. ``other``: a frame of a type that is not listed, but whose check
    is right, is counted as such and passed over, not rejected. ``escape``: frames stand between delimiters, and bytes
    that look like one are escaped. ``lines``: frames are lines of text, and fields are their values.
    """

    frame: Annotated[str, StringConstraints(pattern=r"^[a-z0-9_]+$", max_length=60)]
    title: str | None = None
    endian: Endian | None = None
    sync: Annotated[list[Byte], Limits(max_length=255)]
    sync_at: Annotated[Count, Limits(le=255)] | None = None
    trailer: Annotated[list[Byte], Limits(min_length=1, max_length=255)] | None = None
    other: StrictBool = False
    escape: Literal["slip", "hdlc", "cobs", "dle", "dle_etx"] | None = None
    lines: LinesSpec | None = None
    rate: Annotated[float, *quantity("Hz", low=1e-6, high=1e6)] | None = None
    silence: Annotated[float, *quantity("s", low=1e-3, high=60.0)] | None = None
    fields: Annotated[list[AnyField], Limits(min_length=1, max_length=1000)]
    length: LengthSpec | None = None
    type: TypeSpec | None = None
    messages: dict[Name, MessageSpec] | None = None
    commands: dict[Name, CommandSpec] | None = None
    crc: CheckSpec
    golden: str | None = None
    expect: Expected | None = None
