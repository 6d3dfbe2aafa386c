"""One simulated GNC module: everything that belongs to one serial number."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bench.model.arrays import Integers
from sim_instruments.worlds.gnc.imu import SAMPLE_NS, Counts, GncImu
from sim_instruments.worlds.gnc.peripherals import Converter, Power, Receiver
from sim_instruments.worlds.gnc.processor import Memories, ModuleDraws, Processor

CRYSTAL_SIGMA_PPM = 10.0
CRYSTAL_TURN_DEGC, CRYSTAL_PPM_DEGC2 = 25.0, -0.035  # a tuning-fork crystal is slow on both sides
GYRO_FULL_SCALE = 80_000  # 400 deg/s in steps of 0.005 deg/s
NO_TEMPERATURE = -27_300  # 0.01 degC, an open sensor


class GncModule:
    """Hardware of one serial number; it keeps its memories and its errors, whatever socket it is put into.

    Args:
        seed, serial: of all draws.   faults: names of gnc_faults.FAULTS that are there from the beginning.
        sensors: its inertial sensors and magnetometer.   place: latitude and longitude in degrees, height in metres.
    """

    def __init__(
        self, seed: int, serial: str, faults: Iterable[str], sensors: GncImu, place: tuple[float, float, float]
    ) -> None:
        draws = ModuleDraws(seed, serial)
        self.serial = serial
        self.faults: set[str] = set(faults)
        self.processor = Processor(draws, self.faults)
        self.memories = Memories(draws, self.faults)
        self.power = Power(draws, self.faults)
        self.converter = Converter(draws, self.faults)
        self.receiver = Receiver(draws, self.faults, place)
        self._sensors = sensors
        self._frozen: Counts | None = None
        self._crystal_ppm = draws.generator("crystal").normal(0.0, CRYSTAL_SIGMA_PPM)

    def samples(self, t_ns: Integers, interval_ns: int) -> Counts:
        """Return what the processor reads from its sensors, as ``GncImu.sample``, with the faults of the module."""
        if "imu_frozen" in self.faults:
            self._frozen = self._frozen or self._sensors.sample(t_ns[:1], interval_ns)
            old = self._frozen
            parts = (np.repeat(part, len(t_ns), axis=0) for part in (old.gyro, old.accel, old.mag, old.temperature))
            counts = Counts(*parts)
        else:
            counts = self._sensors.sample(t_ns, interval_ns)
        if "gyro_saturated" in self.faults:
            counts.gyro[:, 1] = GYRO_FULL_SCALE
        if "accelerometer_dead" in self.faults:
            counts.accel[:, 2] = 0
        return counts

    def field_counts(self, t_ns: int) -> Integers:
        """Return the magnetometer at one bench time, (3,)."""
        return self.samples(np.array([t_ns]), SAMPLE_NS).mag[0]

    def set_power(self, on: bool, t_ns: int) -> None:
        """The sensors get power or lose it."""
        if on:
            self._sensors.power.on(t_ns)
        else:
            self._sensors.power.off(t_ns)

    def gyro_temperature(self, temperature: Integers) -> Integers:
        """Return what the gyro's own thermometer gives where the module has this temperature, 0.01 degC."""
        return np.full_like(temperature, NO_TEMPERATURE) if "imu_temperature_open" in self.faults else temperature

    def crystal_error(self, t_ns: int) -> float:
        """Return relative error of the processor's clock at a bench time, positive = too fast."""
        away_degC = float(self.samples(np.array([t_ns]), SAMPLE_NS).temperature[0]) / 100.0 - CRYSTAL_TURN_DEGC
        return (self._crystal_ppm + CRYSTAL_PPM_DEGC2 * away_degC**2) * 1e-6
