"""Every fault of the simulated bench by name: what it needs, what it does, how it is switched on and off.

The same names serve the command ``bench sim fault``, tests under the virtual clock, and fault schedules.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bench.model.errors import InputError
from sim_instruments.acutrol_3000 import Acutrol3000
from sim_instruments.faults.switchboard import InstrumentFaults, LinkFaults
from sim_instruments.fluke_5720a import Fluke5720A
from sim_instruments.hp_6632b import Hp6632B
from sim_instruments.thermotron_3800 import Thermotron3800

if TYPE_CHECKING:
    from sim_instruments.worlds.common.world import World

OFF = "off"
RESTART_S = 0.3  # the unit's supply is away
MOST_REPLIES = 1_000_000
AXES = (1, 2, 3)
_WHOLE = ("COUNT", "AXIS")
_STUCK = re.compile(r"(?:0x)?((?:[0-9A-Fa-f]{2}){1,16})")

Value = float | str
Switch = Callable[["World", str, tuple[Any, ...]], None]


@dataclass(frozen=True)
class Fault:
    """One fault.

    ``target``: "link", "role" or "" (the bench has one of it). ``values``: name of each value with its limits;
    ``default`` stands for the last value if it is left out. A fault without ``off`` happens once.
    """

    target: str
    values: tuple[tuple[str, float, float], ...]
    does: str
    on: Switch
    off: Switch | None = None
    default: tuple[float, ...] = ()

    @property
    def usage(self) -> str:
        """What has to be written behind the name."""
        words = [self.target.upper()] if self.target else []
        for place, (name, _, _) in enumerate(self.values):
            words.append(f"[{name}]" if place >= len(self.values) - len(self.default) else name)
        return " ".join(words)


def _link(**switches: Any) -> Switch:
    def switch(world: World, target: str, values: tuple[Any, ...]) -> None:
        _set(world.faults.link(target), switches, values)

    return switch


def _role(**switches: Any) -> Switch:
    def switch(world: World, target: str, values: tuple[Any, ...]) -> None:
        _set(world.faults.instrument(target), switches, values)

    return switch


def _set(faults: LinkFaults | InstrumentFaults, switches: dict[str, Any], values: tuple[Any, ...]) -> None:
    """Set each named switch; a slice stands for one of the values."""
    for name, value in switches.items():
        setattr(faults, name, values[value.start] if isinstance(value, slice) else value)


FIRST, SECOND = slice(0, 1), slice(1, 2)


def _unplug(unplugged: bool) -> Switch:
    return lambda world, target, _: world.faults.link(target).unplug(unplugged)


def _chamber(name: str) -> Switch:
    def switch(world: World, _: str, values: tuple[Any, ...]) -> None:
        setattr(world.faults, name, values[0] if values else 0.0)
        for chamber in world.instruments_of(Thermotron3800):
            chamber.fault_changed()

    return switch


def _reference(lost: bool) -> Switch:
    def switch(world: World, _: str, __: tuple[Any, ...]) -> None:
        world.faults.reference_lost = lost

    return switch


def _trip(world: World, _: str, __: tuple[Any, ...]) -> None:
    world.wiring.on_lost_path()


def _drop(world: World, _: str, __: tuple[Any, ...]) -> None:
    for calibrator in world.instruments_of(Fluke5720A):
        calibrator.drop()


def _restart(world: World, _: str, __: tuple[Any, ...]) -> None:
    supply = world.instrument(Hp6632B)
    if supply is None or supply.supplied_V == 0.0:
        return
    world.unit.set_power(False, world.clock.now_ns(), 0.0)

    def back() -> None:
        if supply.supplied_V > 0.0:
            world.unit.set_power(True, world.clock.now_ns(), supply.supplied_V)

    world.after(RESTART_S, back)


def _stall(world: World, _: str, values: tuple[Any, ...]) -> None:
    for table in world.instruments_of(Acutrol3000):
        for number in values or AXES:
            table.stall(number, stalled=bool(values))


def _offset(world: World, _: str, values: tuple[Any, ...]) -> None:
    for table in world.instruments_of(Acutrol3000):
        for number in values[:1] or AXES:
            table.offset(number, values[1] if values else 0.0)


def _interlock(world: World, _: str, __: tuple[Any, ...]) -> None:
    for table in world.instruments_of(Acutrol3000):
        table.drop_interlock()


_RATE = ("RATE", 0.0, 1.0)
_COUNT = ("COUNT", 1, MOST_REPLIES)
_AXIS = ("AXIS", AXES[0], AXES[-1])
FAULTS: dict[str, Fault] = {
    "bit_errors": Fault(
        "link", (("RATE", 0.0, 0.1),), "bits turned over, per bit",
        _link(bit_error_rate=FIRST), _link(bit_error_rate=0.0)),
    "drop": Fault(
        "link", (_RATE,), "frames that never arrive, per frame",
        _link(drop_rate=FIRST), _link(drop_rate=0.0)),
    "duplicate": Fault(
        "link", (_RATE,), "frames that arrive twice, per frame",
        _link(duplicate_rate=FIRST), _link(duplicate_rate=0.0)),
    "silent": Fault("link", (), "the cable is off: nothing arrives", _link(silent=True), _link(silent=False)),
    "unplug": Fault("link", (), "the port is gone, with its name", _unplug(True), _unplug(False)),
    "replug": Fault("link", (), "a new port comes under the same name", _unplug(False)),
    "stuck": Fault(
        "link", (("BYTES", 0, 0),), "these bytes (hexadecimal, such as 55 or AA55) instead of frames, without end",
        _link(stuck=FIRST), _link(stuck=b"")),
    "mute": Fault("role", (), "takes commands and answers no query", _role(mute=True), _role(mute=False)),
    "late": Fault(
        "role", (("SECONDS", 0.0, 3600.0), _COUNT), "the next COUNT replies come so much later",
        _role(late_s=FIRST, late_replies=SECOND), _role(late_replies=0), default=(1,)),
    "garbled": Fault(
        "role", (_COUNT,), "the next COUNT replies have damaged characters",
        _role(garbled_replies=FIRST), _role(garbled_replies=0), default=(1,)),
    "identity": Fault(
        "role", (("TEXT", 0, 0),), "answers the identity question with TEXT",
        _role(identity=FIRST), _role(identity="")),
    "nan": Fault(
        "role", (_COUNT,), "the next COUNT readings are 'not a number'",
        _role(nan_readings=FIRST), _role(nan_readings=0), default=(1,)),
    "overload": Fault(
        "role", (_COUNT,), "the next COUNT readings are overload",
        _role(overload_readings=FIRST), _role(overload_readings=0), default=(1,)),
    "hang": Fault(
        "role", (), "takes what is sent and answers nothing, neither serial poll nor device clear",
        _role(hang=True), _role(hang=False)),
    "trip": Fault("", (), "the calibrator trips to standby and queues a fault", _trip),
    "calibrator_drops": Fault("", (), "the calibrator's output goes off without a word; readback disagrees", _drop),
    "chamber_runaway": Fault(
        "", (("RATE", -20.0, 20.0),), "a running chamber leaves its set-point, degC/min; only STOP ends it",
        _chamber("chamber_runaway_degC_min"), _chamber("chamber_runaway_degC_min")),
    "chamber_shortfall": Fault(
        "", (("DEGC", -50.0, 50.0),), "the chamber stays that far from its set-point and never settles",
        _chamber("chamber_shortfall_degC"), _chamber("chamber_shortfall_degC")),
    "reference_lost": Fault("", (), "the counters' external 10 MHz is gone", _reference(True), _reference(False)),
    "unit_restart": Fault("", (), f"the unit loses its supply for {RESTART_S:g} s; its counter starts anew", _restart),
    "table_stall": Fault(
        "", (_AXIS,), "an axis of the turntable stops where it is and obeys nothing", _stall, _stall),
    "table_offset": Fault(
        "", (_AXIS, ("DEG", -10.0, 10.0)), "an axis of the turntable stands that far from where it is sent",
        _offset, _offset),
    "table_interlock": Fault("", (), "the safety chain of the turntable opens: it is braked to rest", _interlock),
}  # fmt: skip
_COUNTERS = {
    "late": "late_replies",
    "garbled": "garbled_replies",
    "nan": "nan_readings",
    "overload": "overload_readings",
}


class FaultSwitches:
    """The switches of one world."""

    def __init__(self, world: World, links: Iterable[str]) -> None:
        self._world = world
        self._links = tuple(links)
        self._on: dict[tuple[str, str], str] = {}

    def targets(self, kind: str) -> tuple[str, ...]:
        """Names that may stand behind a fault of this kind of target."""
        return {"link": self._links, "role": tuple(self._world.instruments)}.get(kind, ())

    def switch(self, name: str, target: str = "", *values: Value) -> None:
        """Switch one fault on, or off if the only value is "off".

        Raises: InputError B-SIM-010 (no such fault), B-SIM-011 (no such link or role), B-SIM-012 (wrong value).
        """
        fault = FAULTS.get(name)
        if fault is None and name in ("clear", "state"):
            raise InputError("B-SIM-012", f"{name!r} stands alone", where=name, next_step=f"bench sim fault {name}")
        if fault is None:
            raise InputError("B-SIM-010", f"there is no fault {name!r}", next_step=_choice(name, FAULTS))
        if not fault.target and target != "":
            target, values = "", (target, *values)
        known = self.targets(fault.target)
        if fault.target and target not in known:
            message = f"{name} needs a {fault.target}, and {target!r} is none" if target else f"{name} needs a target"
            raise InputError("B-SIM-011", message, where=name, next_step=_choice(target, known))
        if values == (OFF,) and fault.off is not None:
            self._act(name, target, fault.off, ())
            return
        self._act(name, target, fault.on, _values(name, fault, values))
        if fault.off is not None:
            self._on[name, target] = " ".join([name, *filter(None, [target]), *map(str, values)])

    def _act(self, name: str, target: str, act: Switch, values: tuple[Any, ...]) -> None:
        with self._world.lock:
            act(self._world, target, values)
        self._on.pop(("unplug" if name == "replug" else name, target), None)

    def clear(self) -> None:
        """Switch every fault off; what has happened once has happened."""
        for name, target in list(self._on):
            self.switch(name, *filter(None, [target]), OFF)

    @property
    def on(self) -> list[str]:
        """The faults that are on, as they were given, in order; counted ones until their count is used up."""
        return [text for (name, target), text in self._on.items() if not self._used_up(name, target)]

    def _used_up(self, name: str, target: str) -> bool:
        return name in _COUNTERS and getattr(self._world.faults.instrument(target), _COUNTERS[name]) == 0


def listing() -> list[str]:
    """One line for each fault."""
    rows = [(f"{name} {fault.usage}".strip(), fault.does) for name, fault in FAULTS.items()]
    width = max(len(first) for first, _ in rows)
    return [f"{first:{width}}  {does}" for first, does in rows]


def _values(name: str, fault: Fault, values: tuple[Value, ...]) -> tuple[Any, ...]:
    """The values a fault needs, checked. Raises: InputError B-SIM-012."""
    missing = len(fault.values) - len(values)
    if missing < 0 or missing > len(fault.default):
        message = f"{name} takes {fault.usage or 'nothing'}, not {len(values)} values"
        raise InputError("B-SIM-012", message, where=name, next_step="bench sim fault lists all with what they take")
    given = (*values, *fault.default[len(fault.default) - missing :])
    return tuple(_value(name, what, value) for what, value in zip(fault.values, given, strict=True))


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
        number = _number(value)
        if low <= number <= high and (word not in _WHOLE or number == int(number)):
            return int(number) if word in _WHOLE else number
        due = f"a {'whole ' if word in _WHOLE else ''}number from {low:g} to {high:g} is due"
    raise InputError("B-SIM-012", f"{word} of {name} is {value!r}", where=name, next_step=due)


def _number(value: Value) -> float:
    try:
        return float(value)
    except ValueError:
        return math.nan


def _choice(word: str, known: Iterable[str]) -> str:
    names = list(known)
    near = difflib.get_close_matches(word, names, n=1)
    return (f"did you mean {near[0]!r}? " if near else "") + f"use one of: {', '.join(names)}"
