"""What the guard is told at its start: everything it may need, so that it asks nobody when it acts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Address:
    """One instrument as the station names it."""

    role: str
    driver: str
    resource: str
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Brief:
    """The safe-state list and its surroundings.

    Attributes:
        pid: of the controller, which is the guard's parent.
        visa: VISA library of the station.
        instruments: in the order in which they are made safe.
        limits: hard limits by quantity with its unit.
        silence_s: how long the controller may be silent.
        diary: file the guard writes what it did to.
        notify: command (argument list) that is told in JSON on its standard input what was done; empty: nobody.
    """

    pid: int
    visa: str
    instruments: tuple[Address, ...]
    limits: Mapping[str, float]
    silence_s: float
    diary: str
    notify: tuple[str, ...] = ()

    def line(self) -> bytes:
        """Return the brief as one line of JSON."""
        return json.dumps(asdict(self), separators=(",", ":")).encode() + b"\n"

    @classmethod
    def of_line(cls, line: bytes) -> Brief:
        """The brief a line holds."""
        document = json.loads(line)
        instruments = tuple(Address(**entry) for entry in document.pop("instruments"))
        return cls(instruments=instruments, notify=tuple(document.pop("notify")), **document)
