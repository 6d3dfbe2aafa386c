"""The YAML form of a frame definition (docs/adding-a-frame.md describes it with examples)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field as Limits
from pydantic import StrictBool, StringConstraints

from bench.model.units import quantity
from bench.model.yamlio import StrictModel

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60)]
Whole = Annotated[int, Limits(strict=True, ge=0)]
Byte = Annotated[int, Limits(strict=True, ge=0, le=255)]
Number = Annotated[float, Limits(strict=True, allow_inf_nan=False)]
Endian = Literal["big", "little"]
Kind = Literal[
    "u8", "u16", "u24", "u32", "u40", "u48", "u56", "u64",
    "i8", "i16", "i24", "i32", "i40", "i48", "i56", "i64", "f32", "f64", "bytes",
]  # fmt: skip
MAX_FRAME_BYTES = 65_535


class FieldSpec(StrictModel):
    """One field; fields follow each other on the wire without gaps.

    ``count`` makes an array; for ``bytes`` it is the length, or "rest" for everything up to the check.
    Physical value = raw * scale + offset, in ``unit``. ``constant`` fixes the value: right behind the sync bytes it
    extends the sync pattern, elsewhere a frame that differs is marked suspect. ``default`` is the raw value that the
    encoder writes where the caller gives none; the decoder ignores it. ``wrap``: how many values a counter has, a power
    of two, if its type has more.
    """

    name: Name
    type: Kind
    count: Annotated[int, Limits(strict=True, ge=1, le=65_535)] | Literal["rest"] | None = None
    endian: Endian | None = None
    scale: Number | None = None
    offset: Number | None = None
    unit: Annotated[str, StringConstraints(min_length=1, max_length=20)] | None = None
    role: Literal["counter"] | None = None
    wrap: Annotated[int, Limits(strict=True, ge=4)] | None = None
    per: Literal["frame", "cumulative", "sample"] | None = None
    bits: dict[str, Annotated[int, Limits(strict=True)] | str] | None = None
    constant: Annotated[int, Limits(strict=True)] | str | None = None
    default: Annotated[int, Limits(strict=True)] | str | None = None


class CheckSpec(StrictModel):
    """The check at the end of a frame: a published CRC or checksum by name, or a CRC by its parameters.

    ``over``: first and last field covered; "sync" and "end" stand for the first and the last byte before the check.
    ``stored``: byte order of the stored value (default: the definition's).
    """

    over: Annotated[list[str], Limits(min_length=2, max_length=2)]
    stored: Endian | None = None
    name: str | None = None
    width: Annotated[int, Limits(strict=True, ge=1, le=64)] | None = None
    poly: Whole | None = None
    init: Whole | None = None
    refin: StrictBool | None = None
    refout: StrictBool | None = None
    xorout: Whole | None = None


class LengthSpec(StrictModel):
    """In-frame length: whole frame length in bytes, sync to check = value of ``field`` + ``plus``."""

    field: Name
    plus: Annotated[int, Limits(strict=True, ge=-65_535, le=65_535)]
    max: Annotated[int, Limits(strict=True, ge=1, le=MAX_FRAME_BYTES)]


class TypeSpec(StrictModel):
    """Which field tells the messages of a definition apart."""

    field: Name


class MessageSpec(StrictModel):
    """One message: its value of the type field, the fields behind the common ones, a golden frame."""

    value: Whole
    fields: tuple[FieldSpec, ...] = ()
    golden: str
    expect: Annotated[dict[str, Any], Limits(min_length=1)]


class CommandSpec(StrictModel):
    """What a command carries, and its answer behind the status byte; ``timeout``: how long the unit may take."""

    code: Byte
    timeout: Annotated[float, *quantity("s", low=1e-3, high=3600.0)] = 0.2
    request: tuple[FieldSpec, ...] = ()
    answer: tuple[FieldSpec, ...] = ()


class FrameSpec(StrictModel):
    """A frame file: either ``fields`` with one ``golden``, or common ``fields``, ``type`` and ``messages``.

    ``silence``: a frame that was begun before a longer pause of the line, and that is not whole when the line speaks
    again, is given up. ``commands``: what the payloads of the messages ``command`` and ``answer`` mean.
    """

    frame: Annotated[str, StringConstraints(pattern=r"^[a-z0-9_]+$", max_length=60)]
    title: str | None = None
    endian: Endian
    sync: Annotated[list[Byte], Limits(min_length=1, max_length=16)]
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
