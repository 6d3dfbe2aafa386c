"""From field specifications to fields with offsets; every mistake is collected with its position.

From what a message lists to fields with places, and the parts of it that stand at no fixed place.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bench.frame.layout import Field, Item, Part, Span
from bench.frame.spec import AnyField, Endian, FieldSpec, GroupSpec, ItemsSpec, OptionalSpec
from bench.model.yamlio import Path_

Fail = Callable[..., None]
"""Collects one error: code, path in the file, message, next step."""

_HEX = re.compile(r"(?:[0-9a-fA-F]{2}\s*)*")
_WORD = 64
_COUNTER_BITS = 48
_BIT_RANGE = re.compile(r"([0-9]{1,2})(?:-([0-9]{1,2}))?")
_ALWAYS_THERE = ("role", "per", "constant", "default")
_BYTES = 4
_SAYS = "name an unsigned integer that stands in front of it in every frame, or bits of one"


def read_hex(text: str) -> bytes | None:
    """Bytes of hex text with optional white space, None if it is not hex."""
    return bytes.fromhex(text) if _HEX.fullmatch(text.strip()) else None


class Placer:
    """Lays fields one behind the other, from a byte on, behind those that are ``placed``; ``sync``: bytes to leave.

    Mistakes go to ``fail``; the field is then placed as well as possible.
    """

    def __init__(self, placed: Sequence[Field], start: int, endian: Endian, fail: Fail, sync: range = range(0)) -> None:
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
            self._fail("B-FRAME-003", (*where, "role"), "a message can have one counter only")
        begin, self._bit = self._bit, self._bit + field.width * field.elements
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


def place_fields(specs: Sequence[FieldSpec], path: Path_, endian: Endian, fail: Fail) -> list[Field]:
    """Lay the fields of a payload one behind the other."""
    placer = Placer((), 0, endian, fail)
    for index, spec in enumerate(specs):
        if any(field.rest for field in placer.placed):
            text = f"{spec.name!r} follows a field of 'rest' length, which must be last"
            fail("B-FRAME-002", (*path, index), text)
        placer.add(spec, (*path, index))
    placer.end(path)
    return placer.placed


def _field(spec: FieldSpec, where: Path_, bit: int, endian: Endian, fail: Fail) -> Field:
    kind = "b" if spec.type == "bytes" else spec.type[0]
    count = {"b": 0}.get(kind) if spec.count == "rest" else spec.count
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
        fail("B-FRAME-002", (*where, key), f"{spec.name}: {reason}")

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
        fail("B-FRAME-003", (*where, "role"), text)
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
            fail("B-FRAME-004", (*where, "bits", name), f"{spec.name}.{name}: bits {text} are taken already")
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
            found = value.to_bytes(field.size, field.order, signed=field.kind == "i")
        except OverflowError:
            found = None
    if found is None or len(found) != field.length or not found:
        kind = "bytes" if field.kind == "b" else f"{field.kind}{8 * field.size}"
        advice = "a whole number for a single integer, hex text of the full length for bytes"
        fail("B-FRAME-005", (*where, key), f"{field.name}: the {key} {value!r} does not fit {kind}", advice)
        return None
    return found


@dataclass(frozen=True)
class Placed:
    """The fields of a message; ``head``: bytes in front of all parts; ``end``: the byte behind all fields in a row."""

    fields: tuple[Field, ...]
    parts: tuple[Part, ...]
    head: int
    end: int

    @property
    def fixed(self) -> list[Field]:
        """Fields that begin at a fixed place of the frame."""
        return [item for item in self.fields if item.end <= self.head]


def place(specs: Sequence[AnyField], path: Path_, first: Placed | int, endian: Endian, fail: Fail,
          sync: range = range(0)) -> Placed:  # fmt: skip
    """Place what a message lists, behind the common fields or from a byte on; ``sync``: bytes to leave.

    Mistakes go to ``fail`` (B-FRAME-001 to 006, 015).
    """
    common, start = ((), first) if isinstance(first, int) else (first.fields, first.end)
    placer = _PartPlacer(common, start, endian, fail, sync)
    for index, spec in enumerate(specs):
        placer.take(spec, (*path, index))
    end = placer.close(path)
    if sync and end <= sync.start:
        text = f"no field stands behind byte {sync.start}, where the sync bytes stand"
        fail("B-FRAME-006", path, text, "give at least one field behind them")
    return placer.message(end)


class _PartPlacer(Placer):
    """Lays fields and the parts of a message."""

    def __init__(self, placed: Sequence[Field], start: int, endian: Endian, fail: Fail, sync: range) -> None:
        super().__init__(placed, start, endian, fail, sync)
        self._parts: list[Part] = []
        self._head: int | None = None
        self._mark = start

    def take(self, spec: AnyField, where: Path_) -> None:
        """Place a field, or all of a group, an optional part or items."""
        if isinstance(spec, FieldSpec) and (spec.count != "rest" or spec.type != "bytes"):
            self.add(spec, where)
            return
        name = spec.name if isinstance(spec, FieldSpec) else _name_of(spec)
        begin = self.close(where)
        if any(part.open_ended for part in self._parts):
            what = f"{name!r} follows a field of 'rest' length or items"
            self._fail("B-FRAME-002", where, f"{what}: behind them fields stand alone")
        if isinstance(spec, FieldSpec):
            self.add(spec, where)
            part = Part("rest", name, begin, 0)
        elif isinstance(spec, ItemsSpec):
            part = self._items(spec, where, begin)
        else:
            part = (
                self._group(spec, where, begin) if isinstance(spec, GroupSpec) else self._optional(spec, where, begin)
            )
        self._parts.append(part)
        self._mark = self.end(where)

    def close(self, where: Path_) -> int:
        """End a run of fields at a fixed distance from each other; gives the byte behind it."""
        end = self.end(where)
        if self._head is None:
            self._head = end
        elif end > self._mark:
            name = next(item.name for item in self.placed if item.offset >= self._mark and item.length)
            self._parts.append(Part("plain", name, self._mark, end - self._mark))
        return end

    def message(self, end: int) -> Placed:
        """Return all that was placed; bytes of variable length at the end need no part."""
        parts = list(self._parts)
        for index, part in enumerate(parts):
            if part.open_ended:
                parts[index] = replace(part, behind=sum(other.size for other in parts[index + 1 :]))
        if len(parts) == 1 and parts[0].kind == "rest":
            parts = []
        return Placed(tuple(self.placed), tuple(parts), end if self._head is None else self._head, end)

    def _group(self, spec: GroupSpec, where: Path_, begin: int) -> Part:
        by, bits = self._says(spec.count, (*where, "count"))
        for index, one in enumerate(spec.fields):
            at = (*where, "fields", index)
            self._refuse(one, at, "of a group")
            if one.type == "bytes" or one.count is not None:
                text = f"{one.name}: a field of a group is one number"
                self._fail("B-FRAME-015", at, text, "name each element of an array; u8, u16, ... hold reserved bytes")
            self.add(one, at)
        size = self.end(where) - begin
        self._change(len(spec.fields), lambda item: replace(item, count=spec.max, step=size, given=spec.count))
        self.skip((spec.max - 1) * size)
        return Part("group", spec.group, begin, size, spec.max, by, bits)

    def _optional(self, spec: OptionalSpec, where: Path_, begin: int) -> Part:
        by, bits = self._says(spec.when, (*where, "when"))
        for index, one in enumerate(spec.fields):
            self._refuse(one, (*where, "fields", index), "that may be absent")
            self.add(one, (*where, "fields", index))
        self._change(len(spec.fields), lambda item: replace(item, given=spec.when))
        return Part("optional", spec.optional, begin, self.end(where) - begin, 1, by, bits)

    def _items(self, spec: ItemsSpec, where: Path_, begin: int) -> Part:
        id_size, length_size = int(spec.id[1:]) // 8, int(spec.length[1:]) // 8
        items: list[Item] = []
        for name, one in spec.of.items():
            path = (*where, "of", name)
            at = self.end(path)
            self.put(Field(name, "u", 1, None, at, big=True), path)
            self.skip(1)
            for index, field in enumerate(one.fields):
                if not one.required:
                    self._refuse(field, (*path, "fields", index), "that may be absent")
                self.add(field, (*path, "fields", index))
            if not one.required:
                self._change(len(one.fields), lambda item, name=name: replace(item, given=name))  # type: ignore[misc]
            size = self.end(path) - at - 1
            other = next((item.name for item in items if item.number == one.id), "")
            if other or one.id >= 1 << 8 * id_size:
                text = f"{name}: the id 0x{one.id:X} is {f'that of {other!r}' if other else f'no {spec.id}'}"
                self._fail("B-FRAME-015", (*path, "id"), text)
            if size - spec.plus >= 1 << 8 * length_size:
                text = f"{name}: {size} bytes are more than a length of {spec.length} can say"
                self._fail("B-FRAME-015", path, text)
            items.append(Item(name, one.id, at, size, one.required))
        return Part(
            "items", spec.items, begin, 0, items=tuple(items), id_size=id_size, length_size=length_size,
            order=spec.endian or self._endian, length_first=spec.length_first, plus=spec.plus,
        )  # fmt: skip

    def _change(self, number: int, change: Callable[[Field], Field]) -> None:
        fields = self.placed
        if number:
            fields[-number:] = [change(item) for item in fields[-number:]]

    def _says(self, name: str, where: Path_) -> tuple[Field | None, Span | None]:
        """Return the field, and the bits of it, that say how often something is there."""
        base, _, bits = name.partition(".")
        field = next((item for item in self.placed if item.name == base), None)
        problem, names = "", [item.name for item in self.placed]
        if field is None:
            problem = "is no field in front of it"
        elif field.given:
            problem = "may be absent itself"
        elif (field.kind, field.count) != ("u", None) or field.size > _BYTES:
            problem = "is not one unsigned integer of up to 32 bits"
        elif bits and bits not in field.bits:
            problem, names = f"has no bits {bits!r}", list(field.bits)
        if problem:
            close = difflib.get_close_matches(bits or base, names, 1)
            advice = f"did you mean {close[0]!r}?" if close and close[0] != base else _SAYS
            self._fail("B-FRAME-015", where, f"{base!r} {problem}", advice)
        return (None, None) if problem or field is None else (field, field.bits.get(bits))

    def _refuse(self, spec: FieldSpec, where: Path_, what: str) -> None:
        if spec.count == "rest":
            self._fail("B-FRAME-015", (*where, "count"), f"{spec.name}: a field {what} has no 'rest'")
        for key in _ALWAYS_THERE:
            if getattr(spec, key) is not None:
                text = f"{spec.name}: {key!r} makes no sense for a field {what}"
                self._fail("B-FRAME-015", (*where, key), text, f"remove {key!r}")


def _name_of(spec: GroupSpec | OptionalSpec | ItemsSpec) -> str:
    if isinstance(spec, GroupSpec):
        return spec.group
    return spec.optional if isinstance(spec, OptionalSpec) else spec.items
