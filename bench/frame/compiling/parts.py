"""From what a message lists to fields with places, and the parts of it that stand at no fixed place."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bench.frame.compiling.fields import Fail, Placer
from bench.frame.layout import Field, Item, Part, Span
from bench.frame.spec import AnyField, FieldSpec, GroupSpec, ItemsSpec, OptionalSpec
from bench.model.yamlio import Path_

_ALWAYS_THERE = ("role", "per", "constant", "default")
_BYTES = 4
_SAYS = "name an unsigned integer that stands in front of it in every frame, or bits of one"


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
        return [item for item in self.fields if item.offset + item.length <= self.head]


def place(specs: Sequence[AnyField], path: Path_, first: Placed | int, endian: str, fail: Fail,
          sync: range = range(0)) -> Placed:  # fmt: skip
    """Place what a message lists, behind the common fields or from a byte on; ``sync``: bytes to leave.

    Mistakes go to ``fail`` (B-FRAME-001 to 006, 015).
    """
    common, start = ((), first) if isinstance(first, int) else (first.fields, first.end)
    work = _Work(Placer(common, start, endian, fail, sync), endian, fail)
    work.mark = start
    for index, spec in enumerate(specs):
        work.take(spec, (*path, index))
    end = work.close(path)
    if sync and end <= sync.start:
        text = f"no field stands behind byte {sync.start}, where the sync bytes stand"
        fail("B-FRAME-006", path, text, "give at least one field behind them")
    return work.placed(end)


class _Work:
    def __init__(self, placer: Placer, endian: str, fail: Fail) -> None:
        self._placer = placer
        self._endian = endian
        self._fail = fail
        self._parts: list[Part] = []
        self._head: int | None = None
        self.mark = 0

    def take(self, spec: AnyField, where: Path_) -> None:
        """Place a field, or all of a group, an optional part or items."""
        if isinstance(spec, FieldSpec) and spec.count != "rest":
            self._placer.add(spec, where)
            return
        name = spec.name if isinstance(spec, FieldSpec) else _name_of(spec)
        begin = self.close(where)
        if any(part.open_ended for part in self._parts):
            what = f"{name!r} follows a field of 'rest' length or items"
            self._fail("B-FRAME-002", where, f"{what}: behind them fields stand alone", "")
        if isinstance(spec, FieldSpec):
            self._placer.add(spec, where)
            part = Part("rest", name, begin, 0)
        elif isinstance(spec, ItemsSpec):
            part = self._items(spec, where, begin)
        else:
            part = (
                self._group(spec, where, begin) if isinstance(spec, GroupSpec) else self._optional(spec, where, begin)
            )
        self._parts.append(part)
        self.mark = self._placer.end(where)

    def close(self, where: Path_) -> int:
        """End a run of fields at a fixed distance from each other; gives the byte behind it."""
        end = self._placer.end(where)
        if self._head is None:
            self._head = end
        elif end > self.mark:
            name = next(item.name for item in self._placer.placed if item.offset >= self.mark and item.length)
            self._parts.append(Part("plain", name, self.mark, end - self.mark))
        return end

    def placed(self, end: int) -> Placed:
        """Return all that was placed; bytes of variable length at the end need no part."""
        parts = list(self._parts)
        for index, part in enumerate(parts):
            if part.open_ended:
                parts[index] = replace(part, behind=sum(other.size for other in parts[index + 1 :]))
        if len(parts) == 1 and parts[0].kind == "rest":
            parts = []
        return Placed(tuple(self._placer.placed), tuple(parts), end if self._head is None else self._head, end)

    def _group(self, spec: GroupSpec, where: Path_, begin: int) -> Part:
        by, bits = self._says(spec.count, (*where, "count"))
        for index, one in enumerate(spec.fields):
            at = (*where, "fields", index)
            self._refuse(one, at, "of a group")
            if one.type == "bytes" or one.count is not None:
                text = f"{one.name}: a field of a group is one number"
                self._fail("B-FRAME-015", at, text, "name each element of an array; u8, u16, ... hold reserved bytes")
            self._placer.add(one, at)
        size = self._placer.end(where) - begin
        self._change(len(spec.fields), lambda item: replace(item, count=spec.max, step=size, given=spec.count))
        self._placer.skip((spec.max - 1) * size)
        return Part("group", spec.group, begin, size, spec.max, by, bits)

    def _optional(self, spec: OptionalSpec, where: Path_, begin: int) -> Part:
        by, bits = self._says(spec.when, (*where, "when"))
        for index, one in enumerate(spec.fields):
            self._refuse(one, (*where, "fields", index), "that may be absent")
            self._placer.add(one, (*where, "fields", index))
        self._change(len(spec.fields), lambda item: replace(item, given=spec.when))
        return Part("optional", spec.optional, begin, self._placer.end(where) - begin, 1, by, bits)

    def _items(self, spec: ItemsSpec, where: Path_, begin: int) -> Part:
        id_size, length_size = int(spec.id[1:]) // 8, int(spec.length[1:]) // 8
        items: list[Item] = []
        for name, one in spec.of.items():
            path = (*where, "of", name)
            at = self._placer.end(path)
            self._placer.put(Field(name, "u", 1, None, at, big=True), path)
            self._placer.skip(1)
            for index, field in enumerate(one.fields):
                if not one.required:
                    self._refuse(field, (*path, "fields", index), "that may be absent")
                self._placer.add(field, (*path, "fields", index))
            if not one.required:
                self._change(len(one.fields), lambda item, name=name: replace(item, given=name))  # type: ignore[misc]
            size = self._placer.end(path) - at - 1
            other = next((item.name for item in items if item.number == one.id), "")
            if other or one.id >= 1 << 8 * id_size:
                text = f"{name}: the id 0x{one.id:X} is {f'that of {other!r}' if other else f'no {spec.id}'}"
                self._fail("B-FRAME-015", (*path, "id"), text, "")
            if size >= 1 << 8 * length_size:
                text = f"{name}: {size} bytes are more than a length of {spec.length} can say"
                self._fail("B-FRAME-015", path, text, "")
            items.append(Item(name, one.id, at, size, one.required))
        big = (spec.endian or self._endian) == "big"
        return Part(
            "items", spec.items, begin, 0, items=tuple(items), id_size=id_size, length_size=length_size, big=big
        )

    def _change(self, number: int, change: Callable[[Field], Field]) -> None:
        fields = self._placer.placed
        if number:
            fields[-number:] = [change(item) for item in fields[-number:]]

    def _says(self, name: str, where: Path_) -> tuple[Field | None, Span | None]:
        """Return the field, and the bits of it, that say how often something is there."""
        base, _, bits = name.partition(".")
        field = next((item for item in self._placer.placed if item.name == base), None)
        problem, names = "", [item.name for item in self._placer.placed]
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
            self._fail("B-FRAME-015", (*where, "count"), f"{spec.name}: a field {what} has no 'rest'", "")
        for key in _ALWAYS_THERE:
            if getattr(spec, key) is not None:
                text = f"{spec.name}: {key!r} makes no sense for a field {what}"
                self._fail("B-FRAME-015", (*where, key), text, f"remove {key!r}")


def _name_of(spec: GroupSpec | OptionalSpec | ItemsSpec) -> str:
    if isinstance(spec, GroupSpec):
        return spec.group
    return spec.optional if isinstance(spec, OptionalSpec) else spec.items
