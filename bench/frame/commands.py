"""Commands of a frame file: their payloads compiled, values to bytes and back, one at a time."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.frame.compiling.fields import Fail, place_fields
from bench.frame.layout import Field, Message, field_content, read_element
from bench.frame.spec import CommandSpec, Endian, FieldSpec, FrameSpec
from bench.model.errors import InputError
from bench.model.units import read_quantity
from bench.model.yamlio import Path_

_MOST_F32 = 3.4028234663852886e38
COMMAND, ANSWER = "command", "answer"
_OF_FRAMES = ("role", "per", "bits", "constant", "form")  # keys that mean something in a stream of frames only


@dataclass(frozen=True)
class PayloadLayout:
    """Fields one behind the other, from the first byte of a payload on; ``title`` names it in messages."""

    title: str
    fields: tuple[Field, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields, in wire order."""
        return tuple(item.name for item in self.fields)

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Return bytes of physical values.

        Args: values: by field, in its unit: a number, a text with a unit of the same kind ("200 Hz"), a list for an
            array, bytes or hex text for bytes. Fields with a scale take the nearest step, others need whole numbers.
        Raises: InputError B-FRAME-020 (missing, wrong number of elements), 021 (does not fit), 022 (unknown).
        """
        unknown = [name for name in values if name not in self.names]
        if unknown:
            due = ", ".join(self.names) or "nothing"
            raise self._wrong(f"has no field {unknown[0]!r}", f"it takes {due}", "B-FRAME-022")
        return b"".join(self._bytes_of(item, values.get(item.name)) for item in self.fields)

    def decode(self, payload: bytes) -> dict[str, Any]:
        """Physical values by field: int where the raw value is the value, else float; lists for arrays.

        Bytes are given as hex text. Raises: InputError B-FRAME-025 if the payload is too short or too long.
        """
        due = sum(item.length for item in self.fields)
        open_end = bool(self.fields) and self.fields[-1].rest
        if len(payload) < due or (len(payload) > due and not open_end):
            least = "at least " if open_end else ""
            text = f"has {len(payload)} bytes, {least}{due} are due"
            raise self._wrong(text, "compare the 'commands' of the frame file with the unit's firmware", "B-FRAME-025")
        return {item.name: _value_of(payload, item) for item in self.fields}

    def _bytes_of(self, item: Field, value: Any) -> bytes:
        if value is None:
            if item.default is None:
                raise self._wrong(f"needs a value for {item.name!r}", "give every field without default", "B-FRAME-020")
            return item.default
        if item.kind == "b":
            return self._plain_bytes(item, value)
        elements = [value] if item.count is None else value
        if isinstance(elements, str | bytes) or not hasattr(elements, "__len__") or len(elements) != (item.count or 1):
            text = f"{item.name!r} needs {item.count} values, not {value!r}"
            raise self._wrong(text, "give a list", "B-FRAME-020")
        return b"".join(self._element(item, element) for element in elements)

    def _plain_bytes(self, item: Field, value: Any) -> bytes:
        try:
            found = bytes.fromhex(value) if isinstance(value, str) else bytes(value)
        except (TypeError, ValueError):
            raise self._wrong(f"{item.name!r}: {value!r} is neither bytes nor hex text") from None
        if not item.rest and len(found) != item.length:
            raise self._wrong(f"{item.name!r} has {len(found)} bytes, {item.length} are due")
        return found

    def _element(self, item: Field, value: Any) -> bytes:
        number = self._number(item, value)
        raw = (number - item.shift) / item.scale if item.scaled else number
        try:
            if item.kind == "f":
                return struct.pack(item.float_code, raw)
            whole: int = round(raw)
            if not item.scaled and whole != raw:
                raise self._wrong(f"{item.name!r}: {value!r} is no whole number")
            return whole.to_bytes(item.size, item.order, signed=item.kind == "i")
        except OverflowError:
            low, high = _limits(item)
            text = f"{item.name!r}: {value!r} is outside {low:g} to {high:g} {item.unit}".rstrip()
            raise self._wrong(text, "correct the value") from None

    def _number(self, item: Field, value: Any) -> Any:
        """Return a finite number in the unit of the field; numpy's numbers become Python's."""
        number = value.item() if hasattr(value, "item") else value
        if isinstance(number, str):
            given, unit = read_quantity(number), read_quantity(f"1 {item.unit or '1'}")
            if given is None or unit is None or given[1] != unit[1]:
                text = f"{item.name!r}: {value!r} is no quantity in {item.unit or '1'}"
                raise self._wrong(text, "write a number and a unit of that kind")
            number = round(given[0] / unit[0], 12)
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            raise self._wrong(f"{item.name!r}: {value!r} is no finite number")
        return number

    def _wrong(self, text: str, next_step: str = "", code: str = "B-FRAME-021") -> InputError:
        return InputError(code, text, where=self.title, next_step=next_step)


@dataclass(frozen=True)
class CommandLayout:
    """One command of a link: ``request`` is the payload of the command, ``answer`` that behind the status byte."""

    name: str
    code: int
    timeout_s: float
    request: PayloadLayout
    answer: PayloadLayout

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """Payload of the command; see PayloadLayout.encode."""
        return self.request.encode(values)

    def decode(self, payload: bytes) -> dict[str, Any]:
        """Return values of an answer from its payload behind the status byte; see PayloadLayout.decode."""
        return self.answer.decode(payload)


def canonical_commands(commands: Sequence[CommandLayout]) -> dict[str, Any]:
    """Return JSON-able content of the commands of a link."""
    return {
        command.name: [
            command.code,
            command.timeout_s,
            [field_content(item) for item in command.request.fields],
            [field_content(item) for item in command.answer.fields],
        ]
        for command in commands
    }


def _limits(item: Field) -> tuple[float, float]:
    """Least and greatest value that fits, in the unit of the field."""
    ends = (-_MOST_F32, _MOST_F32) if item.kind == "f" else item.bounds
    first, last = sorted(end * item.scale + item.shift for end in ends)
    return first, last


def _value_of(payload: bytes, item: Field) -> Any:
    if item.kind == "b":
        return payload[item.offset : len(payload) if item.rest else item.end].hex()
    raw = [read_element(payload, item, element) for element in range(item.count or 1)]
    values = [value * item.scale + item.shift if item.scaled else value for value in raw]
    return values[0] if item.count is None else values


def compile_commands(spec: FrameSpec, messages: Sequence[Message], fail: Fail) -> dict[str, CommandLayout]:
    """Layouts by name; mistakes go to ``fail`` (B-FRAME-014, and those of fields)."""
    if spec.commands is None:
        return {}
    _check_messages(messages, fail)
    found: dict[str, CommandLayout] = {}
    for name, part in spec.commands.items():
        path: Path_ = ("commands", name)
        if any(part.code == other.code for other in found.values()):
            fail("B-FRAME-014", (*path, "code"), f"{name}: the code 0x{part.code:02x} is taken", "choose another code")
        found[name] = _layout(name, part, path, spec.endian or "big", fail)
    return found


def _layout(name: str, part: CommandSpec, path: Path_, endian: Endian, fail: Fail) -> CommandLayout:
    def payload(key: str, fields: tuple[FieldSpec, ...]) -> PayloadLayout:
        where = (*path, key)
        for index, field in enumerate(fields):
            for word in _OF_FRAMES:
                if getattr(field, word) is not None:
                    text = f"{field.name}: {word!r} makes no sense in the payload of a command"
                    fail("B-FRAME-014", (*where, index, word), text, f"remove {word!r}")
            if field.type[0] in "ui" and int(field.type[1:]) % 8:
                text = f"{field.name}: a number in the payload of a command has 8, 16, ... 64 bits"
                fail("B-FRAME-014", (*where, index, "type"), text, "give a type of whole bytes")
        return PayloadLayout(f"{key} of {name!r}", tuple(place_fields(fields, where, endian, fail)))

    request, answer = payload("request", part.request), payload("answer", part.answer)
    return CommandLayout(name, part.code, part.timeout, request, answer)


def _check_messages(messages: Sequence[Message], fail: Fail) -> None:
    """What a command travels in: messages ``command`` and ``answer`` with sequence, command and a payload."""
    due: Mapping[str, tuple[str, ...]] = {COMMAND: ("sequence", "command"), ANSWER: ("sequence", "command", "status")}
    for name, fields in due.items():
        message = next((message for message in messages if message.name == name), None)
        missing = [field for field in fields if message is None or field not in message.by_name]
        if message is None or missing or message.rest is None or message.rest.name != "payload":
            what = f"fields {', '.join(fields)} and payload (bytes, rest)"
            text = f"'commands' needs a message {name!r} with the {what}"
            fail("B-FRAME-014", ("commands",), text)
