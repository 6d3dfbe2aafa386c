"""The decision of the guard: what it is told at its start, so that it asks nobody later, and when it acts.

The decision is a pure function of what it was told since, and of the time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from bench.model.clock import NS

Reason = Literal["gone", "silent", "limit", "left"]


@dataclass(frozen=True)
class Address:
    """One instrument as the station names it."""

    role: str
    driver: str
    resource: str
    options: Mapping[str, Any] = field(default_factory=dict)
    line: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Brief:
    """The safe-state list and its surroundings.

    Attributes:
        pid: of the controller, which is the guard's parent.
        visa: VISA library of the station.   boards: GPIB boards that are adapters, and the addresses of their streams.
        instruments: in the order in which they are made safe.
        limits: hard limits by quantity with its unit.
        silence_s: how long the controller may be silent.
        diary: file the guard writes what it did to.
        notify: command (argument list) that is told in JSON on its standard input what was done; empty: nobody.
        terminal: path of the terminal or file that the controller writes to, for the guard's last words; "": none.
        simulated: whether the bench is; its guard ends with the folder of the session, as rehearsals are removed.
        code: SHA-256 of the drivers that a lab folder brings, by their place in it; the guard loads these or none.
    """

    pid: int
    visa: str
    instruments: tuple[Address, ...]
    limits: Mapping[str, float]
    silence_s: float
    diary: str
    notify: tuple[str, ...] = ()
    terminal: str = ""
    simulated: bool = False
    code: Mapping[str, str] = field(default_factory=dict)
    boards: Mapping[str, str] = field(default_factory=dict)

    def line(self) -> bytes:
        """Return the brief as one line of JSON."""
        return json.dumps(asdict(self), separators=(",", ":")).encode() + b"\n"

    @classmethod
    def of_line(cls, line: bytes) -> Brief:
        """Return the brief a line holds."""
        document = json.loads(line)
        instruments = tuple(Address(**entry) for entry in document.pop("instruments"))
        return cls(instruments=instruments, notify=tuple(document.pop("notify")), **document)


@dataclass
class Watched:
    """State of the controller, as far as the guard knows it.

    ``limits`` and ``values`` are by name of the quantity with its unit (``chamber_air_degC``); ``heard_ns`` is when
    the controller was last heard of; ``silence_s`` how long it may be silent, infinite where silence says nothing.
    """

    limits: Mapping[str, float]
    silence_s: float
    heard_ns: int
    values: Mapping[str, float] = field(default_factory=dict)
    at: tuple[str, float] = ("", 0.0)  # what the sequencer was at by its last heartbeat, and for how many seconds
    gone: bool = False  # the pipe is closed and nobody said goodbye
    heat_off: bool = False  # of a controller that leaves: a source of heat is to be stopped
    goodbye: Mapping[str, str] | None = None  # what the controller that leaves could not confirm safe, and its state


@dataclass(frozen=True)
class Action:
    """An act that is due: the bench is made safe, with ``heat_off`` the heat sources go off first.

    ``left``: the roles that a controller left behind unconfirmed; None: nobody knows, everything is made safe.
    """

    reason: Reason
    text: str
    heat_off: bool = False
    left: tuple[str, ...] | None = None


def decide(state: Watched, now_ns: int) -> Action | None:
    """Return what the guard has to do at ``now_ns``, None if nothing.

    A limit counts as crossed where it is reached. A value that is not a number crosses nothing: a reading that fails
    is the interlocks' business.
    """
    if state.goodbye is not None:
        told = ", ".join(f"{role} {known}" for role, known in state.goodbye.items())
        text = f"the controller left with {told}"
        return Action("left", text, state.heat_off, tuple(state.goodbye)) if told else None
    for name, limit in sorted(state.limits.items()):
        value = state.values.get(name)
        if value is not None and value >= limit:
            return Action("limit", f"{name} is {value:.6g}, the hard limit is {limit:g}", heat_off=True)
    if state.gone:
        return Action("gone", "the controller ended without a goodbye")
    silent_s = (now_ns - state.heard_ns) / NS
    if silent_s >= state.silence_s:
        what, for_s = state.at
        last = f"; it was at {what}, for {for_s:.1f} s by then" if what else ""
        return Action("silent", f"no heartbeat for {silent_s:.2f} s, the limit is {state.silence_s:g} s{last}")
    return None
