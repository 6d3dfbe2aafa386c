"""The inertial unit at the antenna: increments between the instants of its own clock, as frames ``imu_200``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_instruments.worlds.time_sync.clocks import TICK_S, UnitClock
from sim_instruments.worlds.time_sync.flight.flights import Flight, Flights
from sim_instruments.worlds.time_sync.flight.imu import exact_increments

Float = NDArray[np.float64]
Int64 = NDArray[np.int64]

PERIOD_S = 0.005
ANGLE_LSB_RAD, VELOCITY_LSB_M_S, TEMPERATURE_LSB_DEGC = 1e-9, 1e-8, 0.01
FIRST_DEGC, WARM_DEGC, WARM_S = 23.0, 6.0, 300.0
_HIGHEST = 2**31 - 1


class ImuSamples:
    """Samples of one switching-on.

    Args:
        clock: the unit's.   flights: of the vehicle.
        noise: whether the sensors have errors.   tag_noise_s: (first, stop) of counters to errors of the tags.
    """

    def __init__(
        self,
        clock: UnitClock,
        flights: Flights,
        noise: bool,
        tag_noise_s: Callable[[int, int], Float],
    ) -> None:
        self._clock, self._flights, self._noise, self._tag_noise_s = clock, flights, noise, tag_noise_s

    def columns(self, number: Int64, counter: Int64) -> Mapping[str, Any]:
        """Return fields of samples in a row, by number and by counter."""
        since_on_s = self._clock.since_on_s(np.append(number[0] - 1, number) * PERIOD_S)
        dv, dtheta = (np.empty((number.size, 3)) for _ in range(2))
        for flight, first, part in self._flights.split(self._clock, PERIOD_S, number):
            behind = int(number[part.start]) - first
            dv[part], dtheta[part] = self._increments(flight, behind, since_on_s[part.start : part.stop + 1])
        tag_s = number * PERIOD_S + self._tag_noise_s(int(counter[0]), int(counter[-1]) + 1)
        degC = FIRST_DEGC - WARM_DEGC * np.expm1(-since_on_s[1:] / WARM_S)
        return {
            "tick": np.rint(tag_s / TICK_S).astype(np.int64),
            "delta_angle": _counts(dtheta / ANGLE_LSB_RAD),
            "delta_velocity": _counts(dv / VELOCITY_LSB_M_S),
            "temperature": np.rint(degC / TEMPERATURE_LSB_DEGC).astype(np.int64),
            "status": 0,
        }

    def _increments(self, flight: Flight, behind: int, since_on_s: Float) -> tuple[Float, Float]:
        """Of the intervals between bench times; ``behind`` is how many samples of the flight came before."""
        flight_s = since_on_s + flight.seconds(self._clock.on_ns)
        dv, dtheta = exact_increments(flight.path, flight_s)
        if not self._noise:
            return dv, dtheta
        noise, length_s = flight.imu.noise(behind, since_on_s.size - 1), PERIOD_S / self._clock.rate
        dv = dv + flight.imu.accel_bias * length_s + noise[:, :3]
        return dv, dtheta + flight.imu.gyro_bias * length_s + noise[:, 3:]


def _counts(values: Float) -> Int64:
    return np.rint(values).clip(-_HIGHEST, _HIGHEST).astype(np.int64)
