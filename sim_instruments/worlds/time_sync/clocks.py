"""Clocks of the two units: readings of the IMU's and of the EGI's as functions of bench time.

A clock begins anew at each switching-on, at a reading that nobody can know. Seconds are float since the switching-on,
whole ticks only on the wire: nothing is rounded to a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS
from sim_instruments.seeds import generator
from sim_instruments.worlds.time_sync.options import SyncOptions

Float = NDArray[np.float64]
Int64 = NDArray[np.int64]

TICK_S = 1e-7
_FIRST_READING_S = (100.0, 5000.0)


@dataclass(frozen=True)
class UnitClock:
    """One clock: it reads ``start_s`` at bench time ``on_ns`` and runs ``rate`` seconds in one of the bench."""

    on_ns: int
    start_s: float
    rate: float

    def reading_s(self, t_ns: int) -> float:
        """Return what the clock reads at a bench time."""
        return self.start_s + (t_ns - self.on_ns) / NS * self.rate

    def since_on_s(self, reading_s: Float) -> Float:
        """Bench seconds since the switching-on at which the clock reads so."""
        return (reading_s - self.start_s) / self.rate

    def times_ns(self, reading_s: Float) -> Int64:
        """Bench times to the nearest nanosecond, for what is late anyway."""
        return self.on_ns + np.rint(NS * self.since_on_s(reading_s)).astype(np.int64)


@dataclass(frozen=True)
class Clocks:
    """Both clocks of one switching-on. The time offset is that of the EGI minus that of the IMU at the same moment."""

    imu: UnitClock
    egi: UnitClock

    @classmethod
    def started(cls, options: SyncOptions, seed: int, power: int, on_ns: int) -> Clocks:
        """Clocks of the switching-on ``power``, numbered from 0."""
        start_s = float(generator(seed, "time sync first readings", power).uniform(*_FIRST_READING_S))
        drift_ppm, imu_ppm = options.rates_ppm(seed)
        rate = 1.0 + 1e-6 * imu_ppm
        egi_s = start_s + options.first_offset_s(seed, power)
        return cls(UnitClock(on_ns, start_s, rate), UnitClock(on_ns, egi_s, rate * (1.0 + 1e-6 * drift_ppm)))

    def offset_s(self, t_ns: int) -> float:
        """Return time offset at a bench time."""
        gained = (t_ns - self.imu.on_ns) / NS * (self.egi.rate - self.imu.rate)
        return self.egi.start_s - self.imu.start_s + gained

    @property
    def drift_ppm(self) -> float:
        """Rate of the EGI's clock against the IMU's."""
        return 1e6 * (self.egi.rate / self.imu.rate - 1.0)
