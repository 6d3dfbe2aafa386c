"""The simulated unit under test: ten charge-balance AF converters, two oscillators, two serial ports.

Sign convention of the whole unit: K_N C_N - K_P C_P = i_in - i_AFbias, so positive input current makes N pulses and
the reading with an open input is -i_AFbias (AF-converter paper, equation (1)).

The simulated unit in time: it generates ahead, and goes back when something changes earlier than that.

Every state of the unit is a value that can be put back, noise is a function of the seed and the gate number, and all
counting is in integers. So the bytes do not depend on when somebody reads or on how far the unit has worked ahead.
Commands come on port B, by number; bytes with a wrong check are passed over, as the unit does.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from enum import IntEnum

from bench.frame import FrameDefinition, load_frame
from bench.model.arrays import Integers
from bench.model.clock import NS, Clock, VirtualClock
from bench.model.lab import find_shipped
from sim_instruments.worlds.af_converter.block import BlockFactory
from sim_instruments.worlds.af_converter.gates import Drive, GateMachine, GateRows, GateState
from sim_instruments.worlds.af_converter.ports import GATES_PER_FRAME, Framer, FramerState, Housekeeping, Mode
from sim_instruments.worlds.af_converter.unit_constants import NguTruth
from sim_instruments.worlds.common.port import Port, PortedUnit
from sim_instruments.worlds.common.thermal import ThermalOfUnit

BOOT_NS = NS  # from power on to the start of the first gate
AHEAD_NS = 100 * NS  # generated at once at most
IDENTITY = b"NGU SIM-1 1.0"  # model, serial number, firmware; of a unit that is given no serial number


@dataclass(frozen=True)
class _Change:
    t_ns: int
    apply: Callable[[int], None]


@dataclass(frozen=True)
class _Situation:
    """The state of everything at ``t_ns``."""

    t_ns: int
    applied: int
    drive: Drive
    machine: GateMachine | None
    gates: GateState | None
    period: int
    supply_V: float
    framer: FramerState
    zero_frame: int
    produced: dict[str, int]


class UnitCore:
    """Generates the frames of both ports in order of time.

    Args: sensed: what its sensors have of the temperature, where that is another one.   serial: its serial number.
    Attributes:
        generated_ns: bench time up to which all frames are made.
        given_ns: bench time up to which somebody may have seen them; nothing changes before it any more.
    """

    def __init__(
        self, truth: NguTruth, thermal: ThermalOfUnit, ports: Mapping[str, Port], start_ns: int,
        sensed: ThermalOfUnit | None = None, serial: str = "",
    ) -> None:  # fmt: skip
        gates, integrated = (load_frame(find_shipped("frames", name)) for name in ("ngu_a", "ngu_a_100s"))
        self.definition_b = load_frame(find_shipped("frames", "ngu_b"))
        self._truth = truth
        self._thermal = thermal
        self._ports = ports
        self._framer = Framer(ports["port_a"], gates, integrated)
        self._identity = f"NGU {serial} 1.0".encode() if serial else b""
        self._housekeeping = Housekeeping(
            ports["port_b"], self.definition_b, sensed or thermal, truth.seed, noise=truth.noise
        )
        self._drive = Drive()
        self._machine: GateMachine | None = None
        self._period = 0
        self._supply_V = 0.0
        self._rows: list[GateRows] = []
        self._changes: list[_Change] = []  # those that may still be applied, again or for the first time
        self._forgotten = 0  # changes before them
        self._applied = 0  # of all
        self._situations: list[_Situation] = []
        self.generated_ns = start_ns
        self.given_ns = start_ns

    # --- changes -----------------------------------------------------------------------------------------------

    def at(self, t_ns: int, apply: Callable[[int], None]) -> None:
        """Let ``apply(t)`` change the unit at ``t_ns``, or at ``given_ns`` if that is later."""
        t_ns = max(t_ns, self.given_ns)
        if t_ns < self.generated_ns:
            self._take_back(t_ns)
        bisect.insort(self._changes, _Change(t_ns, apply), key=lambda change: change.t_ns)

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        """Current of one channel; to be called through ``at``."""
        if self._drive.input_A[channel - 1] != current_A:
            input_A = self._drive.input_A.copy()
            input_A[channel - 1] = current_A
            self._drive_with(replace(self._drive, input_A=input_A), t_ns)

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        """Reference input; to be called through ``at``."""
        self._drive_with(self._drive.with_fg(frequency_Hz, t_ns), t_ns)

    def set_power(self, voltage_V: float, t_ns: int) -> None:
        """Supply, 0 = off; to be called through ``at``."""
        self._flush()
        self._supply_V = voltage_V
        if voltage_V == 0.0:
            self._machine = None
        elif self._machine is None:
            factory = BlockFactory(self._truth, self._thermal, t_ns + BOOT_NS, self._period)
            self._machine = GateMachine(factory, self._drive)
            self._period += 1
            self._framer.state = FramerState()
            self._housekeeping.zero_frame = 0

    def execute(self, request: Request, t_ns: int) -> None:
        """Do a command and answer it; to be called through ``at``. Without supply nothing happens."""
        if self._machine is None:
            return
        self._flush()
        verdict, payload = request.verdict(), b""
        if verdict is Status.DONE:
            payload = self._execute(request, self._machine.state.gate)
        self._housekeeping.answer(t_ns, request.command, verdict, payload)

    def _execute(self, request: Request, gate: int) -> bytes:
        if request.command == Command.IDENTIFY:
            return self._identity or IDENTITY
        if request.command == Command.START_STREAM:
            self._framer.start(START_MODES[request.payload])
        elif request.command == Command.STOP_STREAM:
            self._framer.start(Mode.OFF)
        else:
            self._framer.zero_counter(gate)
            self._housekeeping.zero_frame = gate // GATES_PER_FRAME
        return b""

    def _drive_with(self, drive: Drive, t_ns: int) -> None:
        self._drive = drive
        if self._machine is not None:
            self._machine.change(drive, t_ns)

    # --- time --------------------------------------------------------------------------------------------------

    def generate(self, to_ns: int) -> None:
        """Make all frames that are complete at ``to_ns``."""
        while self.generated_ns < to_ns:
            self._remember()
            stop_ns = min(to_ns, self.generated_ns + AHEAD_NS)
            self._run(stop_ns)
            self.generated_ns = stop_ns

    def _run(self, stop_ns: int) -> None:
        while True:
            place = self._applied - self._forgotten
            change = self._changes[place] if place < len(self._changes) else None
            limit_ns = stop_ns if change is None else min(stop_ns, change.t_ns)
            if self._machine is not None:
                self._rows += self._machine.run(limit_ns)
            if change is None or change.t_ns > stop_ns:
                break
            self._applied += 1
            change.apply(change.t_ns)
        self._flush()

    def _flush(self) -> None:
        """Send finished gates on both ports, under the mode and supply of now."""
        rows, self._rows = self._rows, []
        if rows:
            self._framer.send(rows)
            self._housekeeping.send(rows, self._period, self._supply_V, self._framer.state.mode)

    # --- going back --------------------------------------------------------------------------------------------

    def _remember(self) -> None:
        useful = [place for place, past in enumerate(self._situations) if past.t_ns <= self.given_ns]
        del self._situations[: useful[-1] if useful else 0]
        if self._situations:
            old = self._situations[0].applied - self._forgotten
            del self._changes[:old]
            self._forgotten += old
        self._situations.append(
            _Situation(
                t_ns=self.generated_ns,
                applied=self._applied,
                drive=self._drive,
                machine=self._machine,
                gates=None if self._machine is None else copy(self._machine.state),
                period=self._period,
                supply_V=self._supply_V,
                framer=self._framer.state,
                zero_frame=self._housekeeping.zero_frame,
                produced={name: port.produced for name, port in self._ports.items()},
            )
        )

    def _take_back(self, t_ns: int) -> None:
        """Put back the last situation at or before ``t_ns``; frames made up to ``t_ns`` stay as they are."""
        while self._situations[-1].t_ns > t_ns:
            self._situations.pop()
        past = self._situations.pop()
        self._applied, self._drive, self._machine = past.applied, past.drive, past.machine
        if past.machine is not None and past.gates is not None:
            past.machine.state = past.gates
        self._period, self._supply_V = past.period, past.supply_V
        self._framer.state, self._housekeeping.zero_frame = past.framer, past.zero_frame
        self.generated_ns = past.t_ns
        for name, port in self._ports.items():
            port.take_back(t_ns, past.produced[name])


class Command(IntEnum):
    """Command numbers of the unit."""

    IDENTIFY = 1  # answer: model, serial number, firmware
    START_STREAM = 2  # payload: one byte of START_MODES, none means 100 Hz
    STOP_STREAM = 3
    ZERO_COUNTERS = 4  # frame counters of both ports start again at 0


class Status(IntEnum):
    """Status byte of an answer."""

    DONE = 0
    UNKNOWN_COMMAND = 1
    BAD_PAYLOAD = 2


START_MODES = {b"": Mode.GATES, b"\x64": Mode.GATES, b"\x00": Mode.INTEGRATED}


@dataclass(frozen=True)
class Request:
    """A command as it came: its number, which may be unknown, and its payload."""

    command: int
    payload: bytes

    def verdict(self) -> Status:
        """Return whether the unit can do it."""
        if self.command not in tuple(Command):
            return Status.UNKNOWN_COMMAND
        allowed = START_MODES if self.command == Command.START_STREAM else (b"",)
        return Status.DONE if self.payload in allowed else Status.BAD_PAYLOAD


class CommandReader:
    """Finds commands in the bytes sent to the unit; bytes with a wrong check are passed over, as the unit does."""

    def __init__(self, definition: FrameDefinition) -> None:
        self._decoder = definition.decoder("reference")

    def feed(self, sent: bytes) -> list[Request]:
        """Return commands completed by these bytes, in order."""
        commands = self._decoder.feed(sent).messages.get("command")
        if commands is None:
            return []
        numbers, payloads = commands.raw("command"), commands.raw("payload")
        return [Request(int(number), bytes(payload)) for number, payload in zip(numbers, payloads, strict=True)]


ANSWER_NS = 2_000_000  # from a command to its answer
NOMINAL_SUPPLY_V = 28.0


class Ngu(PortedUnit):
    """One simulated unit with the ports "port_a" (measurement) and "port_b" (housekeeping, commands, answers).

    Args:
        clock: clock of the run; with a virtual one the unit works ahead while nothing can change it.
        seed: seed of the unit's truth and of all its noise.
        thermal: temperature of the unit and where it has turned, at bench times in nanoseconds.
        options: see NguTruth.
        sensed: temperature at its sensors, where that is another one.   serial: serial number that it answers.
    Raises:
        InputError: B-NGU-001, an option cannot be read.
    """

    def __init__(
        self, clock: Clock, seed: int, thermal: ThermalOfUnit, options: Mapping[str, str] | None = None,
        *, sensed: ThermalOfUnit | None = None, serial: str = "",
    ) -> None:  # fmt: skip
        self.truth = NguTruth(seed, options)
        super().__init__({"port_a": Port(), "port_b": Port()})
        self._clock = clock
        self._core = UnitCore(self.truth, thermal, self._ports, clock.now_ns(), sensed, serial)
        self._commands = CommandReader(self._core.definition_b)

    # --- the bench ---------------------------------------------------------------------------------------------

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        """Current into a channel (from 1) from ``t_ns`` on, ampere; positive makes N pulses."""
        with self.lock:
            self._core.at(t_ns, lambda t: self._core.set_input(channel, current_A, t))

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        """True frequency at the reference input from ``t_ns`` on, hertz; 0 without a signal."""
        with self.lock:
            self._core.at(t_ns, lambda t: self._core.set_fg(frequency_Hz, t))

    def set_power(self, on: bool, t_ns: int, voltage_V: float = NOMINAL_SUPPLY_V) -> None:
        """Supply on or off from ``t_ns`` on; switched on, the unit boots for a second and then streams 100 Hz."""
        with self.lock:
            self._core.at(t_ns, lambda t: self._core.set_power(voltage_V if on else 0.0, t))

    # --- the ports ---------------------------------------------------------------------------------------------

    def disconnect(self, name: str) -> None:
        """Stop listening to a port."""
        with self.lock:
            self._ports[name].disconnect()

    def _foreseen(self, name: str, t_ns: Integers) -> Integers:
        """As far as the unit has worked ahead."""
        del name
        self._upto_now()
        return t_ns[t_ns <= self._core.generated_ns]

    def write(self, name: str, sent: bytes) -> None:
        """Send bytes to the unit; only port B listens, and it answers each sound command 2 ms later."""
        with self.lock:
            now_ns = self._upto_now()
            for request in self._commands.feed(sent) if name == "port_b" else ():
                self._answer(request, now_ns + ANSWER_NS)

    def _answer(self, request: Request, t_ns: int) -> None:
        self._core.at(t_ns, lambda t: self._core.execute(request, t))

    def _upto_now(self) -> int:
        """Generate what has arrived by now, and ahead while nobody can change anything; returns now."""
        now_ns = self._clock.now_ns()
        core = self._core
        if core.generated_ns < now_ns:
            quiet_ns = self._clock.quiet_until_ns() if isinstance(self._clock, VirtualClock) else now_ns
            core.generate(max(now_ns, min(quiet_ns, core.generated_ns + AHEAD_NS)))
        if core.given_ns < now_ns:
            core.given_ns = now_ns
            for port in self._ports.values():
                if not port.listened:
                    port.discard(now_ns)
        return now_ns
