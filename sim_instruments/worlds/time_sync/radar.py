"""The radar at the antenna: echoes of three reflectors on the ground, as frames ``sar_pulse``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_instruments.worlds.time_sync.clocks import TICK_S, UnitClock
from sim_instruments.worlds.time_sync.flight.flights import Flight
from sim_instruments.worlds.time_sync.sar_echo import Radar, echoes, scene
from sim_instruments.worlds.time_sync.stream import Numbered

Int64 = NDArray[np.int64]

PERIOD_S = 0.001
PEAK_COUNTS = 6000  # of one reflector; all three in one gate and the noise still fit
RECEIVER_NOISE = 0.1  # root mean square of a gate in parts of that: 20 dB below
LATENCY_S = 0.0005
_HIGHEST = 2**15 - 1


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

    def columns(self, number: Int64, counter: Int64) -> Mapping[str, Any]:
        """Return fields of pulses in a row, by number and by counter."""
        own_s = number * PERIOD_S
        self._flight.upto(int(self._clock.times_ns(own_s[-1:])[0]))
        flight_s = self._clock.since_on_s(own_s) + self._flight.seconds(self._clock.on_ns)
        found = echoes(self.radar, self._flight.path.state(flight_s).p, self.targets_m, np.ones(len(self.targets_m)))
        echo = np.stack([found.gates.real, found.gates.imag], axis=-1).reshape(number.size, -1)
        if self._noise_of is not None:
            echo = echo + self._noise_of.upto(int(counter[0]), int(counter[-1]) + 1)
        return {
            "tick": np.rint(own_s / TICK_S).astype(np.int64),
            "near_range": found.near_range_m,
            "spacing": found.spacing_m,
            "wavelength": self.radar.wavelength_m,
            "echo": np.rint(PEAK_COUNTS * echo).clip(-_HIGHEST, _HIGHEST).astype(np.int64),
            "status": 0,
        }


def receiver_noise(seed: int, power: int) -> Numbered:
    """Noise of all pulses of a switching-on of the unit, in parts of the peak of one reflector, (n, 128)."""
    each = RECEIVER_NOISE / np.sqrt(2.0)
    return Numbered(seed, "time sync receiver", power, draw=lambda rng, count: each * rng.standard_normal((count, 128)))
