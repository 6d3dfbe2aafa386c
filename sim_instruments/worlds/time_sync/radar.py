"""The radar at the antenna: echoes of point targets, range-compressed, as frames ``sar_pulse``.

Stop-and-go: a pulse is sent and received where the antenna stands at the pulse's time (the antenna moves 0.075 m
while an echo of 45 km is on its way; both ways of the pulse see the same shift, so that the image does not). Pulse
response: the band-limited sinc(2 B (r - R) / c) of an unweighted bandwidth B, first zero at c / 2B = 2.998 m; phase
-4 pi R / lambda; amplitude the same in each pulse: neither spreading loss, nor antenna pattern, nor receiver noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Floats, Integers
from sim_instruments.worlds.time_sync.flight.flights import Flight
from sim_instruments.worlds.time_sync.stream import TICK_S, Numbered, UnitClock

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
