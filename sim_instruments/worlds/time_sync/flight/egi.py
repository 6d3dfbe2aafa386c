"""Coloured errors of simulated EGIs (embedded GPS/INS), at 50 Hz, and what the EGIs of a Monte Carlo study send.

The error filter inside a simulated EGI: 15 states, closed loop, errors and covariance of many units at once.

Errors are estimate minus truth, in the order position, velocity, attitude (rotation vector in the tangent plane that
turns the true attitude into the estimated one), accelerometer bias, gyroscope bias. They are propagated to first order
along the true path, so what the filter believes (one covariance for all units) is right by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats
from sim_instruments.seeds import generator
from sim_instruments.worlds.common.attitude import cross_matrix
from sim_instruments.worlds.time_sync.flight.path import (
    LATITUDE_DEG,
    STANDARD_GRAVITY_M_S2,
    FlightPath,
    PathState,
    earth_rate_rad_s,
    gravity_gradient_s2,
    normal_gravity_m_s2,
)

LANES = 64  # matrix products always have this shape, so that no result depends on how many units there are
_KICKS = 6  # normal numbers of one step: velocity and attitude
# What transitions() fills in, rows and columns: minus [force x], minus the turn from body to tangent plane twice
_ROWS = (3, 4, 5, 4, 5, 3, 3, 4, 3, 4, 6, 7, 6, 7)
_COLUMNS = (7, 8, 6, 6, 7, 8, 9, 9, 10, 10, 12, 12, 13, 13)
_CHANGING = 15 * np.array(_ROWS) + np.array(_COLUMNS)
_WALKED = 16 * np.arange(3, 9)  # their places on the diagonal of a covariance laid out flat


@dataclass(frozen=True)
class EgiClass:
    """One-sigma figures of the paper's Table 1 (units of the walks as in ``ImuClass``), and what it does not state.

    ``prior_s`` s of straight flight before 0 s with GPS, ``prior_velocity_m_s`` the error of each component of velocity
    at their beginning; GPS errors are white, ``gps_position_m`` in each axis.
    """

    accel_bias_ug: float = 25.0
    velocity_walk_ug: float = 2.5
    gyro_bias_deg_h: float = 0.003
    angle_walk_deg_rt_h: float = 0.001
    rate_Hz: int = 50
    gps_position_m: float = 1.0
    gps_interval_s: int = 1
    prior_s: int = 60
    prior_velocity_m_s: float = 0.1


class EgiErrorFilter:
    """Errors of units that fly the same path, from ``prior_s`` before ``begin_s`` on, one sample after the other.

    Args:
        path: needs to be known up to the time of the sample asked for, never beyond it; it may be extended from there.
        begin_s: time of the path when sample 0 is valid.
        lanes: one generator per unit, which makes all its draws, see ``lane``.
    """

    def __init__(
        self,
        path: FlightPath,
        begin_s: float,
        lanes: Sequence[np.random.Generator],
        sensor: EgiClass,
    ) -> None:
        self._path, self._begin_s, self._lanes, self._sensor = path, begin_s, lanes, sensor
        self._model = _ErrorModel(sensor)
        self._per_fix = sensor.gps_interval_s * sensor.rate_Hz
        self.sample = -sensor.prior_s * sensor.rate_Hz
        start = self._model.start()
        self.covariance: Floats = np.diag(start**2)
        self._errors = start[:, None] * self._spread(np.array([lane.standard_normal(15) for lane in lanes]))
        self._draw()
        while self.sample < -1:
            self.advance(self._per_fix if self.sample < -self._per_fix else 1)

    @property
    def position_sigma_m(self) -> float:
        """Horizontal position error that a unit itself believes at the last sample: root mean of north and east."""
        return float(np.sqrt(0.5 * (self.covariance[0, 0] + self.covariance[1, 1])))

    @property
    def errors(self) -> Floats:
        """(runs, 15): m, m/s, rad, m/s2, rad/s."""
        return self._rows(self._errors)

    def advance(self, count: int) -> Floats:
        """Return errors of position, velocity and attitude of the next ``count`` samples, (count, runs, 9)."""
        times_s = self._begin_s + np.arange(self.sample, self.sample + count + 1) / self._sensor.rate_Hz
        newest = np.empty((count, self._errors.shape[0], 9, LANES))
        for row, transition in zip(newest, self._model.transitions(self._path.state(times_s)), strict=True):
            self.covariance = transition @ self.covariance @ transition.T
            self.covariance.flat[_WALKED] += self._model.walk_2
            self._errors = transition @ self._errors
            self._errors[:, 3:9] += self._kicks[self.sample % self._per_fix]
            self.sample += 1
            if self.sample % self._per_fix == 0:
                self._fix()
                self._draw()
            row[:] = self._errors[:, :9]
        return self._rows(newest)

    def _rows(self, blocks: Floats) -> Floats:
        """Return (..., blocks, c, 64) as (..., runs, c)."""
        rows = blocks.swapaxes(-1, -2)
        return rows.reshape(*rows.shape[:-3], -1, rows.shape[-1])[..., : len(self._lanes), :]

    def _fix(self) -> None:
        """GPS position: Joseph's form of the update; the errors of all units with the same gain."""
        noise_2 = self._sensor.gps_position_m**2
        gain = np.linalg.solve(self.covariance[:3, :3] + noise_2 * np.eye(3), self.covariance[:3]).T
        kept = np.eye(15)
        kept[:, :3] -= gain
        covariance = kept @ self.covariance @ kept.T + noise_2 * gain @ gain.T
        self.covariance = 0.5 * (covariance + covariance.T)
        self._errors += gain @ (self._fixes - self._errors[:, :3])

    def _draw(self) -> None:
        """Numbers of all steps up to the next GPS fix and of the fix itself."""
        count = self._per_fix * _KICKS
        drawn = self._spread(np.array([lane.standard_normal(count + 3) for lane in self._lanes]))
        kicks = drawn[:, :count].reshape(-1, self._per_fix, _KICKS, LANES)
        self._kicks = kicks.transpose(1, 0, 2, 3) * self._model.walk[:, None]
        self._fixes = drawn[:, count:] * self._sensor.gps_position_m

    def _spread(self, drawn: Floats) -> Floats:
        """Return rows of units (runs, c) in blocks of columns (blocks, c, 64), empty ones zero."""
        blocks = -(-drawn.shape[0] // LANES)
        full = np.zeros((blocks * LANES, drawn.shape[1]))
        full[: drawn.shape[0]] = drawn
        return np.ascontiguousarray(full.reshape(blocks, LANES, -1).transpose(0, 2, 1))


class _ErrorModel:
    """Transition matrix, noise and start of the 15 errors."""

    def __init__(self, sensor: EgiClass) -> None:
        self._sensor, self._dt_s = sensor, 1.0 / sensor.rate_Hz
        self._earth = earth_rate_rad_s(LATITUDE_DEG)
        self._gravity_m_s2, self._gradient = normal_gravity_m_s2(LATITUDE_DEG), gravity_gradient_s2(LATITUDE_DEG)
        turn = cross_matrix(self._earth)
        self._coriolis = 2.0 * turn
        micro_g = 1e-6 * STANDARD_GRAVITY_M_S2
        walks = [sensor.velocity_walk_ug * micro_g, np.radians(sensor.angle_walk_deg_rt_h) / 60.0]
        self.walk = np.repeat(walks, 3) * np.sqrt(self._dt_s)
        self.walk_2 = self.walk**2
        self._constant = np.zeros((15, 15))
        self._constant[:3, 3:6] = np.eye(3)
        self._constant[3:6, :3] = np.diag(self._gradient)
        self._constant[3:6, 3:6] = -self._coriolis
        self._constant[6:9, 6:9] = -turn
        self._constant[[5, 8], [11, 14]] = -1.0

    def transitions(self, true: PathState) -> Floats:
        """Return exp(F dt) to second order in dt between consecutive samples (n + 1) of the true motion, (n, 15, 15).

        The specific force is the mean of each interval, so that pieces of path much shorter than it count.
        """
        before, after = true.v[:-1], true.v[1:]
        coriolis = (0.5 * (after + before)[:, None] * self._coriolis).sum(-1)
        gravity = 0.5 * (true.p[1:] + true.p[:-1]) * self._gradient
        force = (after - before) / self._dt_s + coriolis - gravity
        yaw = 0.5 * (true.yaw[1:] + true.yaw[:-1])
        north, east, down = force[:, 0], force[:, 1], force[:, 2] - self._gravity_m_s2
        cosine, sine = np.cos(yaw), np.sin(yaw)
        step = np.empty((yaw.size, 15, 15))
        step[:] = self._constant
        values = (down, north, east, -down, -north, -east, -cosine, -sine, sine, -cosine, -cosine, -sine, sine, -cosine)
        step.reshape(-1, 225)[:, _CHANGING] = np.array(values).T
        step *= self._dt_s
        transitions = step @ step
        transitions *= 0.5
        transitions += step
        transitions.reshape(-1, 225)[:, ::16] += 1.0
        return transitions

    def start(self) -> Floats:
        """Return standard deviations at the beginning, (15,).

        As a levelling and a gyrocompass leave them: tilt as the accelerometers' biases look like, yaw as the gyroscope
        to the east does, 0.003 deg/h / (15.04 deg/h cos lat) = 0.0144 deg at 37.5 deg. Not correlated with the biases:
        aligned on any heading and flown on another.
        """
        sensor = self._sensor
        accel_bias = sensor.accel_bias_ug * 1e-6 * STANDARD_GRAVITY_M_S2
        gyro_bias = np.radians(sensor.gyro_bias_deg_h) / 3600.0
        tilt = accel_bias / self._gravity_m_s2
        sigmas = [sensor.gps_position_m, sensor.prior_velocity_m_s, tilt, accel_bias, gyro_bias]
        start = np.repeat(sigmas, 3)
        start[8] = gyro_bias / self._earth[0]
        return start


_TAG_STD_s = 1e-5


@dataclass(frozen=True)
class EgiErrors:
    """Errors (estimate minus truth) of R units at m samples, the first at 0 s.

    ``t_s`` (m,).   ``dp`` (m, R, 3): m.   ``dv`` (m, R, 3): m/s, north, east, down.   ``dphi`` (m, R, 3): rad, the
    rotation vector in the tangent plane that turns the true attitude into the estimated one.
    """

    t_s: Floats
    dp: Floats
    dv: Floats
    dphi: Floats


def egi_error_runs(
    path: FlightPath,
    duration_s: float,
    runs: int,
    seed: int,
    sensor: EgiClass | None = None,
) -> EgiErrors:
    """Return errors of ``runs`` units on the same flight, 50 a second from 0 s to ``duration_s``, both included.

    Run r is the same whatever the number of runs and the duration.
    """
    sensor = sensor or EgiClass()
    inner = EgiErrorFilter(path, 0.0, [lane(seed, run) for run in range(runs)], sensor)
    m = round(duration_s * sensor.rate_Hz) + 1
    errors = [inner.advance(min(sensor.rate_Hz, m - first)) for first in range(0, m, sensor.rate_Hz)]
    return EgiErrors(np.arange(m) / sensor.rate_Hz, *np.split(np.concatenate(errors), 3, axis=-1))


def lane(seed: int, run: int) -> np.random.Generator:
    """Return the generator of all draws of a unit."""
    return generator(seed, "flight egi", run)


class EgiRuns:
    """Samples of R units for each of G time offsets; the same errors for all offsets, so that they compare in pairs.

    A sample tagged t is the truth at t - offset, plus the error.

    Args:
        path, errors: of the flight.   offsets_s: (G,), positive means that samples are old.
        clock_noise_s: (m, R) additional age of each sample, see ``clock_noise``; none if not given.
    """

    def __init__(
        self, path: FlightPath, errors: EgiErrors, offsets_s: Floats, clock_noise_s: Floats | None = None
    ) -> None:
        self.t_s = errors.t_s
        self._path, self._errors, self._noise_s = path, errors, clock_noise_s
        self._offsets_s = np.atleast_1d(np.asarray(offsets_s, float))

    def block(self, k0: int, k1: int) -> tuple[Floats, Floats, Floats]:
        """Return samples k0 to k1 - 1: p (m), v (m/s), (k, G, R, 3), C (k, G, R, 3, 3) from body to tangent plane."""
        part = slice(k0, k1)
        valid_s = self.t_s[part, None] - self._offsets_s
        true = self._path.state(valid_s.ravel())
        shape = valid_s.shape
        p = true.p.reshape(*shape, 1, 3) + self._errors.dp[part, None]
        v = true.v.reshape(*shape, 1, 3) + self._errors.dv[part, None]
        yaw = true.yaw.reshape(*shape, 1)
        if self._noise_s is not None:  # so short that a straight line does: a t2 / 2 of 10 us and 4 g is 2 nm
            late_s = self._noise_s[part, None]
            p -= true.v.reshape(*shape, 1, 3) * late_s[..., None]
            v -= true.a.reshape(*shape, 1, 3) * late_s[..., None]
            yaw = yaw - true.yaw_rate.reshape(*shape, 1) * late_s
        return p, v, _attitude(self._errors.dphi[part], yaw)


def _attitude(dphi: Floats, yaw: Floats) -> Floats:
    """Return exp([dphi x]) times the turn by yaw: (k, R, 3) and (k, G, 1 or R) to (k, G, R, 3, 3)."""
    x, y, z = np.moveaxis(dphi, -1, 0)
    angle_2 = x * x + y * y + z * z
    angle = np.sqrt(angle_2)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    tilt = np.empty((*x.shape, 3, 3))
    tilt[..., 0, 0], tilt[..., 1, 1] = 1.0 - second * (y * y + z * z), 1.0 - second * (x * x + z * z)
    tilt[..., 2, 2] = 1.0 - second * (x * x + y * y)
    tilt[..., 0, 1], tilt[..., 1, 0] = second * x * y - first * z, second * x * y + first * z
    tilt[..., 0, 2], tilt[..., 2, 0] = second * x * z + first * y, second * x * z - first * y
    tilt[..., 1, 2], tilt[..., 2, 1] = second * y * z - first * x, second * y * z + first * x
    cosine, sine = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    turned = np.empty((yaw.shape[0], yaw.shape[1], dphi.shape[1], 3, 3))
    forward, right = tilt[:, None, ..., 0], tilt[:, None, ..., 1]
    turned[..., 0] = forward * cosine + right * sine
    turned[..., 1] = right * cosine - forward * sine
    turned[..., 2] = tilt[:, None, ..., 2]
    return turned


def clock_noise(seed: int, samples: int, runs: int) -> Floats:
    """Return white noise of the tags, (samples, runs), s; run r is the same whatever the number of runs."""
    lanes = [generator(seed, "flight clock noise", run).standard_normal(samples) for run in range(runs)]
    return np.stack(lanes, axis=1) * _TAG_STD_s
