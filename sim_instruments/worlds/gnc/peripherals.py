"""Surroundings of the simulated GNC module's processor: supply, AD channels, satellite receiver, IO, SPI, SCI, CAN.

Paper 001, section 3 (2): three AD channels see the magnetometer's outputs; five are led out, on the test board to
5 V, 3.3 V, 1.2 V, GND and to nothing, each through a DIP switch; with its switch off a channel is pulled down. The four
IO lines are nets of pins: a driver that pulls low wins (so a short is an AND), and a line that nobody drives is pulled
down. SPI's CS, CLK, SDIN and SDOUT run over the same four lines, so what is wrong with a line is wrong there.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats
from sim_instruments.worlds.gnc.processor import ModuleDraws

CHANNELS = 8
VOLT_PER_GAUSS, MAGNETOMETER_ZERO_V = 0.2, 2.5
LSB_V, HIGHEST_V, NOISE_V = 5.5 / 4096, 5.5, 1e-3
NOMINAL_CURRENT_A, CURRENT_SIGMA_A = 0.49, 0.005  # 5 % are 0.0245 A
SHORT_CURRENT_A = 20.0
CONTACT_OHM = 0.9
METRE_DEG = 1.0 / 111_195.0  # of latitude
GIVE_UP_S = 1.8  # the processor waits no longer for a fix
LINES = (1, 2, 3, 4)
CS, CLK, SDIN, SDOUT = LINES
SPI_BITS = 16


class Power:
    """Current that the module draws from 5 V and what its regulators make of it."""

    def __init__(self, draws: ModuleDraws, faults: Set[str]) -> None:
        self._faults = faults
        rng = draws.generator("supply")
        self._current_A = NOMINAL_CURRENT_A + float(np.clip(rng.normal(0.0, CURRENT_SIGMA_A), -0.015, 0.015))
        self._rails_V = (rng.normal(3.3, 0.01), rng.normal(1.2, 0.004))

    @property
    def current_A(self) -> float:
        """Current while the module runs, ampere."""
        if "supply_short" in self._faults:
            return SHORT_CURRENT_A
        more_A = 0.05 if "current_high" in self._faults else 0.0
        return self._current_A + more_A - (0.05 if "current_low" in self._faults else 0.0)

    def board_V(self, supply_V: float) -> float:
        """Return voltage at the test board, where it is measured, behind the contacts of the supply."""
        return supply_V - (CONTACT_OHM * self.current_A if "contact_resistance" in self._faults else 0.0)

    @property
    def rails_V(self) -> tuple[float, float]:
        """The 3.3 V and the 1.2 V of the module, volt."""
        high_V = 2.9 if "rail_3v3_low" in self._faults else self._rails_V[0]
        return high_V, 1.4 if "rail_1v2_high" in self._faults else self._rails_V[1]


class Converter:
    """The AD converter: gain and offset drawn once, twelve bits of 5.5 V, noise of each reading."""

    def __init__(self, draws: ModuleDraws, faults: Set[str]) -> None:
        self._draws, self._faults = draws, faults
        rng = draws.generator("AD errors")
        self._gain, self._offset_V = rng.normal(1.0, 1e-3), rng.normal(0.0, 2e-3)
        self._readings = 0

    def read_V(self, sources_V: Floats, switch: int, field_gauss: Floats) -> Floats:
        """Return the eight channels, (8,), volt.

        Args: sources_V: what channels 4 to 7 are connected to, (4,).   switch: DIP switch that is on, 0 for none.
            field_gauss: what the magnetometer gives, (3,).
        """
        self._readings += 1
        rng = self._draws.generator("AD noise", self._readings)
        true_V = np.zeros(CHANNELS)
        true_V[:3] = MAGNETOMETER_ZERO_V + VOLT_PER_GAUSS * field_gauss
        if "magnetometer_output_dead" in self._faults:
            true_V[1] = 0.0
        leads_V = [*sources_V, rng.uniform(0.2, 2.6)]  # a floating input is anywhere
        if "ad_ground_lifted" in self._faults:
            leads_V[3] += 0.6
        if switch:
            true_V[2 + switch] = leads_V[switch - 1]
        if "ad_channel_open" in self._faults:
            true_V[3] = 0.0
        gain = self._gain * (1.0 / 0.88 if "ad_reference" in self._faults else 1.0)
        offset_V = self._offset_V + (0.25 if "ad_offset" in self._faults else 0.0)
        seen_V = np.clip(true_V * gain + offset_V + rng.normal(0.0, NOISE_V, CHANNELS), 0.0, HIGHEST_V)
        return np.rint(seen_V / LSB_V) * LSB_V


@dataclass(frozen=True)
class Fix:
    """Answer of the satellite receiver; ``fix`` 0 none, 2 without height, 3 with it."""

    fix: int
    satellites: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    time_to_fix_s: float


class Receiver:
    """The satellite receiver in a hot start: almanac, ephemeris, time and place are known."""

    def __init__(self, draws: ModuleDraws, faults: Set[str], place: tuple[float, float, float]) -> None:
        self._draws, self._faults = draws, faults
        self._place = place  # latitude and longitude in degrees, height in metres
        self._starts = 0

    @property
    def alive(self) -> bool:
        """Whether it answers the processor."""
        return "gps_silent" not in self._faults

    def hot_start(self) -> Fix:
        """Return the fix of the next start; 1.3 to 1.7 s from the command, 1.5 m of noise across and 2.5 m upwards."""
        self._starts += 1
        rng = self._draws.generator("hot start", self._starts)
        north_m, east_m = rng.normal(0.0, 1.5, 2)
        height_m, time_s, satellites = rng.normal(0.0, 2.5), rng.uniform(1.3, 1.7), int(rng.integers(8, 13))
        if not self.alive or "gps_no_satellites" in self._faults:
            return Fix(0, 0, 0.0, 0.0, 0.0, GIVE_UP_S)
        latitude_deg = self._place[0] + north_m * METRE_DEG
        longitude_deg = self._place[1] + east_m * METRE_DEG / float(np.cos(np.deg2rad(self._place[0])))
        if "gps_far" in self._faults:
            latitude_deg += 1.0
        if "gps_few_satellites" in self._faults:
            return Fix(2, 3, latitude_deg, longitude_deg, 0.0, time_s)
        return Fix(3, satellites, latitude_deg, longitude_deg, self._place[2] + height_m, time_s)


@dataclass(frozen=True)
class Wires:
    """The lines of the module as they really go, by its faults."""

    faults: Set[str]

    def pin(self, line: int) -> int | None:
        """Return pin of the socket at which a line of the module arrives; None: at none."""
        if "io_open" in self.faults and line == 4:
            return None
        if "io_swapped" in self.faults and line in (3, 4):
            return 7 - line
        return line

    def pins(
        self, driven: Mapping[int, int], outside: Mapping[int, int], joined: Set[int] = frozenset()
    ) -> dict[int, int]:
        """Return level at each pin of the socket.

        Args: driven: level by line of the module.   outside: level by pin, driven from elsewhere.
            joined: pins the board connects with each other.
        """
        nets = self._nets(joined)
        drivers: dict[int, list[int]] = {number: [] for number in nets.values()}
        for line, level in driven.items():
            if (pin := self.pin(line)) is not None:
                drivers[nets[pin]].append(level)
        for pin, level in outside.items():
            drivers[nets[pin]].append(level)
        if "io_stuck_low" in self.faults:
            drivers[nets[2]].append(0)
        return {pin: min(drivers[number], default=0) for pin, number in nets.items()}

    def read(self, pins: Mapping[int, int]) -> list[int]:
        """Return what the module reads on its lines 1 to 4; one that reaches no pin is pulled down inside."""
        places = (self.pin(line) for line in LINES)
        return [0 if pin is None else pins[pin] for pin in places]

    def _nets(self, joined: Set[int]) -> dict[int, int]:
        """Return number of the net of each pin."""
        nets = {pin: pin for pin in LINES}
        groups = [set(joined)] + ([{2, 3}] if "io_short" in self.faults else [])
        for group in groups:
            numbers = {nets[pin] for pin in group}
            for pin, number in nets.items():
                if number in numbers:
                    nets[pin] = min(numbers)
        return nets


def io_test(faults: Set[str], output: int, source: int, level: int) -> tuple[int, int]:
    """Return level read at line ``source`` while line ``output`` is driven, and the bits of the two other lines.

    The board joins the two pins; the other lines are driven low.
    """
    wires = Wires(faults)
    driven = {line: 0 for line in LINES if line not in (output, source)} | {output: level}
    read = wires.read(wires.pins(driven, {}, frozenset((output, source))))
    others = sum(bit << (line - 1) for line, bit in zip(LINES, read, strict=True) if line not in (output, source))
    return read[source - 1], others


def spi_test(faults: Set[str], word: int) -> tuple[int, int]:
    """Return a word sent by the SPI and seen by the IO lines, then sent back by them: what came back, what was seen.

    The SPI has its own way to the socket's pins 1 to 4, where the IO lines of the module end.
    """
    wires = Wires(faults)
    clocks = SPI_BITS - 1 if "spi_lost_clock" in faults else SPI_BITS
    observed = 0
    for bit in _bits(word)[:clocks]:
        low, high = (wires.read(wires.pins({SDIN: 0}, {CS: 0, CLK: clock, SDOUT: bit})) for clock in (0, 1))
        if high[CS - 1] == 0 and (low[CLK - 1], high[CLK - 1]) == (0, 1):  # an edge of the clock while selected
            observed = observed << 1 | high[SDOUT - 1]
    received = 0
    for bit in _bits(observed):
        received = received << 1 | wires.pins({SDIN: bit}, {CS: 0, CLK: 1, SDOUT: 0})[SDIN]
    if "spi_receive_bit" in faults:
        received &= ~(1 << 5)
    return received, observed


def _bits(word: int) -> list[int]:
    return [word >> place & 1 for place in reversed(range(SPI_BITS))]


def sci_test(faults: Set[str], pattern: bytes) -> bytes:
    """Return what comes back over the asynchronous interface."""
    if "sci_silent" in faults:
        return b""
    if "sci_bit_errors" not in faults:
        return pattern
    return bytes(byte ^ (0x08 if place % 4 == 0 else 0) for place, byte in enumerate(pattern))


def can_test(faults: Set[str], identifier: int, pattern: bytes) -> tuple[int, bytes] | None:
    """Return identifier and bytes that come back over the CAN bus; None: bus off."""
    if "can_bus_off" in faults:
        return None
    return (identifier ^ 0b100 if "can_identifier" in faults else identifier), pattern
