"""Samples of both units by their own clocks: truth and errors, as frames ``egi_50`` and ``imu_200``.

From the tangent plane of the simulated flight to what a navigation unit tells: WGS-84 position, local level frame.

Frames: t, north-east-down at the origin of the flight (Cartesian, fixed to the Earth); e, Earth-centred Earth-fixed;
n, north-east-down where the vehicle is. Angles inside are radians.

Source: WGS 84 (NGA.STND.0036, section 3: semi-axis and flattening); H. Vermeille, "Direct transformation from
geocentric coordinates to geodetic coordinates", J. Geodesy 76 (2002), 451-454, equations (1) to (22).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bench.model.arrays import Floats, Integers
from sim_instruments.seeds import generator
from sim_instruments.worlds.time_sync.flight.egi import EgiClass, EgiErrorFilter, lane
from sim_instruments.worlds.time_sync.flight.flights import Flight, Flights
from sim_instruments.worlds.time_sync.flight.imu import exact_increments
from sim_instruments.worlds.time_sync.flight.path import LATITUDE_DEG, FlightPath, PathState
from sim_instruments.worlds.time_sync.stream import TICK_S, ByNumber, UnitClock

SEMI_AXIS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
TURN_RAD = 2.0 * np.pi
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)


def to_earth(latitude_rad: Floats, longitude_rad: Floats, height_m: Floats) -> Floats:
    """Return Earth-centred coordinates (..., 3) in metre of geodetic ones (...)."""
    sine, cosine = np.sin(latitude_rad), np.cos(latitude_rad)
    across_m = SEMI_AXIS_M / np.sqrt(1.0 - ECCENTRICITY_2 * sine**2)
    level_m = (across_m + height_m) * cosine
    polar_m = ((1.0 - ECCENTRICITY_2) * across_m + height_m) * sine
    return np.stack([level_m * np.cos(longitude_rad), level_m * np.sin(longitude_rad), polar_m], axis=-1)


def to_geodetic(earth_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Return latitude and longitude (radian) and height (metre) of points (..., 3), not near the centre."""
    x, y, z = np.moveaxis(np.asarray(earth_m, float), -1, 0)
    e2, e4 = ECCENTRICITY_2, ECCENTRICITY_2**2
    p = (x**2 + y**2) / SEMI_AXIS_M**2
    q = (1.0 - e2) / SEMI_AXIS_M**2 * z**2
    r = (p + q - e4) / 6.0
    s = e4 * p * q / (4.0 * r**3)
    t = np.cbrt(1.0 + s + np.sqrt(s * (2.0 + s)))
    u = r * (1.0 + t + 1.0 / t)
    v = np.sqrt(u**2 + e4 * q)
    w = e2 * (u + v - q) / (2.0 * v)
    k = np.sqrt(u + v + w**2) - w
    level_m = k * np.hypot(x, y) / (k + e2)
    reach_m = np.hypot(level_m, z)
    height_m = (k + e2 - 1.0) / k * reach_m
    return 2.0 * np.arctan2(z, level_m + reach_m), np.arctan2(y, x), height_m


def level_axes(latitude_rad: Floats, longitude_rad: Floats) -> Floats:
    """Turn from the local level frame to the Earth's: columns are north, east and down, (..., 3, 3)."""
    latitude_rad, longitude_rad = np.broadcast_arrays(latitude_rad, longitude_rad)
    sl, cl, so, co = np.sin(latitude_rad), np.cos(latitude_rad), np.sin(longitude_rad), np.cos(longitude_rad)
    zero = np.zeros_like(sl)
    rows = [-sl * co, -so, -cl * co, -sl * so, co, -cl * so, cl, zero, -sl]
    return np.stack(rows, axis=-1).reshape(*sl.shape, 3, 3)


def euler_rad(turn: Floats) -> Floats:
    """Return roll, pitch, heading (..., 3) of turns from body to level (..., 3, 3), not at pitch 90 deg.

    Heading from 0 to below 2 pi.
    """
    roll = np.arctan2(turn[..., 2, 1], turn[..., 2, 2])
    pitch = np.arctan2(-turn[..., 2, 0], np.hypot(turn[..., 2, 1], turn[..., 2, 2]))
    heading = np.arctan2(turn[..., 1, 0], turn[..., 0, 0]) % TURN_RAD
    heading = np.where(heading < TURN_RAD, heading, 0.0)  # a rounding below north
    return np.stack([roll, pitch, heading], axis=-1)


EGI_PERIOD_S, IMU_PERIOD_S = 0.02, 0.005
LONGITUDE_DEG = 127.0
ALIGNING, GPS_AND_INERTIAL = 0, 3  # modes
_COARSE = (5.0, 0.1, np.radians(0.5))  # m, m/s, rad: errors while it aligns, standard deviations
ANGLE_LSB_RAD, VELOCITY_LSB_M_S, TEMPERATURE_LSB_DEGC = 1e-9, 1e-8, 0.01
FIRST_DEGC, WARM_DEGC, WARM_S = 23.0, 6.0, 300.0
_HIGHEST = 2**31 - 1


def solution(position_m: Floats, velocity_m_s: Floats, turn: Floats) -> dict[str, Floats]:
    """Return what a unit tells at positions with velocities (n, 3), in t, its body turned by ``turn`` (n, 3, 3).

    The origin of t is at height 0. The velocity is fixed to the Earth, so only the direction of its axes changes.
    """
    latitude, longitude = np.radians(LATITUDE_DEG), np.radians(LONGITUDE_DEG)
    axes = level_axes(latitude, longitude)  # t to e
    origin_m = to_earth(latitude, longitude, np.zeros(()))
    latitude, longitude, height_m = to_geodetic(origin_m + position_m @ axes.T)
    to_level = np.swapaxes(level_axes(latitude, longitude), -1, -2) @ axes  # t to n
    return {
        "latitude": np.degrees(latitude),
        "longitude": np.degrees(longitude),
        "height": height_m,
        "velocity": np.einsum("nij,nj->ni", to_level, velocity_m_s),
        "attitude": np.degrees(euler_rad(to_level @ turn)),
    }


class OwnTime:
    """A path as a clock sees it that runs ``rate`` seconds in one: both read ``same_s`` at the same moment."""

    def __init__(self, path: FlightPath, rate: float, same_s: float) -> None:
        self._path, self._rate, self._same_s = path, rate, same_s

    def state(self, t_s: Floats) -> PathState:
        """Return motion at readings of the clock; derivatives are those of true time."""
        return self._path.state(self._same_s + (t_s - self._same_s) / self._rate)


class Solutions:
    """Errors of the EGI on one flight, sample by sample.

    Args: first_s: time of the flight at sample 0.   rate: of the EGI's clock.
    Attributes: rows: position (m), velocity (m/s) and attitude (rad), three each, and what the unit believes of its
        position (m), standard deviation.
    """

    def __init__(self, flight: Flight, first_s: float, rate: float) -> None:
        self.first_s = first_s
        self.rows: list[Floats] = []
        path: Any = OwnTime(flight.path, rate, first_s)
        self._filter = EgiErrorFilter(path, first_s, [lane(flight.seed, flight.number)], EgiClass())

    def upto(self, first: int, stop: int) -> Floats:
        """Return errors of samples ``first`` to ``stop`` - 1, (n, 10); the path must be complete up to the last one."""
        while len(self.rows) < stop:
            errors = self._filter.advance(1)[0, 0]
            self.rows.append(np.append(errors, self._filter.position_sigma_m))
        return np.array(self.rows[first:stop])


class _Samples:
    """Samples of one switching-on of a unit.

    Args:
        clock: the unit's.   flights: of the vehicle.   noise: whether the unit has errors.
        tag_noise_s: (first, stop) of counters to errors of the tags.
    """

    period_s: ClassVar[float]

    def __init__(self, clock: UnitClock, flights: Flights, noise: bool, tag_noise_s: ByNumber) -> None:
        self._clock, self._flights, self._noise, self._tag_noise_s = clock, flights, noise, tag_noise_s

    def _ticks(self, number: Integers, counter: Integers) -> Integers:
        tag_s = number * self.period_s + self._tag_noise_s(int(counter[0]), int(counter[-1]) + 1)
        return np.rint(tag_s / TICK_S).astype(np.int64)


class EgiSamples(_Samples):
    """Those of the EGI. It is aligned when a flight begins, not before. Args: seed, power: name those draws."""

    period_s = EGI_PERIOD_S

    def __init__(
        self, clock: UnitClock, flights: Flights, noise: bool, tag_noise_s: ByNumber, seed: int, power: int
    ) -> None:
        super().__init__(clock, flights, noise, tag_noise_s)
        drawn = generator(seed, "time sync alignment", power).standard_normal((3, 3))
        self._coarse = np.append((drawn * np.array(_COARSE)[:, None]).ravel(), _COARSE[0])
        self.solutions: dict[int, Solutions] = {}  # by number of the flight

    def columns(self, number: Integers, counter: Integers) -> Mapping[str, Any]:
        """Return fields of samples in a row, by number and by counter."""
        since_on_s = self._clock.since_on_s(number * EGI_PERIOD_S)
        errors, mode = np.empty((number.size, 10)), np.empty(number.size, np.int64)
        p, v, yaw = np.empty((number.size, 3)), np.empty((number.size, 3)), np.empty(number.size)
        for flight, first, part in self._flights.split(self._clock, EGI_PERIOD_S, number):
            true = flight.path.state(since_on_s[part] + flight.seconds(self._clock.on_ns))
            p[part], v[part], yaw[part] = true.p, true.v, true.yaw
            aligned = flight.flies and flight.begin_ns >= self._clock.on_ns
            mode[part] = GPS_AND_INERTIAL if aligned else ALIGNING
            errors[part] = self._errors(flight, first, number[part]) if aligned else self._coarse
        if not self._noise:
            errors[:, :9] = 0.0
        return {
            "tick": self._ticks(number, counter),
            **solution(p + errors[:, :3], v + errors[:, 3:6], turned(errors[:, 6:9], yaw)),
            "position_sigma": errors[:, 9],
            "mode": mode,
            "status": 0,
        }

    def _errors(self, flight: Flight, first: int, number: Integers) -> Floats:
        if flight.number not in self.solutions:
            since_on_s = float(self._clock.since_on_s(np.array(first * EGI_PERIOD_S)))
            first_s = since_on_s + flight.seconds(self._clock.on_ns)
            self.solutions[flight.number] = Solutions(flight, first_s, self._clock.rate)
        return self.solutions[flight.number].upto(int(number[0]) - first, int(number[-1]) + 1 - first)


def turned(rotation_rad: Floats, yaw_rad: Floats) -> Floats:
    """Return exp([rotation x]) times the turn about down by yaw: (n, 3), (n,) to (n, 3, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(rotation_rad, axis=1)[:, None, None]
    cross = np.zeros((angle.size, 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]] = rotation_rad
    cross[:, [1, 2, 0], [2, 0, 1]] = -rotation_rad
    tilt = np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * cross @ cross
    heading = np.zeros_like(cross)
    heading[:, 0, 0] = heading[:, 1, 1] = np.cos(yaw_rad)
    heading[:, 1, 0] = np.sin(yaw_rad)
    heading[:, 0, 1] = -heading[:, 1, 0]
    heading[:, 2, 2] = 1.0
    return tilt @ heading


class ImuSamples(_Samples):
    """Those of the inertial unit."""

    period_s = IMU_PERIOD_S

    def columns(self, number: Integers, counter: Integers) -> Mapping[str, Any]:
        """Return fields of samples in a row, by number and by counter."""
        since_on_s = self._clock.since_on_s(np.append(number[0] - 1, number) * IMU_PERIOD_S)
        dv, dtheta = (np.empty((number.size, 3)) for _ in range(2))
        for flight, first, part in self._flights.split(self._clock, IMU_PERIOD_S, number):
            behind = int(number[part.start]) - first
            dv[part], dtheta[part] = self._increments(flight, behind, since_on_s[part.start : part.stop + 1])
        degC = FIRST_DEGC - WARM_DEGC * np.expm1(-since_on_s[1:] / WARM_S)
        return {
            "tick": self._ticks(number, counter),
            "delta_angle": _counts(dtheta / ANGLE_LSB_RAD),
            "delta_velocity": _counts(dv / VELOCITY_LSB_M_S),
            "temperature": np.rint(degC / TEMPERATURE_LSB_DEGC).astype(np.int64),
            "status": 0,
        }

    def _increments(self, flight: Flight, behind: int, since_on_s: Floats) -> tuple[Floats, Floats]:
        """Of the intervals between bench times; ``behind`` is how many samples of the flight came before."""
        flight_s = since_on_s + flight.seconds(self._clock.on_ns)
        dv, dtheta = exact_increments(flight.path, flight_s)
        if not self._noise:
            return dv, dtheta
        noise, length_s = flight.imu.noise(behind, since_on_s.size - 1), IMU_PERIOD_S / self._clock.rate
        dv = dv + flight.imu.accel_bias * length_s + noise[:, :3]
        return dv, dtheta + flight.imu.gyro_bias * length_s + noise[:, 3:]


def _counts(values: Floats) -> Integers:
    return np.rint(values).clip(-_HIGHEST, _HIGHEST).astype(np.int64)
