"""The base of every simulated bench: clock, lock, wires, temperatures, faults, instruments and a unit under test.

Live worlds are found by id: that is how the VISA backend and the serial handler reach the one that was opened for
them. Ids are handed out in order and name a world inside this process only; they never reach a record or a report.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from pyvisa_sim.devices import Devices

from bench.model.clock import Clock
from bench.model.errors import InputError
from bench.model.ports import RecordWindow
from sim_instruments.faults.fault import NamedFaults, plain_number
from sim_instruments.faults.named import FaultSwitches
from sim_instruments.faults.switchboard import Faults
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.terminals import Terminals
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.wiring import UnitInputs, Wiring

_numbers = itertools.count(1)
_worlds: dict[str, World] = {}


class Unit(UnitInputs, Protocol):
    """The simulated unit under test, as the world knows it."""

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        """Supply of the unit on or off, and its voltage; a new voltage while on changes nothing else."""

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        """True frequency at the unit's function-generator input, hertz; 0 without a signal."""


class NoUnit(Unit):
    """The empty place of the unit on a bench that measures sources at the terminals of its meters alone."""


class Instrument(Protocol):
    """A simulated instrument, as the world knows it."""

    role: str
    named_faults: NamedFaults

    def outputs(self) -> dict[str, Any]:
        """Return what the instrument puts out or switches at this moment."""

    def left_by_another(self, draw: np.random.Generator, *, by_hand: bool = True) -> list[str]:
        """Leave it as its last user may have; returns the rows of its state table that are left so."""


class Operation(NamedTuple):
    """What a person can set at a bench.

    ``do``: to a world, with what ``read`` makes of a value, which is None for one that cannot be; ``due``: what can be.
    """

    do: Callable[[Any, Any], None]
    read: Callable[[Any], Any]
    due: str

    @classmethod
    def word(cls, do: Callable[[Any, str], None], *words: str, due: str = "") -> Operation:
        """Return one that takes one of some words."""
        due = due or f"one of {', '.join(words)}"
        return cls(do, lambda value: str(value) if str(value) in words else None, due)

    @classmethod
    def number(
        cls, do: Callable[[Any, float], None], least: float, most: float, unit: str,
        of: Callable[[Any], float] = plain_number, due: str = "",
    ) -> Operation:  # fmt: skip
        """Return one that takes a number, as ``of`` makes it of a value; nan if it is none."""

        def read(value: Any) -> float | None:
            return number if least <= (number := of(value)) <= most else None

        return cls(do, read, due or f"{least:g} to {most:g} {unit}")


class World:
    """One simulated bench. Everything that changes it runs under ``lock``, at a time of ``clock``.

    A system's world is made from (clock, seed, options), and gives this one its unit.

    Args:
        clock: clock of the run; virtual clocks are advanced by bus operations and timeouts.
        seed: seed of every draw.
        unit: the simulated unit under test, None on a bench without one.
        thermal: temperatures; the unit reads its own from it.
        options: checked options of the world.
    Attributes: ports: links of the unit.   supplied_V: voltage of the unit's supply, 0 = off.
    """

    ports: ClassVar[tuple[str, ...]]
    operations: ClassVar[Mapping[str, Operation]] = {}  # what ``operate`` knows

    def __init__(
        self, *, clock: Clock, seed: int, unit: Unit | None, thermal: Thermal, options: Mapping[str, Any]
    ) -> None:
        self.clock = clock
        self.seed = seed
        self.unit: Unit = NoUnit() if unit is None else unit
        self.thermal = thermal
        self.options = dict(options)
        self.lock = threading.RLock()
        self.faults = Faults(seed)
        self.switches = FaultSwitches(self)
        self.wiring = Wiring(self.unit, seed)
        self.terminals = Terminals()
        self.devices = Devices()
        self.instruments: dict[str, Instrument] = {}
        self.supplied_V = 0.0
        self.id = f"w{next(_numbers)}"
        _worlds[self.id] = self
        self._closed = False

    @property
    def time_constants(self) -> float:
        """Factor by which all lags of the bench are shorter."""
        return float(self.options.get("time_constants", 1.0))

    @property
    def visa_library(self) -> str:
        """Name for ``pyvisa.ResourceManager``."""
        return f"{self.id}@bench"

    def link_url(self, name: str) -> str:
        """Return pySerial URL of one of the unit's ports."""
        return f"sim://{self.id}/{name}"

    def connect(self, resource: str, device: Instrument) -> None:
        """Put an instrument at a VISA address."""
        self.devices.add_device(resource, device)
        self.instruments[device.role] = device

    def use_up(self) -> None:
        """Leave every instrument as its last user may have, by the seed, but nothing that only a person puts right."""
        with self.lock:
            for role, device in self.instruments.items():
                device.left_by_another(self.rng(f"last user of the {role}"), by_hand=False)

    def instrument(self, kind: type) -> Any:
        """Return the first instrument of a class, None if there is none (for the wires between instruments)."""
        return next(iter(self.instruments_of(kind)), None)

    def instruments_of(self, kind: type) -> list[Any]:
        """Return all instruments of a class in the order of the station."""
        return [device for device in self.instruments.values() if isinstance(device, kind)]

    def rng(self, purpose: str, *indexes: int) -> np.random.Generator:
        """Return generator of one purpose; the same draws whenever it is asked for."""
        return generator(self.seed, purpose, *indexes)

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        """Return true values of what the campaign estimates, in the form of the contract's ``estimates``."""
        raise NotImplementedError

    def operate(self, name: str, value: Any) -> None:
        """Do what a person does at the bench. Raises: what ``check_operation`` raises."""
        self.check_operation(name, value)
        operation = self.operations[name]
        with self.lock:
            operation.do(self, operation.read(value))

    @classmethod
    def check_operation(cls, name: str, value: Any) -> None:
        """Raises: InputError B-SIM-018, nobody can do that at such a bench; B-SIM-019, not with that value."""
        known = ", ".join(cls.operations) or "nothing"
        operation = cls.operations.get(name)
        if operation is None:
            raise InputError(
                "B-SIM-018", f"{name!r} cannot be set to {value!r} on this simulated bench", where="sets of a prompt",
                next_step=f"what a person can do here: {known}",
            )  # fmt: skip
        if operation.read(value) is None:
            message, advice = f"{name} cannot be {value!r}", f"give {operation.due}"
            raise InputError("B-SIM-019", message, where="sets of a prompt", next_step=advice)

    @property
    def load(self) -> tuple[float, float]:
        """The unit at its supply: volt from which it draws current, ampere."""
        raise NotImplementedError

    @property
    def rail_V(self) -> float:
        """Voltage at the multimeter's leads on a bench without an auxiliary supply, volt."""
        return 0.0

    def fed_by(self, role: str) -> Unit:
        """Return the unit that a supply feeds."""
        del role
        return self.unit

    def supply(self, voltage_V: float, role: str = "") -> None:
        """Supply the unit of a supply with a voltage from now on, 0 = off."""
        self.supplied_V = voltage_V
        self.fed_by(role).set_power(voltage_V > 0.0, self.clock.now_ns(), voltage_V)

    @classmethod
    def in_slots(cls, slots: Mapping[str, Any], **made: Any) -> World:
        """Return a world with a unit in each slot of the station. Raises: InputError B-SIM-020, it knows one unit."""
        del made
        message = f"this simulated bench has one unit, and the station has {len(slots)} slots"
        raise InputError(
            "B-SIM-020", message, where="slots", next_step="take the slots out, or use the world af_converter"
        )

    def close(self) -> None:
        """Forget the world: its id opens nothing any more and pending events do nothing."""
        self._closed = True
        _worlds.pop(self.id, None)

    # --- time --------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def bus_operation(self, latency_ns: int) -> Iterator[None]:
        """Let the latency of a bus operation pass, then hold the lock. Wall-clock threads wait side by side."""
        if self.clock.virtual:
            with self.lock:
                self.clock.sleep_until_ns(self.clock.now_ns() + latency_ns)
                yield
        else:
            self.clock.sleep_until_ns(self.clock.now_ns() + latency_ns)
            with self.lock:
                yield

    def wait_until_ns(self, t_mono_ns: int) -> None:
        """Let time pass for a caller that waits on the bus."""
        if self.clock.virtual:
            with self.lock:
                self.clock.sleep_until_ns(t_mono_ns)
        else:
            self.clock.sleep_until_ns(t_mono_ns)

    def after(self, seconds: float, event: Callable[[], None]) -> None:
        """Run ``event`` once, that much later, under the lock (a settled output, a trip)."""
        started = threading.Event()

        def fire() -> None:
            started.wait()
            handle.cancel()
            with self.lock:
                if not self._closed:
                    event()

        handle = self.clock.every(max(seconds, 1e-9), fire, observer=False)
        started.set()


def live_world(world_id: str) -> World | None:
    """Return the live world with this id, None if there is none (any more)."""
    return _worlds.get(world_id)


def entry(quantity: str, unit: str, value: Any, conditions: Mapping[str, Any]) -> dict[str, Any]:
    """Return one line of a list of true values, as the contract's ``estimates`` have it."""
    return {"quantity": quantity, "unit": unit, "value": float(value), "conditions": dict(conditions)}
