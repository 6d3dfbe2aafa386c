"""The faults of one simulated bench by name: those of its links and those that its instruments declare.

The same names serve the command ``bench sim fault``, tests under the virtual clock, and fault schedules.
"""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from bench.model.errors import InputError
from sim_instruments.faults.fault import LINK, ROLE, Fault, NamedFaults, Value
from sim_instruments.faults.switchboard import Faults, InstrumentFaults, LinkFaults

OFF = "off"


class Faulty(Protocol):
    """A simulated instrument, as far as its own faults go."""

    named_faults: NamedFaults


class FaultyBench(Protocol):
    """The simulated bench whose faults are switched; ``instruments`` by role, ``ports`` are its links."""

    lock: contextlib.AbstractContextManager[Any]
    faults: Faults
    instruments: Mapping[str, Faulty]
    ports: tuple[str, ...]


class FaultSwitches:
    """The switches of one bench."""

    def __init__(self, bench: FaultyBench) -> None:
        self._bench = bench
        self._on: dict[tuple[str, str], str] = {}

    @property
    def known(self) -> dict[str, Fault]:
        """All faults the bench can have."""
        return every_fault(self._bench.instruments.values())

    def targets(self, kind: str) -> tuple[str, ...]:
        """Return names that may stand behind a fault of this kind of target."""
        return {LINK: self._bench.ports, ROLE: tuple(self._bench.instruments)}.get(kind, ())

    def switch(self, name: str, target: str = "", *values: Value) -> None:
        """Switch one fault on, or off if the only value is "off".

        Raises: InputError B-SIM-010 (no such fault), B-SIM-011 (no such link or role), B-SIM-012 (wrong value).
        """
        fault = self._fault(name)
        if not fault.target and target != "":
            target, values = "", (target, *values)
        known = self.targets(fault.target)
        if fault.target and target not in known:
            message = f"{name} needs a {fault.target}, and {target!r} is none" if target else f"{name} needs a target"
            raise InputError("B-SIM-011", message, where=name, next_step=_choice(target, known))
        if values == (OFF,) and fault.off is not None:
            self._act(name, fault, target, None)
            return
        self._act(name, fault, target, fault.checked(name, values))
        if fault.off is not None:
            self._on[name, target] = " ".join([name, *filter(None, [target]), *map(str, values)])

    def _fault(self, name: str) -> Fault:
        known = self.known
        if name in known:
            return known[name]
        if name in ("clear", "state"):
            raise InputError("B-SIM-012", f"{name!r} stands alone", where=name, next_step=f"bench sim fault {name}")
        raise InputError("B-SIM-010", f"this bench has no fault {name!r}", next_step=_choice(name, known))

    def _act(self, name: str, fault: Fault, target: str, values: tuple[Any, ...] | None) -> None:
        """Switch a fault on with its values, or off for None, as each that has it declares it."""
        with self._bench.lock:
            for subject in self._subjects(name, fault, target):
                own = subject.named_faults[name]
                switch = own.off if values is None else own.on
                if switch is not None:
                    switch(subject, *(values or ()))
        self._on.pop((fault.ends or name, target), None)

    def _subjects(self, name: str, fault: Fault, target: str) -> list[Any]:
        if fault.target == LINK:
            return [self._bench.faults.link(target)]
        if fault.target == ROLE:
            return [self._bench.faults.instrument(target)]
        return [device for device in self._bench.instruments.values() if name in device.named_faults]

    def clear(self) -> None:
        """Switch every fault off; what has happened once has happened."""
        for name, target in list(self._on):
            self.switch(name, *filter(None, [target]), OFF)

    @property
    def on(self) -> list[str]:
        """The faults that are on, as they were given, in order; counted ones until their count is used up."""
        known = self.known
        return [text for (name, target), text in self._on.items() if not self._used_up(name, known[name], target)]

    def _used_up(self, name: str, fault: Fault, target: str) -> bool:
        subjects = self._subjects(name, fault, target)
        return bool(fault.counted) and all(getattr(subject, fault.counted) == 0 for subject in subjects)


def every_fault(instruments: Iterable[Faulty | type[Faulty]]) -> dict[str, Fault]:
    """Return the faults of links, of interfaces and of these instruments, in the order of their kinds."""
    own = {name: fault for instrument in instruments for name, fault in instrument.named_faults.items()}
    ordered = sorted(own.items(), key=lambda named: named[1].of)
    return {**LinkFaults.named_faults, **InstrumentFaults.named_faults, **dict(ordered)}


def listing(faults: NamedFaults) -> list[str]:
    """Return one line for each fault."""
    rows = [(f"{name} {fault.usage}".strip(), fault.does) for name, fault in faults.items()]
    width = max(len(first) for first, _ in rows)
    return [f"{first:{width}}  {does}" for first, does in rows]


def _choice(word: str, known: Iterable[str]) -> str:
    names = list(known)
    near = difflib.get_close_matches(word, names, n=1)
    return (f"did you mean {near[0]!r}? " if near else "") + f"use one of: {', '.join(names)}"
