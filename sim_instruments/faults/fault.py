"""The form of a fault of the simulated bench: what it needs, what it does, how it is switched on and off.

A link, the interface of an instrument and each simulated model declare their own as ``named_faults``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from bench.model.errors import InputError

LINK, ROLE = "link", "role"
_WHOLE = ("COUNT", "AXIS")
_STUCK = re.compile(r"(?:0x)?((?:[0-9A-Fa-f]{2}){1,16})")

Value = float | str
Switch = Callable[..., None]  # called with what has the fault, and its values


@dataclass(frozen=True)
class Fault:
    """One fault.

    ``of``: LINK or ROLE, then one of them is named; else the kind of instrument that has it, such as "chamber".
    ``values``: name of each value with its limits; ``default`` stands for the last value if it is left out. A fault
    without ``off`` happens once. ``ends``: the fault it switches off.   ``counted``: attribute that counts down to its
    end.
    """

    of: str
    values: tuple[tuple[str, float, float], ...]
    does: str
    on: Switch
    off: Switch | None = None
    default: tuple[float, ...] = ()
    ends: str = ""
    counted: str = ""

    @property
    def target(self) -> str:
        """Sort of target that has to be named: "link", "role" or "" (the bench knows which instrument it is)."""
        return self.of if self.of in (LINK, ROLE) else ""

    @property
    def usage(self) -> str:
        """Words that have to be written behind the name."""
        words = [self.target.upper()] if self.target else []
        for place, (name, _, _) in enumerate(self.values):
            words.append(f"[{name}]" if place >= len(self.values) - len(self.default) else name)
        return " ".join(words)

    def checked(self, name: str, values: tuple[Value, ...]) -> tuple[Any, ...]:
        """Return the values the fault needs. Raises: InputError B-SIM-012."""
        missing = len(self.values) - len(values)
        if missing < 0 or missing > len(self.default):
            due = f"bench sim fault {' '.join(filter(None, (name, self.usage)))}"
            extra = f"{values[-1]!r} is one value too many" if missing < 0 else f"{missing} values are missing"
            next_step = f"{due} switches it on, 'off' behind the name and target switches it off"
            raise InputError("B-SIM-012", f"{name}: {extra}", where=name, next_step=next_step)
        given = (*values, *self.default[len(self.default) - missing :])
        return tuple(_value(name, what, value) for what, value in zip(self.values, given, strict=True))


NamedFaults = Mapping[str, Fault]


def takes(*attributes: str) -> Switch:
    """Return a switch that sets these attributes to the values, in their order."""

    def switch(subject: Any, *values: Any) -> None:
        for attribute, value in zip(attributes, values, strict=True):
            setattr(subject, attribute, value)

    return switch


def becomes(**attributes: Any) -> Switch:
    """Return a switch that sets these attributes as they stand here."""

    def switch(subject: Any) -> None:
        for attribute, value in attributes.items():
            setattr(subject, attribute, value)

    return switch


def _value(name: str, what: tuple[str, float, float], value: Value) -> Any:
    word, low, high = what
    if word == "TEXT":
        if str(value).isascii() and str(value).isprintable() and str(value):
            return str(value)
        due = "printable ASCII text is due"
    elif word == "BYTES":
        if match := _STUCK.fullmatch(str(value)):
            return bytes.fromhex(match[1])
        due = "1 to 16 hexadecimal bytes are due"
    else:
        number = plain_number(value)
        if low <= number <= high and (word not in _WHOLE or number == int(number)):
            return int(number) if word in _WHOLE else number
        due = f"a {'whole ' if word in _WHOLE else ''}number from {low:g} to {high:g} is due"
    raise InputError("B-SIM-012", f"{word} of {name} is {value!r}", where=name, next_step=due)


def plain_number(value: Any) -> float:
    """Return a value as a number, nan if it is none."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan
