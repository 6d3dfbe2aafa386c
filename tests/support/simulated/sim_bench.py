"""A simulated bench for tests: the ten instruments, a unit that only writes down what its inputs see, one instrument
alone on a bus of texts."""

import importlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pyvisa
from pyvisa.constants import StatusCode
from pyvisa.errors import VisaIOError
from pyvisa.resources import MessageBasedResource
from scripted import Log

from bench.model.clock import NS, Clock, VirtualClock, WallClock
from sim_instruments.served.process import InstrumentServers
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.simulation import open_world

DRIVERS = {
    "calibrator": "fluke_5720a",
    "switch": "keithley_7002",
    "dmm": "hp_3458a",
    "function_generator": "agilent_33250a",
    "counter": "agilent_53230a",
    "chamber": "thermotron_3800",
    "supply": "hp_6632b",
    "aux_supply": "agilent_e3631a",
    "logger": "agilent_34970a",
    "rail_dmm": "agilent_34401a",
}
ADDRESSES = {role: f"GPIB0::{number}::INSTR" for number, role in enumerate(DRIVERS, start=4)}


class PlainTruth:
    """Parameters chosen so that every expected value can be written down."""

    af_clock_error_ppm = 20.0
    kinds = ("gyro",) * 6 + ("accelerometer",) * 4
    half_width_degC = np.full(10, 2.0)
    hysteresis_A = np.full(10, 8e-9)

    def dsf_ppm(self, channel: Any, unit_degC: Any) -> Any:
        return np.array([100.0 * channel + unit_degC, 50.0 * channel])

    def tc_ppm(self, channel: int, polarity: str) -> tuple[float, float]:
        return (1.0 if polarity == "n" else 0.0, 0.02)

    def bias_A(self, channel: Any, unit_degC: Any, t_s: Any, play_offset_degC: Any = 0.0) -> Any:
        return 1e-9 * channel + 0 * unit_degC + 1e-12 * t_s + 2e-9 * play_offset_degC

    def bias_tc_A(self, channel: int, order: int) -> float:
        return 1e-12 * channel / order

    def master_error_ppm(self, unit_degC: Any) -> Any:
        return np.asarray(unit_degC) * 0 + 1.5

    def master_tc_ppm(self, order: int) -> float:
        return 0.0 if order else 1.5


def plain_thermal(degC: Callable[[Any], Any]) -> Any:
    """Temperatures of a unit by a function of time, (n,) to (n,); it has no past and shows no hysteresis."""
    return SimpleNamespace(
        unit_degC=degC, turns_degC=lambda _: (), unit_moment=lambda t_ns: (float(degC(np.array([t_ns]))[0]), 0.0)
    )


class RecordingUnit:
    """Writes down every change of its inputs, with the time."""

    def __init__(self, clock: Clock, seed: int, thermal: Any, options: Mapping[str, str]) -> None:
        self.clock, self.seed, self.thermal, self.options = clock, seed, thermal, dict(options)
        self.truth = PlainTruth()
        self.inputs: dict[int, float | None] = dict.fromkeys(range(1, 11))
        self.history: list[tuple[int, int, float | None]] = []
        self.power: list[tuple[int, bool, float]] = []
        self.fg: list[tuple[int, float]] = []

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        self.inputs[channel] = current_A or None
        self.history.append((t_ns, channel, current_A or None))

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        self.power.append((t_ns, on, voltage_V))

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        self.fg.append((t_ns, frequency_Hz))


class Bench:
    """An open world with one PyVISA resource per role; ``log`` is the transcript of drivers."""

    def __init__(self, world: World, manager: pyvisa.ResourceManager) -> None:
        self.world = world
        self.clock: Any = world.clock
        self.unit: Any = world.unit
        self.manager = manager
        self.log = Log()
        self._resources: dict[str, Any] = {}

    def __getitem__(self, role: str) -> Any:
        if role not in self._resources:
            self._resources[role] = self.manager.open_resource(
                ADDRESSES[role], read_termination="\n", write_termination="\n"
            )
        return self._resources[role]

    def open(self, role: str) -> Any:
        """Another session of an instrument, as drivers want it."""
        return self.manager.open_resource(ADDRESSES[role], resource_pyclass=MessageBasedResource)

    def driver(self, role: str, resource: Any = None, **named: Any) -> Any:
        """The driver of an instrument, not yet identified."""
        made = importlib.import_module(f"instruments.{DRIVERS[role]}").DRIVER
        return made(resource or self.open(role), role=role, clock=self.clock, transcript=self.log, **named)

    def ask(self, role: str, *messages: str) -> str:
        """Send the messages but the last, then query that one."""
        for message in messages[:-1]:
            self[role].write(message)
        return str(self[role].query(messages[-1]))

    def send(self, role: str, *messages: str) -> None:
        """Send messages that have no reply."""
        for message in messages:
            self[role].write(message)


def station(options: Mapping[str, Mapping[str, Any]] | None = None) -> dict[str, Any]:
    """The ten instruments at their addresses; ``options`` by role."""
    entries = {
        role: {"driver": driver, "resource": ADDRESSES[role], "options": dict((options or {}).get(role, {}))}
        for role, driver in DRIVERS.items()
    }
    return {"instruments": entries, "links": {}}


@contextmanager
def open_bench(
    seed: int = 1,
    clock: Clock | None = None,
    options: Mapping[str, str] | None = None,
    instruments: Mapping[str, Mapping[str, Any]] | None = None,
) -> Iterator[Bench]:
    """Open a bench around a ``RecordingUnit`` and close everything afterwards."""
    world = open_world(
        "af_converter",
        clock=clock or VirtualClock(),
        seed=seed,
        station=station(instruments),
        options=options,
        unit_factory=RecordingUnit,
    )
    manager = pyvisa.ResourceManager(world.visa_library)
    try:
        yield Bench(world, manager)
    finally:
        manager.close()
        world.close()


LIMIT_S = 10.0  # far more than anything here takes; a test that fails ends all the same


class Served:
    """A world, its servers and a stock PyVISA manager on pyvisa-py."""

    def __init__(self, clock: Clock, wiring: Any) -> None:
        self.world = open_world("af_converter", clock=clock, seed=5, station=wiring, unit_factory=RecordingUnit)
        self.servers = InstrumentServers(self.world)
        self.visa = pyvisa.ResourceManager("@py")

    def open(self, role: str, timeout_ms: int = 5000) -> Any:
        """A session over HiSLIP."""
        return self._opened(self.servers.resources()[role], timeout_ms)

    def open_socket(self, role: str, timeout_ms: int = 5000) -> Any:
        """A session over the raw socket."""
        return self._opened(self.servers.sockets()[role], timeout_ms)

    def _opened(self, resource: str, timeout_ms: int) -> Any:
        opened = self.visa.open_resource(resource, read_termination="\n", write_termination="\n")
        opened.timeout = timeout_ms
        return opened

    def no_latency(self) -> None:
        """Bus operations take no time: for tests of many of them."""
        for device in self.world.instruments.values():
            device.latency_ns = 0

    def close(self) -> None:
        self.visa.close()
        self.servers.close()
        self.world.close()


@contextmanager
def serve(clock: Clock | None = None, wiring: Any = None) -> Iterator[Served]:
    """The ten instruments, served on the wall clock."""
    served = Served(clock or WallClock(), wiring or station())
    try:
        yield served
    finally:
        served.close()


class Wire:
    """One connection that speaks in headers as IVI-6.1 prints them: "HS", type, control, parameter, length."""

    def __init__(self, port: int) -> None:
        self.sock = socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S)
        self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # keeps the order of the two channels

    def say(self, kind: int, control: int = 0, parameter: int = 0, payload: bytes = b"") -> None:
        self.sock.sendall(b"HS" + struct.pack(">BBIQ", kind, control, parameter, len(payload)) + payload)

    def hear(self) -> tuple[int, int, int, bytes]:
        """Type, control code, parameter and payload of the next message."""
        header = self._exactly(16)
        assert header[:2] == b"HS"
        kind, control, parameter, length = struct.unpack(">BBIQ", header[2:])
        return kind, control, parameter, self._exactly(length)

    def silent(self, seconds: float = 0.1) -> bool:
        """Whether nothing comes for a while."""
        self.sock.settimeout(seconds)
        try:
            return self.sock.recv(1, socket.MSG_PEEK) == b"nothing"
        except TimeoutError:
            return True
        finally:
            self.sock.settimeout(LIMIT_S)

    def ended(self) -> bool:
        """Whether the server has closed the connection."""
        try:
            return self.sock.recv(1) == b""
        except ConnectionResetError:
            return True

    def _exactly(self, count: int) -> bytes:
        received = b""
        while len(received) < count:
            chunk = self.sock.recv(count - len(received))
            assert chunk, "the server has closed the connection"
            received += chunk
        return received


class RawClient:
    """A HiSLIP session of bytes: both channels open."""

    def __init__(self, port: int, name: bytes = b"hislip6") -> None:
        self.sync, self.asynchronous = Wire(port), Wire(port)
        self.sync.say(0, 0, 0x0100_5858, name)
        kind, overlap, parameter, _ = self.sync.hear()
        assert (kind, overlap, parameter >> 16) == (1, 0, 0x0100)
        self.session_id = parameter & 0xFFFF
        self.asynchronous.say(17, 0, self.session_id)
        assert self.asynchronous.hear()[:2] == (18, 0)

    def send(self, text: bytes, message_id: int, delivered: bool = False) -> None:
        self.sync.say(7, int(delivered), message_id, text)

    def status(self, message_id: int = 0, delivered: bool = False) -> int:
        self.asynchronous.say(21, int(delivered), message_id)
        kind, status, _, _ = self.asynchronous.hear()
        assert kind == 22
        return status

    def lock(self, key: bytes = b"", timeout_ms: int = 0) -> int:
        self.asynchronous.say(4, 1, timeout_ms, key)
        return self.locked()

    def locked(self) -> int:
        kind, answer, _, _ = self.asynchronous.hear()
        assert kind == 5
        return answer

    def unlock(self) -> int:
        self.asynchronous.say(4, 0, 0)
        return self.locked()

    def clear(self) -> None:
        self.asynchronous.say(19)
        assert self.asynchronous.hear() == (23, 0, 0, b"")
        self.sync.say(8)
        while (heard := self.sync.hear())[0] != 9:
            assert heard[0] in (6, 7, 13)
        assert heard == (9, 0, 0, b"")

    def close(self) -> None:
        for wire in (self.sync, self.asynchronous):
            wire.sock.close()


def threads() -> set[str]:
    """Names of the threads that serve instruments."""
    return {thread.name for thread in threading.enumerate() if thread.name.startswith(("hislip", "raw socket"))}


def session_count() -> int:
    """How many HiSLIP sessions are served."""
    return sum(thread.name.startswith("hislip session") for thread in threading.enumerate())


def timed_out(call: Callable[[], object]) -> bool:
    """Return whether a call of the bus comes to its time limit."""
    try:
        call()
    except VisaIOError as error:
        return bool(error.error_code == StatusCode.error_timeout)
    return False


def descriptors() -> int:
    """Open descriptors of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


def trip_calibrator(world: World, t_mono_ns: int) -> None:
    """Let whatever instrument can trip (the calibrator) drop to standby at that time."""
    world.after((t_mono_ns - world.clock.now_ns()) / NS, world.wiring.on_lost_path)


ADDRESS = "GPIB0::8::INSTR"


def complaints(simulator: Any) -> bool:
    """Whether the simulated instrument has refused something since it was last asked; forgets it."""
    if hasattr(simulator, "errors"):
        found = bool(simulator.errors)
        simulator.errors.clear()
        return found
    found = bool(getattr(simulator, "_events", 0) & 0x30)
    simulator.__dict__.update({"_events": 0} if hasattr(simulator, "_events") else {})
    return found


def bare_world(entries: Mapping[str, Mapping[str, Any]], seed: int = 1) -> Any:
    """The world of the af-converter with these instruments only, in the state of power-on."""
    station = {"instruments": dict(entries), "links": {}}
    return open_world(
        "af_converter", clock=VirtualClock(), seed=seed, station=station, unit_factory=lambda *_: MagicMock()
    )


@contextmanager
def simulated(name: str) -> Iterator[Any]:
    """A world with this instrument only."""
    world = bare_world({name: {"driver": name, "resource": ADDRESS, "options": {}}})
    try:
        yield world
    finally:
        world.close()


class Alone:
    """Messages to the instrument, replies from it, and whether it complained."""

    def __init__(self, simulator: Any, resource: Any) -> None:
        self._simulator = simulator
        self._resource = resource

    def send(self, message: str) -> None:
        self._resource.clear()
        self._resource.write(message)

    def ask(self, message: str) -> str | None:
        self.send(message)
        try:
            return str(self._resource.read()).strip()
        except VisaIOError:
            return None

    def complains(self) -> bool:
        return complaints(self._simulator)


@contextmanager
def alone(name: str) -> Iterator[Alone]:
    with simulated(name) as world:
        resource = pyvisa.ResourceManager(world.visa_library).open_resource(
            ADDRESS, read_termination="\n", write_termination="\n", timeout=3000
        )
        yield Alone(world.instruments[name], resource)
