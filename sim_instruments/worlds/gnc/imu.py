"""The simulated sensors of one GNC module: gyroscopes, accelerometers, magnetometer and thermometer.

A sample of gyroscope and accelerometer is the mean over the interval that ends at its time stamp, as a sensor that
integrates between two readings gives it; the sum of contiguous samples is therefore the turn itself. Magnetometer and
thermometer are read at the time stamp. All of it is a function of bench time, seed and serial number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats, Integers
from bench.model.clock import NS
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import (
    Site,
    Surroundings,
    Tilt,
    angles_deg,
    in_body_axes,
    in_inner_axes,
    turned_deg,
)
from sim_instruments.worlds.common.sensor_noise import SlowNoise, WhiteNoise
from sim_instruments.worlds.common.thermal import LAB_DEGC
from sim_instruments.worlds.gnc.imu_errors import (
    MAGNETIC_NOISE_GAUSS,
    SLOW_ACCEL_G,
    SLOW_ACCEL_S,
    SLOW_GYRO_DEG_S,
    SLOW_GYRO_S,
    THERMOMETER_NOISE_DEGC,
    ImuErrors,
    ImuOptions,
    PowerPeriods,
)
from sim_instruments.worlds.gnc.magnetometer import EarthField, Magnetometer, field_gauss

_STEP_NS = 5_000_000  # an interval is split into steps no longer than this
_NODES = (0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0))  # Gauss and Legendre: exact to the third power of time
SAMPLE_NS = 5_000_000  # 200 Hz
GYRO_LSB_DEG_S, GYRO_RANGE_DEG_S = 0.005, 400.0
ACCEL_LSB_G, ACCEL_RANGE_G = 1e-3, 50.0
MAG_LSB_GAUSS, MAG_RANGE_GAUSS = 120e-6, 6.0
WORD = 32767  # largest count of the temperature's 16-bit word
TEMPERATURE_LSB_DEGC = 0.01
_CHUNK = 65_536


def _true_inputs(
    surroundings: Surroundings, site: Site, tilt: Tilt | None, t_ns: Integers, interval_ns: int
) -> tuple[Floats, Floats]:
    """Return mean rate (deg/s, against inertial space) and specific force (standard g) in body axes, (n, 3) each.

    The turn of a single axis enters as the exact difference of its angle over the interval. Earth's rate and gravity
    are turned into the body at two nodes of each 5 ms: at 400 deg/s that leaves 3e-10 of them.
    """
    first, last = angles_deg(surroundings.motion, t_ns - interval_ns), angles_deg(surroundings.motion, t_ns)
    if np.array_equal(first, last) and (first == first[:1]).all():
        rate, force = _in_place(surroundings, site, tilt, first[:1])
        return np.repeat(rate, t_ns.size, axis=0), np.repeat(force, t_ns.size, axis=0)
    mounting, interval_s = surroundings.mounting, interval_ns / NS
    steps = max(1, -(-interval_ns // _STEP_NS))
    edges = [t_ns - interval_ns + interval_ns * step // steps for step in range(steps + 1)]
    corners = [first, *(angles_deg(surroundings.motion, edge) for edge in edges[1:-1]), last]
    together = np.count_nonzero((first != last).any(axis=0)) > 1
    turn, rate, force = np.zeros_like(first), np.zeros_like(first), np.zeros_like(first)
    for step in range(steps):
        begin, length = edges[step], edges[step + 1] - edges[step]
        nodes = [begin + np.rint(node * length).astype(np.int64) for node in _NODES]
        between = np.stack([angles_deg(surroundings.motion, node) for node in nodes])
        gain_deg = _gain_deg(surroundings, nodes, length) if together else np.zeros_like(first)
        turn += turned_deg(corners[step], corners[step + 1], between, gain_deg)
        for node_angles in between:
            of_earth, at_rest = _in_place(surroundings, site, tilt, node_angles)
            rate += of_earth / (2 * steps)
            force += at_rest / (2 * steps)
    ends = [tilt.rad(first), tilt.rad(last)] if tilt else [np.zeros(3)] * 2
    tilts = (ends[0] + ends[1]) / 2.0 if tilt else None
    wobble = np.rad2deg(ends[1] - ends[0])
    rate += in_body_axes(turn + wobble, mounting, tilts) / interval_s
    return rate, force


def _gain_deg(surroundings: Surroundings, nodes: list[Integers], length_ns: Integers) -> Floats:
    """Return rates at the second node minus those at the first, times the length, (n, 3); for several moving axes."""
    rates = [np.stack([axis.rate_deg_s(node) for axis in surroundings.motion], axis=1) for node in nodes]
    return (rates[1] - rates[0]) * (length_ns / NS)[:, None]


def _in_place(surroundings: Surroundings, site: Site, tilt: Tilt | None, angles: Floats) -> tuple[Floats, Floats]:
    """Return Earth's rate (deg/s) and the force at rest (g) in body axes at table angles (n, 3)."""
    tilts = None if tilt is None else tilt.rad(angles)
    rate = in_body_axes(in_inner_axes(site.earth_rate_deg_s, angles, site), surroundings.mounting, tilts)
    force = in_body_axes(in_inner_axes(site.rest_force_g, angles, site), surroundings.mounting, tilts)
    return rate, force


@dataclass(frozen=True)
class Readings:
    """Indications of the sensors before range and quantisation: (n, 3) each and temperature (n,)."""

    gyro_deg_s: Floats
    accel_g: Floats
    mag_gauss: Floats
    temperature_degC: Floats


@dataclass(frozen=True)
class Counts:
    """Steps that they give out: (n, 3) each in 0.005 deg/s, 1 mg, 120 microgauss; temperature (n,) in 0.01 degC."""

    gyro: Integers
    accel: Integers
    mag: Integers
    temperature: Integers


class GncImu:
    """Sensors of one module.

    Args:
        seed: seed of the run.   serial: serial number of the module; both together name every draw.
        options: see ImuOptions.
        surroundings: table motion, mounting and kind of table as they are when a sample is taken (the world).
        site: latitude, gravity, azimuth of the inner axis.
    """

    def __init__(self, seed: int, serial: str, options: ImuOptions, surroundings: Surroundings, site: Site) -> None:
        self.serial, self.options = serial, options
        self.surroundings = surroundings
        self.site, self.earth = site, EarthField()
        self.errors = ImuErrors(seed, serial, self.options)
        self.magnetometer = Magnetometer(seed, serial, errors=self.options.errors)
        self.power = PowerPeriods()
        self._white = WhiteNoise(seed, f"gnc white noise {serial}", 10)
        sigmas = np.repeat((SLOW_GYRO_DEG_S, *(SLOW_ACCEL_G,) * len(SLOW_ACCEL_S)), 3)
        times_s = np.repeat((SLOW_GYRO_S, *SLOW_ACCEL_S), 3)
        self._slow = SlowNoise(seed, f"gnc slow noise {serial}", sigmas, times_s)
        self._seed = seed

    def sample(self, t_ns: Integers, interval_ns: int = SAMPLE_NS) -> Counts:
        """Return samples at bench times (n,), each over the interval that ends there; limited to the range, rounded."""
        read = self.readings(t_ns, interval_ns)
        mag = np.clip(read.mag_gauss, -MAG_RANGE_GAUSS, MAG_RANGE_GAUSS)
        return Counts(
            gyro=_counts(np.clip(read.gyro_deg_s, -GYRO_RANGE_DEG_S, GYRO_RANGE_DEG_S), GYRO_LSB_DEG_S),
            accel=_counts(np.clip(read.accel_g, -ACCEL_RANGE_G, ACCEL_RANGE_G), ACCEL_LSB_G),
            mag=_counts(mag, MAG_LSB_GAUSS),
            temperature=np.clip(_counts(read.temperature_degC, TEMPERATURE_LSB_DEGC), -WORD, WORD),
        )

    def readings(self, t_ns: Integers, interval_ns: int = SAMPLE_NS) -> Readings:
        """Return the same before range and quantisation; nothing is lost of a noise-free reading."""
        times_ns = np.asarray(t_ns, np.int64)
        parts = [self._part(times_ns[at : at + _CHUNK], interval_ns) for at in range(0, times_ns.size, _CHUNK)]
        parts = parts or [self._part(times_ns, interval_ns)]
        return Readings(*(np.concatenate(pieces) for pieces in zip(*parts, strict=True)))

    def temperature_degC(self, t_ns: Integers) -> Floats:
        """Return True temperature of the module at bench times, (n,), degC."""
        return LAB_DEGC + self.power.rise_degC(t_ns)

    def gyro_bias_deg_s(self, t_ns: Integers) -> Floats:
        """Return True b of N = S (w + b) at bench times, slow noise and turn-on included, (n, 3), deg/s."""
        return self._biases(t_ns)[:, :3]

    def accel_bias_g(self, t_ns: Integers) -> Floats:
        """Return True b of N = S (a + b), (n, 3), standard g."""
        return self._biases(t_ns)[:, 3:]

    def _part(self, t_ns: Integers, interval_ns: int) -> tuple[Floats, Floats, Floats, Floats]:
        surroundings, mounting = self.surroundings, self.surroundings.mounting
        tilt = self.errors.tilt(mounting)
        degC = self.temperature_degC(t_ns)
        biases = self._biases(t_ns)
        rate, force = _true_inputs(surroundings, self.site, tilt, t_ns, interval_ns)
        table = surroundings.table
        field = field_gauss(surroundings.motion, table, self.site, self.earth, tilt, t_ns, mounting)
        noise = self._noise(t_ns, interval_ns)
        gyro, accel = self.errors.gyro, self.errors.accel
        return (
            gyro.row_factor(degC) * ((rate + biases[:, :3]) @ gyro.sensitivity.T) + noise[:, :3],
            accel.row_factor(degC) * ((force + biases[:, 3:]) @ accel.sensitivity.T) + noise[:, 3:6],
            self.magnetometer.indicated_gauss(field) + noise[:, 6:9],
            degC + self.errors.thermometer_degC + noise[:, 9],
        )

    def _noise(self, t_ns: Integers, interval_ns: int) -> Floats:
        if not self.options.noise:
            return np.zeros((t_ns.size, 10))
        mean_of = np.sqrt(interval_ns / NS)
        white = np.concatenate((self.errors.gyro.white / mean_of, self.errors.accel.white / mean_of))
        return self._white.at(t_ns) * np.array([*white, *(MAGNETIC_NOISE_GAUSS,) * 3, THERMOMETER_NOISE_DEGC])

    def _biases(self, t_ns: Integers) -> Floats:
        """Return biases of gyroscopes and accelerometers, (n, 6)."""
        degC = self.temperature_degC(t_ns)
        steady = np.concatenate((self.errors.gyro.bias_at(degC), self.errors.accel.bias_at(degC)), axis=1)
        if not self.options.noise:
            return steady
        slow = self._slow.at(t_ns - self.power.first_ns)
        steady[:, :3] += slow[:, :3]
        steady[:, 3:] += slow[:, 3:].reshape(t_ns.size, len(SLOW_ACCEL_S), 3).sum(axis=1)
        return steady + self._turn_on(t_ns)

    def _turn_on(self, t_ns: Integers) -> Floats:
        periods = self.power.period(t_ns)
        sizes = np.concatenate((self.errors.gyro.turn_on, self.errors.accel.turn_on))
        distinct, place = np.unique(periods, return_inverse=True)
        name = f"gnc turn-on {self.serial}"
        drawn = [generator(self._seed, name, int(period)).standard_normal(6) * sizes for period in distinct]
        return np.array(drawn).reshape(-1, 6)[place]


def _counts(value: Floats, lsb: float) -> Integers:
    return np.rint(value / lsb).astype(np.int64)
