"""The world of the time-offset bench: EGI, inertial unit and radar of one vehicle, its table, its truth.

EGI, inertial unit and radar on one supply: three serial ports, two clocks, one vehicle.

They start ``BOOT_S`` behind their supply and then send by themselves; counters begin at 0 and clocks at readings of
their own with each switching-on. The radar sends while it is on and the vehicle flies. No port listens to anything.

Echoes are of point targets, range-compressed, stop-and-go: a pulse is sent and received where the antenna stands at
its time (it moves 0.075 m while an echo of 45 km is on its way; both ways of the pulse see the same shift, so that
the image does not). Pulse response: the band-limited sinc(2 B (r - R) / c) of an unweighted bandwidth B, first zero
at c / 2B = 2.998 m; phase -4 pi R / lambda; amplitude the same in each pulse: neither spreading loss, nor antenna
pattern, nor receiver noise.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Floats, Integers
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
from sim_instruments.worlds.time_sync.samples import EGI_PERIOD_S, IMU_PERIOD_S, EgiSamples, ImuSamples
from sim_instruments.worlds.time_sync.stream import (
    TICK_S,
    ByNumber,
    Clocks,
    Drawing,
    Numbered,
    Spell,
    SyncStream,
    UnitClock,
)

Complex = NDArray[np.complex64]

SPEED_OF_LIGHT_m_s = 299_792_458.0
_PULSES_AT_ONCE = 2000  # keeps what is on the way in the processor's cache
PERIOD_S = 0.001
PEAK_COUNTS = 6000  # of one reflector; all three in one gate and the noise still fit
RECEIVER_NOISE = 0.1  # root mean square of a gate in parts of that: 20 dB below
LATENCY_S = 0.0005
_HIGHEST = 2**15 - 1


@dataclass(frozen=True)
class Radar:
    """Radar of the paper's Table 3; carrier, gates and heights are not in the paper and stated here.

    Attributes:
        carrier_Hz, bandwidth_Hz, prf_Hz: of the pulses.   aperture_s: time over which a scene is lit.
        slant_range_m: from the middle of the aperture to the scene's middle, broadside to the right.
        gates: range gates of a pulse.   spacing_m: from gate to gate (60 MHz for 50 MHz of bandwidth).
    """

    carrier_Hz: float = 9.6e9
    bandwidth_Hz: float = 50e6
    prf_Hz: float = 1000.0
    aperture_s: float = 10.0
    slant_range_m: float = 45_000.0
    gates: int = 64
    spacing_m: float = 2.5

    @property
    def wavelength_m(self) -> float:
        """Wavelength of the carrier."""
        return SPEED_OF_LIGHT_m_s / self.carrier_Hz

    @property
    def near_range_m(self) -> float:
        """Slant range of the first gate: the scene's range walks out by 17 m on both sides of the middle."""
        return self.slant_range_m - 0.45 * self.gates * self.spacing_m


def echoes(radar: Radar, positions_m: Floats, targets_m: Floats, amplitudes: Floats) -> Complex:
    """Return range-compressed echoes of point targets at the pulses' true antenna positions.

    Args:    radar.   positions_m: (n, 3) north, east, down at the pulses.   targets_m: (k, 3).   amplitudes: (k,).
    Returns: (n, g), of unit amplitude at the peak of a target of amplitude 1; of a target beyond the gates only the
             tail of its pulse response is left.
    Source:  Carrara, Goodman, Majewski, Spotlight Synthetic Aperture Radar (1995), chapter 2; conventions above.
    """
    positions_m = np.asarray(positions_m, np.float64)
    gates = np.zeros((len(positions_m), radar.gates), np.complex64)
    for begin in range(0, len(positions_m), _PULSES_AT_ONCE):
        some = slice(begin, begin + _PULSES_AT_ONCE)
        for target, amplitude in zip(np.asarray(targets_m, np.float64), np.asarray(amplitudes), strict=True):
            range_m = np.sqrt(np.sum((positions_m[some] - target) ** 2, axis=1))
            gates[some] += amplitude * _pulse(radar, range_m)
    return gates


def scene(radar: Radar, position_m: Floats, velocity_m_s: Floats) -> Floats:
    """Return three reflectors on the ground, right of the place where the flight will be at the middle of the aperture.

    Args:    radar.   position_m, velocity_m_s: (3,) north, east, down at the beginning of the aperture; level flight.
    Returns: (3, 3) north, east, down; the middle one broadside at `radar.slant_range_m`, down = 0; the others 100 m
             before and behind along the track and 12 m nearer and farther.
    """
    velocity = np.asarray(velocity_m_s, np.float64)
    along = np.array([velocity[0], velocity[1], 0.0]) / np.hypot(velocity[0], velocity[1])
    right = np.array([-along[1], along[0], 0.0])
    middle = np.asarray(position_m, np.float64) + velocity * (radar.aperture_s / 2)
    ranges_m = radar.slant_range_m + np.array([0.0, -12.0, 12.0])
    ground = middle * [1.0, 1.0, 0.0] + np.sqrt(ranges_m**2 - middle[2] ** 2)[:, None] * right
    return ground + np.array([0.0, 100.0, -100.0])[:, None] * along


def _pulse(radar: Radar, range_m: Floats) -> Complex:
    """Return echo of one target of amplitude 1 in every gate, (n, g)."""
    gate_m = radar.near_range_m + radar.spacing_m * np.arange(radar.gates)
    shape = np.sinc((gate_m - range_m[:, None]) * (2.0 * radar.bandwidth_Hz / SPEED_OF_LIGHT_m_s))
    turns = np.remainder(-2.0 * range_m / radar.wavelength_m, 1.0)
    return np.asarray(shape * np.exp(2j * np.pi * turns)[:, None], np.complex64)


class RadarPulses:
    """Pulses from one switching-on to the next switching-off.

    Args:
        clock: of the inertial unit, which the radar is wired to.   flight: of the vehicle.
        on_ns: bench time at which the scene is laid.   noise_of: receiver noise by counter, None for none.
    Attributes: targets_m: true places of the reflectors in the tangent plane, (3, 3).
    """

    def __init__(self, clock: UnitClock, flight: Flight, on_ns: int, noise_of: Numbered | None) -> None:
        self._clock, self._flight, self._noise_of = clock, flight, noise_of
        self.radar = Radar()
        flight.upto(on_ns)
        now = flight.path.state(np.array([flight.seconds(on_ns)]))
        self.targets_m = scene(self.radar, now.p[0], now.v[0])

    def columns(self, number: Integers, counter: Integers) -> Mapping[str, Any]:
        """Return fields of pulses in a row, by number and by counter."""
        own_s = number * PERIOD_S
        self._flight.upto(int(self._clock.times_ns(own_s[-1:])[0]))
        flight_s = self._clock.since_on_s(own_s) + self._flight.seconds(self._clock.on_ns)
        gates = echoes(self.radar, self._flight.path.state(flight_s).p, self.targets_m, np.ones(len(self.targets_m)))
        echo = np.stack([gates.real, gates.imag], axis=-1).reshape(number.size, -1)
        if self._noise_of is not None:
            echo = echo + self._noise_of.upto(int(counter[0]), int(counter[-1]) + 1)
        return {
            "tick": np.rint(own_s / TICK_S).astype(np.int64),
            "near_range": self.radar.near_range_m,
            "spacing": self.radar.spacing_m,
            "wavelength": self.radar.wavelength_m,
            "echo": np.rint(PEAK_COUNTS * echo).clip(-_HIGHEST, _HIGHEST).astype(np.int64),
            "status": 0,
        }


def receiver_noise(seed: int, power: int) -> Numbered:
    """Return noise of all pulses of a switching-on of the unit, in parts of the peak of one reflector, (n, 128)."""
    each = RECEIVER_NOISE / np.sqrt(2.0)
    return Numbered(seed, "time sync receiver", power, draw=lambda rng, count: each * rng.standard_normal((count, 128)))


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
