"""The compiled form of a frame definition: where every field lies and how a frame is found and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from bench.frame.checksums import Check

_INTEGER_WIDTHS = (1, 2, 4, 8)


@dataclass(frozen=True)
class Field:
    """One field: ``offset`` bytes from the first sync byte, ``count`` elements of ``size`` bytes.

    ``kind`` is "u", "i", "f" or "b" (bytes); ``count`` is None for a single value and 0 for "rest".
    ``bits`` maps a name to (lowest bit, number of bits). Physical value = raw * scale + shift in ``unit``.
    ``wrap``: how many values a counter has, None = as many as its type.
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

    @property
    def length(self) -> int:
        """Bytes on the wire; 0 for "rest"."""
        return self.size * (1 if self.count is None else self.count)

    @property
    def rest(self) -> bool:
        """Whether the field takes everything up to the check."""
        return self.count == 0

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

    ``body`` is the length without the check and without the "rest" bytes; ``length`` the whole frame, 0 if it varies.
    The check covers [cover_start, cover_stop) of the frame; cover_stop None = up to the check.
    """

    name: str
    fields: tuple[Field, ...]
    body: int
    length: int
    cover_start: int
    cover_stop: int | None
    type_value: int | None = None

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
    with the same counter.
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

    @property
    def fixed(self) -> bool:
        """One message of one length: the frames of an undamaged stream form a lattice."""
        return len(self.messages) == 1 and self.length_field is None

    def canonical(self) -> dict[str, Any]:
        """JSON-able content that decides how bytes become numbers; hashed into every session."""
        check = self.check
        model = getattr(check, "model", None)
        silence = {} if self.silence_s is None else {"silence_s": self.silence_s}
        return {
            "sync": self.sync.hex(),
            "check": check.name if model is None else [model.width, *_numbers(model)],
            "stored_big": self.stored_big,
            "length": None if self.length_field is None else [self.length_field.name, self.length_plus],
            "max_length": self.max_length,
            "type": None if self.type_field is None else self.type_field.name,
            "rate_Hz": self.rate_Hz,
            "messages": [_message_content(message) for message in self.messages],
            **silence,
        }


def _numbers(model: Any) -> list[Any]:
    return [model.poly, model.init, model.refin, model.refout, model.xorout]


def _message_content(message: Message) -> dict[str, Any]:
    return {
        "name": message.name,
        "type_value": message.type_value,
        "cover": [message.cover_start, message.cover_stop],
        "fields": [field_content(item) for item in message.fields],
    }


def field_content(item: Field) -> list[Any]:
    """Return JSON-able content of a field; what was added to the language later stands there only where it is used."""
    bits = {name: list(span) for name, span in item.bits.items()}
    constant = None if item.constant is None else item.constant.hex()
    later = [*([] if item.default is None else [item.default.hex()]), *([] if item.wrap is None else [item.wrap])]
    return [
        item.name, item.kind, item.size, item.count, item.offset, item.big, item.scale, item.shift, item.unit,
        item.counter, item.per, bits, constant, *later,
    ]  # fmt: skip
