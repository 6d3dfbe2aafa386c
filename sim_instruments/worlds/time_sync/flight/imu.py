"""Inertial measurement unit on a simulated flight: increments of a perfect one, and the errors of Table 2 on top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats
from sim_instruments.seeds import generator
from sim_instruments.worlds.time_sync.flight.path import (
    LATITUDE_DEG,
    STANDARD_GRAVITY_M_S2,
    FlightPath,
    PathState,
    earth_rate_rad_s,
    gravity_m_s2,
)
from sim_instruments.worlds.time_sync.stream import Numbered

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_BLOCK = 4096  # samples of one generator


@dataclass(frozen=True)
class ImuClass:
    """One-sigma figures of the paper's Table 2; biases are constant in a run.

    ``velocity_walk_ug`` in ug/sqrt(Hz), ``angle_walk_deg_rt_h`` in deg/sqrt(h): the integral of the noise over a time t
    has the standard deviation walk times sqrt(t), which is N of IEEE Std 952. A g is 9.80665 m/s2.
    """

    accel_bias_ug: float = 200.0
    velocity_walk_ug: float = 20.0
    gyro_bias_deg_h: float = 1.0
    angle_walk_deg_rt_h: float = 0.07
    rate_Hz: float = 200.0


@dataclass(frozen=True)
class ImuRuns:
    """Increments of R runs, each tagged with the end of its interval.

    ``t_s`` (n,).   ``dv`` (n, R, 3): m/s.   ``dtheta`` (n, R, 3): rad.   ``accel_bias`` (R, 3): m/s2, and
    ``gyro_bias`` (R, 3): rad/s, of what the sensors indicate minus what they feel.
    """

    t_s: Floats
    dv: Floats
    dtheta: Floats
    accel_bias: Floats
    gyro_bias: Floats


class ImuErrors:
    """Errors of one unit in one run; the noise of a sample is a function of its number.

    Args: seed, run: name the draws.   sensor: their sizes.
    """

    def __init__(self, seed: int, run: int, sensor: ImuClass | None = None) -> None:
        sensor = sensor or ImuClass()
        micro_g = 1e-6 * STANDARD_GRAVITY_M_S2
        drawn = generator(seed, "flight imu bias", run).standard_normal((2, 3))
        self.accel_bias: Floats = drawn[0] * sensor.accel_bias_ug * micro_g
        self.gyro_bias: Floats = drawn[1] * np.radians(sensor.gyro_bias_deg_h) / 3600.0
        velocity = sensor.velocity_walk_ug * micro_g / np.sqrt(sensor.rate_Hz)
        angle = np.radians(sensor.angle_walk_deg_rt_h) / 60.0 / np.sqrt(sensor.rate_Hz)
        sigma = np.repeat([velocity, angle], 3)

        def draw(rng: np.random.Generator, count: int) -> Floats:
            return rng.standard_normal((count, 6)) * sigma

        self._noise = Numbered(seed, "flight imu noise", run, draw=draw, at_once=_BLOCK)

    def noise(self, first: int, count: int) -> Floats:
        """Return white noise of increments ``first`` (from 0) on, (count, 6): m/s x, y, z, then rad x, y, z."""
        return self._noise.upto(first, first + count)


def exact_increments(path: FlightPath, t_s: Floats, latitude_deg: float = LATITUDE_DEG) -> tuple[Floats, Floats]:
    """Return increments of a perfect unit between consecutive times: the mechanisation solved for what it must be fed.

    The rate is C^T w_ie plus the yaw rate, the specific force C^T (a - g(p) + 2 w_ie x v). The angle is their integral
    in closed form, the velocity by three Gauss points per piece of path inside an interval.

    Args:    t_s: (n + 1,), ascending, s.
    Returns: dv (n, 3) m/s and dtheta (n, 3) rad: integrals in the turning body, uncorrected for its rotation.
    """
    t_s = np.asarray(t_s, float)
    cuts = np.union1d(t_s, path.borders_s(t_s[0], t_s[-1]))
    lengths = np.diff(cuts)
    middles = 0.5 * (cuts[1:] + cuts[:-1])
    state = path.state((middles + 0.5 * _NODES[:, None] * lengths).ravel())
    force = _specific_force(state, latitude_deg).reshape(3, -1, 3)
    dv = 0.5 * lengths[:, None] * np.tensordot(_WEIGHTS, force, 1)
    centre = slice(lengths.size, 2 * lengths.size)  # the second of three nodes is the middle
    dtheta = _angles(state.yaw[centre], state.yaw_rate[centre], lengths, latitude_deg)
    if cuts.size == t_s.size:
        return dv, dtheta
    begins = np.searchsorted(cuts, t_s[:-1])
    return np.add.reduceat(dv, begins, axis=0), np.add.reduceat(dtheta, begins, axis=0)


def _angles(middle_yaw: Floats, yaw_rate: Floats, lengths: Floats, latitude_deg: float) -> Floats:
    """Return integral of C^T w_ie and the yaw rate over intervals of constant yaw rate, (n, 3)."""
    earth = earth_rate_rad_s(latitude_deg)
    level = earth[0] * lengths * np.sinc(0.5 * yaw_rate * lengths / np.pi)
    return np.stack((level * np.cos(middle_yaw), -level * np.sin(middle_yaw), (earth[2] + yaw_rate) * lengths), axis=1)


def _specific_force(state: PathState, latitude_deg: float) -> Floats:
    """Return specific force along the body's axes, (n, 3), m/s2."""
    north, _, down = 2.0 * earth_rate_rad_s(latitude_deg)
    force = state.a - gravity_m_s2(state.p, latitude_deg)
    force[:, 0] -= down * state.v[:, 1]  # 2 w_ie x v of a vehicle that does not climb
    force[:, 1] += down * state.v[:, 0]
    force[:, 2] += north * state.v[:, 1]
    cosine, sine = np.cos(state.yaw), np.sin(state.yaw)
    forward, right = force[:, 0] * cosine + force[:, 1] * sine, force[:, 1] * cosine - force[:, 0] * sine
    return np.stack((forward, right, force[:, 2]), axis=1)


def imu_runs(path: FlightPath, duration_s: float, runs: int, seed: int, sensor: ImuClass | None = None) -> ImuRuns:
    """Return increments of ``runs`` units with errors of their own on the same flight from 0 s on.

    Run r is the same whatever the number of runs and the duration.
    """
    sensor = sensor or ImuClass()
    t_s = np.arange(round(duration_s * sensor.rate_Hz) + 1) / sensor.rate_Hz
    exact_dv, exact_dtheta = exact_increments(path, t_s)
    n = t_s.size - 1
    dv, dtheta = np.empty((n, runs, 3)), np.empty((n, runs, 3))
    lanes = [ImuErrors(seed, run, sensor) for run in range(runs)]
    for first in range(0, n, _BLOCK):
        part = slice(first, min(first + _BLOCK, n))
        for run, lane in enumerate(lanes):
            noise = lane.noise(first, part.stop - first)
            dv[part, run] = exact_dv[part] + lane.accel_bias / sensor.rate_Hz + noise[:, :3]
            dtheta[part, run] = exact_dtheta[part] + lane.gyro_bias / sensor.rate_Hz + noise[:, 3:]
    biases = np.array([lane.accel_bias for lane in lanes]), np.array([lane.gyro_bias for lane in lanes])
    return ImuRuns(t_s[1:], dv, dtheta, *biases)
