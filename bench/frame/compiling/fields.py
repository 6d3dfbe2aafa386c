"""From field specifications to fields with offsets; every mistake is collected with its position."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

from bench.frame.layout import Field
from bench.frame.spec import FieldSpec
from bench.model.yamlio import Path_

Fail = Callable[[str, Path_, str, str], None]
"""Collects one error: code, path in the file, message, next step."""

_HEX = re.compile(r"(?:[0-9a-fA-F]{2}\s*)*")
_WORD = 64
_COUNTER_BITS = 48
_BIT_RANGE = re.compile(r"(\d{1,2})(?:-(\d{1,2}))?")


def read_hex(text: str) -> bytes | None:
    """Bytes of hex text with optional white space, None if it is not hex."""
    return bytes.fromhex(text) if _HEX.fullmatch(text.strip()) else None


class Placer:
    """Lays fields one behind the other, from a byte on, behind those that are ``placed``; ``sync``: bytes to leave.

    Mistakes go to ``fail``; the field is then placed as well as possible.
    """

    def __init__(self, placed: Sequence[Field], start: int, endian: str, fail: Fail, sync: range = range(0)) -> None:
        self.placed = list(placed)
        self._names = {field.name for field in placed}
        self._bit = 8 * start
        self._endian = endian
        self._fail = fail
        self._sync = sync

    def add(self, spec: FieldSpec, where: Path_) -> Field:
        """Place one field."""
        if self._sync and self._bit == 8 * self._sync.start:
            self._bit += 8 * len(self._sync)
        field = _field(spec, where, self._bit, self._endian, self._fail)
        if field.counter and any(other.counter for other in self.placed):
            self._fail("B-FRAME-003", (*where, "role"), "a message can have one counter only", "")
        begin, self._bit = self._bit, self._bit + field.width * (1 if field.count is None else field.count)
        if self._sync and begin < 8 * self._sync.start < self._bit:
            self._fail("B-FRAME-006", where, f"{field.name!r} lies over the sync bytes", "end a field before them")
        self.put(field, (*where, "name"))
        return field

    def put(self, field: Field, where: Path_) -> None:
        """Take a field that has its place."""
        if field.name in self._names:
            self._fail("B-FRAME-001", where, f"the field {field.name!r} exists already", "choose another name")
        self.placed.append(field)
        self._names.add(field.name)

    def skip(self, size: int) -> None:
        """Leave bytes free."""
        self._bit += 8 * size

    def end(self, where: Path_) -> int:
        """Return the byte behind the fields, which must end with one."""
        odd = self._bit % 8
        if odd:
            text = f"the fields end {odd} bits behind the beginning of a byte"
            self._fail("B-FRAME-002", where, text, f"add one of {8 - odd} bits")
            self._bit += 8 - odd
        return self._bit // 8


def place_fields(specs: Sequence[FieldSpec], path: Path_, endian: str, fail: Fail) -> list[Field]:
    """Lay the fields of a payload one behind the other."""
    placer = Placer((), 0, endian, fail)
    for index, spec in enumerate(specs):
        if any(field.rest for field in placer.placed):
            text = f"{spec.name!r} follows a field of 'rest' length, which must be last"
            fail("B-FRAME-002", (*path, index), text, "")
        placer.add(spec, (*path, index))
    placer.end(path)
    return placer.placed


def _field(spec: FieldSpec, where: Path_, bit: int, endian: str, fail: Fail) -> Field:
    kind = "b" if spec.type == "bytes" else spec.type[0]
    count = 0 if spec.count == "rest" else spec.count
    _check_options(spec, kind, where, fail)
    width = 8 if kind == "b" else int(spec.type[1:])
    field = Field(
        name=spec.name,
        kind=kind,
        size=-(-width // 8),
        count=1 if kind == "b" and count is None else count,
        offset=bit // 8,
        big=(spec.endian or endian) == "big",
        scale=1.0 if spec.scale is None else spec.scale,
        shift=0.0 if spec.offset is None else spec.offset,
        unit=spec.unit or "",
        counter=spec.role is not None,
        per=spec.per or "",
        wrap=spec.wrap,
        form=spec.form or "",
        packed=(bit % 8, width) if bit % 8 or width % 8 else None,
    )
    _check_packed(spec, field, where, fail)
    bits = _bits(spec, field, where, fail)
    constant = _written("constant", spec.constant, field, where, fail)
    default = _written("default", spec.default, field, where, fail)
    if constant is not None and default is not None:
        fail("B-FRAME-005", (*where, "default"), f"{spec.name}: a constant needs no default", "remove one of them")
    return replace(field, bits=bits, constant=constant, default=default)


def _check_packed(spec: FieldSpec, field: Field, where: Path_, fail: Fail) -> None:
    """Check what an integer that is no whole bytes cannot have."""
    if field.packed is None:
        return
    if field.kind in "fb":
        text = f"{spec.name}: {spec.type} begins {field.packed[0]} bits behind the beginning of a byte"
        fail("B-FRAME-002", where, text, f"put an integer of {8 - field.packed[0]} bits before it")
    elif any(field.place(element)[1] + field.width > _WORD for element in range(min(field.count or 1, 8))):
        text = f"{spec.name}: {spec.type} lies in nine bytes, because it begins in the middle of one"
        fail("B-FRAME-002", (*where, "type"), text, "cut it in two")
    for key in ("constant", "default"):
        if getattr(spec, key) is not None:
            text = f"{spec.name}: {key!r} needs whole bytes"
            fail("B-FRAME-005", (*where, key), text, "join the fields to one of whole bytes, and name its 'bits'")


def _check_options(spec: FieldSpec, kind: str, where: Path_, fail: Fail) -> None:
    def refuse(key: str, reason: str) -> None:
        fail("B-FRAME-002", (*where, key), f"{spec.name}: {reason}", "")

    if kind == "b":
        if spec.count is None:
            refuse("type", "bytes need a 'count' (a number of bytes or 'rest')")
        for key in ("scale", "offset", "unit", "per", "endian"):
            if getattr(spec, key) not in (None, "sample"):
                refuse(key, f"{key!r} makes no sense for bytes")
    elif spec.count == "rest":
        refuse("count", "only bytes can have the count 'rest'")
    if kind != "u":
        for key in ("bits", "per"):
            if getattr(spec, key) not in (None, "sample"):
                refuse(key, f"{key!r} needs an unsigned integer, not {spec.type}")
    if spec.scale == 0:
        refuse("scale", "the scale must not be 0")
    odd = kind != "u" or int(spec.type[1:]) > _COUNTER_BITS or spec.count is not None or spec.constant is not None
    if spec.role is not None and odd:
        text = f"{spec.name}: a counter is one unsigned integer of up to 48 bits that varies"
        fail("B-FRAME-003", (*where, "role"), text, "")
    if spec.wrap is not None:
        values = 1 << int(spec.type[1:]) if kind == "u" else 0
        if spec.role is None or odd or spec.wrap & (spec.wrap - 1) or spec.wrap >= values:
            text = f"{spec.name}: 'wrap: {spec.wrap}' is no power of two below the values of a counter of its type"
            fail("B-FRAME-003", (*where, "wrap"), text, "leave it out where the counter uses all values of its type")


def _bits(spec: FieldSpec, field: Field, where: Path_, fail: Fail) -> dict[str, tuple[int, int]]:
    spans: dict[str, tuple[int, int]] = {}
    taken = 0
    for name, text in (spec.bits or {}).items():
        match = _BIT_RANGE.fullmatch(str(text))
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (0, -1)
        if not low <= high < field.width:
            advice = f"write a bit 0 to {field.width - 1} or a range such as '1-3'" if field.width > 1 else "write 0"
            fail("B-FRAME-004", (*where, "bits", name), f"{spec.name}.{name}: {text!r} is no bit of it", advice)
            continue
        mask = (1 << (high + 1)) - (1 << low)
        if taken & mask:
            fail("B-FRAME-004", (*where, "bits", name), f"{spec.name}.{name}: bits {text} are taken already", "")
        taken |= mask
        spans[name] = (low, high - low + 1)
    return spans


def _written(key: str, value: int | str | None, field: Field, where: Path_, fail: Fail) -> bytes | None:
    """Bytes of a constant or a default as they stand on the wire."""
    if value is None or field.packed is not None:
        return None
    found: bytes | None = None
    if isinstance(value, str):
        found = read_hex(value) if field.kind == "b" else None
    elif field.kind in "ui" and field.count is None:
        try:
            found = value.to_bytes(field.size, "big" if field.big else "little", signed=field.kind == "i")
        except OverflowError:
            found = None
    if found is None or len(found) != field.length or not found:
        kind = "bytes" if field.kind == "b" else f"{field.kind}{8 * field.size}"
        advice = "a whole number for a single integer, hex text of the full length for bytes"
        fail("B-FRAME-005", (*where, key), f"{field.name}: the {key} {value!r} does not fit {kind}", advice)
        return None
    return found
