"""The world of the time-offset bench: EGI, inertial unit and radar of one vehicle, its table, its truth.

EGI, inertial unit and radar on one supply: three serial ports, two clocks, one vehicle.

They start ``BOOT_S`` behind their supply and then send by themselves; counters begin at 0 and clocks at readings of
their own with each switching-on. The radar sends while it is on and the vehicle flies. No port listens to anything.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np

from bench.model.arrays import Integers
from bench.model.clock import Clock, VirtualClock, to_ns
from bench.model.ports import RecordWindow
from bench.model.units import parse_quantity
from sim_instruments.faults.switchboard import LinkFaults
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.port import PortedUnit
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import Operation, World, entry
from sim_instruments.worlds.time_sync.flight.flights import Flight, Flights, TableAxis
from sim_instruments.worlds.time_sync.flight.path import STANDARD_GRAVITY_M_S2
from sim_instruments.worlds.time_sync.options import SyncOptions
from sim_instruments.worlds.time_sync.radar import LATENCY_S, PERIOD_S, RadarPulses, receiver_noise
from sim_instruments.worlds.time_sync.samples import EGI_PERIOD_S, IMU_PERIOD_S, EgiSamples, ImuSamples
from sim_instruments.worlds.time_sync.stream import ByNumber, Clocks, Drawing, Numbered, Spell, SyncStream

Columns = Callable[[Integers, Integers], Mapping[str, Any]]

EGI, IMU, RADAR = PORTS = ("egi", "imu", "radar")
FRAMES = {EGI: "egi_50", IMU: "imu_200", RADAR: "sar_pulse"}
BOOT_S = 3.0


class SyncUnit(PortedUnit):
    """Unit under test of the world ``time_sync``.

    Args: clock: of the bench.   seed: of all draws.   options: of the bench.   flights: of the vehicle.
    Attributes: lock: held while the past is read, and by whoever moves the table (the world's own).
        powers: clocks of every switching-on so far.   solutions: errors of the EGI of every one.
        pulses: every switching-on of the radar.
    """

    def __init__(self, clock: Clock, seed: int, options: SyncOptions, flights: Flights) -> None:
        self.powers: list[Clocks] = []
        self.solutions: list[EgiSamples] = []
        self.pulses: list[RadarPulses] = []
        self._clock, self._seed, self._options, self._flights = clock, seed, options, flights
        self._streams = {name: SyncStream(frame) for name, frame in FRAMES.items()}
        super().__init__({name: stream.port for name, stream in self._streams.items()})
        self._supplied = self._radiates = False

    # --- the bench ---------------------------------------------------------------------------------------------

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        """Supply on or off; a voltage that changes while it is on changes nothing."""
        with self.lock:
            self._upto_now()
            if on == self._supplied:
                return
            if on and voltage_V > 0.0:
                self._supplied = True
                self._start(t_ns)
            elif not on:
                self._supplied = self._radiates = False
                for stream in self._streams.values():
                    stream.drop()

    def begin_flight(self, speed_m_s: float) -> None:
        """The vehicle flies anew; the radar is off."""
        with self.lock:
            now_ns = self._upto_now()
            self.set_radar(False)
            self._flights.begin(speed_m_s, now_ns)

    def accelerate(self, acceleration_m_s2: float) -> None:
        """Another acceleration along track from now on."""
        with self.lock:
            self._flights.newest.accelerate(acceleration_m_s2, self._upto_now())

    def set_radar(self, on: bool) -> None:
        """Radar on, if the vehicle flies, or off."""
        with self.lock:
            now_ns = self._upto_now()
            if on == self._radiates:
                return
            stream, flight = self._streams[RADAR], self._flights.newest
            stream.end(now_ns)
            self._radiates = on and self._supplied and flight.speed_m_s > 0.0
            if self._radiates:
                noise = receiver_noise(self._seed, len(self.powers)) if self._options.noise else None
                pulses = RadarPulses(self.powers[-1].imu, flight, now_ns, noise)
                self.pulses.append(pulses)
                self._send(RADAR, PERIOD_S, now_ns, pulses.columns)

    def connect(self, name: str, baud: int, faults: LinkFaults | None = None) -> None:
        """Listen to a port from now on, but not to what was sent while nobody did."""
        with self.lock:
            if not self._ports[name].listened:
                self._ports[name].discard(self._upto_now())
            super().connect(name, baud, faults)

    # --- time --------------------------------------------------------------------------------------------------

    def _upto_port(self, name: str) -> int:
        """Send what is due at one port, and with it what nobody can change any more; returns the time of now."""
        now_ns = self._clock.now_ns()
        stream = self._streams[name]
        if stream.due_ns <= now_ns:
            quiet_ns = self._clock.quiet_until_ns() if isinstance(self._clock, VirtualClock) else now_ns
            stream.send(now_ns, max(now_ns, quiet_ns))
        return now_ns

    def _foreseen(self, name: str, t_ns: Integers) -> Integers:
        self._upto_port(name)
        last_ns = int(t_ns[-1])
        self._streams[name].send(last_ns, last_ns)
        return t_ns

    def _upto_now(self) -> int:
        """Something is about to change: send what is due at every port, nothing else; returns the time of now."""
        now_ns = self._clock.now_ns()
        for stream in self._streams.values():
            stream.send(now_ns, now_ns)
        return now_ns

    def _start(self, t_ns: int) -> None:
        """Both units begin, each at the first multiple of its period behind ``BOOT_S``."""
        power, options = len(self.powers), self._options
        clocks = Clocks.started(options, self._seed, power, t_ns)
        self.powers.append(clocks)
        imu = ImuSamples(clocks.imu, self._flights, options.noise, self._tag_noise(IMU))
        egi = EgiSamples(clocks.egi, self._flights, options.noise, self._tag_noise(EGI), self._seed, power)
        self.solutions.append(egi)
        self._send(IMU, IMU_PERIOD_S, t_ns + to_ns(BOOT_S), imu.columns)
        self._send(EGI, EGI_PERIOD_S, t_ns + to_ns(BOOT_S), egi.columns)

    def _send(self, name: str, period_s: float, from_ns: int, columns: Columns) -> None:
        clocks = self.powers[-1]
        clock = clocks.egi if name == EGI else clocks.imu
        first = math.ceil(clock.reading_s(from_ns) / period_s)
        stream = self._streams[name]
        stream.begin(Spell(clock, period_s, first, stream.counted, self._late(name), columns))

    def _late(self, name: str) -> ByNumber:
        """From validity to frame, by counter: the latency of a port and its jitter."""
        latency_s = {EGI: self._options.egi_latency_s, IMU: self._options.imu_latency_s}.get(name, LATENCY_S)
        jitter = self._numbered(f"time sync {name} jitter", lambda rng, count: rng.standard_exponential(count))
        return lambda first, stop: latency_s + self._options.jitter_s * jitter.upto(first, stop)

    def _tag_noise(self, name: str) -> ByNumber:
        noise = self._numbered(f"time sync {name} tags", lambda rng, count: rng.standard_normal(count))
        return lambda first, stop: self._options.tag_noise_s * noise.upto(first, stop)

    def _numbered(self, purpose: str, draw: Drawing) -> Numbered:
        return Numbered(self._seed, purpose, len(self.powers), draw=draw)


ITEM = "time_sync"  # condition of the records that count
S_PER_H = 3600.0
START_V, CURRENT_A = 14.0, 1.6
MOST_SPEED_M_S, MOST_ACCELERATION_M_S2 = 400.0, 50.0


def estimates(
    powers: Sequence[Clocks], flights: Flights, noise: bool, windows: Sequence[RecordWindow]
) -> list[dict[str, Any]]:
    """Return true values as in the contract: offset of the clocks at the middle of the records, its drift, IMU biases.

    The time offset is the EGI's clock minus the IMU's at the same moment; biases are what the sensors indicate minus
    what they feel, about the body's axes. The middle is that between the beginning of the first record and the end of
    the last one.
    """
    own = [window for window in windows if window.conditions.get("item") == ITEM]
    if not own:
        return []
    begin_ns, end_ns = own[0].t_start_ns, own[-1].t_end_ns
    clocks = next((pair for pair in reversed(powers) if pair.imu.on_ns <= begin_ns), None)
    if clocks is None:
        return []
    about = {"manoeuvre": own[0].conditions["manoeuvre"]} if "manoeuvre" in own[0].conditions else {}
    entries = [
        entry("time_offset", "s", clocks.offset_s((begin_ns + end_ns) // 2), {**about, "at": "middle"}),
        entry("time_offset", "s", clocks.offset_s(begin_ns), {**about, "at": "begin"}),
        entry("time_offset", "s", clocks.offset_s(end_ns), {**about, "at": "end"}),
        entry("time_offset_drift", "ppm", clocks.drift_ppm, about),
    ]
    return entries + (_biases(flights.at(begin_ns), about) if noise else [])


def _biases(flight: Flight, about: dict[str, Any]) -> list[dict[str, Any]]:
    accel_ug = 1e6 * flight.imu.accel_bias / STANDARD_GRAVITY_M_S2
    gyro_deg_h = np.degrees(flight.imu.gyro_bias) * S_PER_H
    rows = [
        entry("accel_bias", "ug", value, {**about, "kind": "accelerometer", "axis": axis})
        for axis, value in zip("xyz", accel_ug, strict=True)
    ]
    return rows + [
        entry("gyro_bias", "deg/h", value, {**about, "kind": "gyro", "axis": axis})
        for axis, value in zip("xyz", gyro_deg_h, strict=True)
    ]


def _number(unit: str, value: Any) -> float:
    """Return a number of that unit, or a quantity as text; nan if it is neither."""
    with contextlib.suppress(TypeError, ValueError):
        return float(value)
    with contextlib.suppress(ValueError):
        return parse_quantity(value, unit)
    return math.nan


class SyncWorld(World):
    """One simulated bench of an EGI and an inertial unit whose clocks disagree.

    Args: clock, seed: as of every world.   options: checked ones of ``sync_options``; the others are as by default.
    Attributes: motion: of the table's axes; the first one, right-handed about up, turns the vehicle.
        flights: all flights so far; for tests, which know the truth.
    """

    ports = PORTS
    load = START_V, CURRENT_A

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        table = TableAxis()
        self.motion: tuple[AxisMotion, ...] = (table, AxisMotion(), AxisMotion())
        self.sync_options = SyncOptions(**options)
        self.flights = Flights(seed, clock.now_ns(), table)
        self.units = SyncUnit(clock, seed, self.sync_options, self.flights)
        super().__init__(clock=clock, seed=seed, unit=self.units, thermal=Thermal(), options=options)
        self.units.lock = self.lock

    @property
    def flight(self) -> Flight:
        """The flight of now: path, draws and beginning; for tests, which know the truth."""
        return self.flights.newest

    operations: ClassVar[Mapping[str, Operation]] = {
        "speed": Operation.number(
            lambda world, speed_m_s: world.units.begin_flight(speed_m_s), 0.0, MOST_SPEED_M_S, "m/s",
            partial(_number, "m/s")),
        "acceleration": Operation.number(
            lambda world, m_s2: world.units.accelerate(m_s2), -MOST_ACCELERATION_M_S2, MOST_ACCELERATION_M_S2, "m/s2",
            partial(_number, "m/s2")),
        "radar": Operation.word(lambda world, word: world.units.set_radar(word == "on"), "on", "off", due="on or off"),
    }  # fmt: skip

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        return estimates(self.units.powers, self.flights, self.sync_options.noise, windows)


WORLD = SyncWorld
