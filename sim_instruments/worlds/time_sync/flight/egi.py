"""Coloured errors of simulated EGIs (embedded GPS/INS), at 50 Hz, and what the EGIs of a Monte Carlo study send."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.model.arrays import Floats
from sim_instruments.seeds import generator
from sim_instruments.worlds.time_sync.flight.egi_filter import EgiClass, EgiErrorFilter
from sim_instruments.worlds.time_sync.flight.path import FlightPath

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


class EgiErrorStepper:
    """One unit sample by sample: the numbers of ``egi_error_runs`` for its run, bit for bit on the same path.

    The path may be extended between two steps from the time of the last sample on.

    Args:
        begin_s: time of the path when sample 0 is valid; 60 s of flight on the path lie behind it.
    """

    def __init__(
        self,
        path: FlightPath,
        seed: int,
        run: int = 0,
        begin_s: float = 0.0,
    ) -> None:
        self._filter = EgiErrorFilter(path, begin_s, [_lane(seed, run)], EgiClass())

    def step(self) -> tuple[Floats, Floats, Floats]:
        """Return errors of the next sample, 0 first: position (3,) m, velocity (3,) m/s, attitude (3,) rad."""
        errors = self._filter.advance(1)[0, 0]
        return errors[:3], errors[3:6], errors[6:9]

    @property
    def position_sigma_m(self) -> float:
        """Horizontal position error that the unit itself believes at the last sample: root mean of north and east."""
        covariance = self._filter.covariance
        return float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))


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
    lanes = [_lane(seed, run) for run in range(runs)]
    inner = EgiErrorFilter(path, 0.0, lanes, sensor)
    m = round(duration_s * sensor.rate_Hz) + 1
    errors = [np.empty((m, runs, 3)) for _ in range(3)]
    for first in range(0, m, sensor.rate_Hz):
        newest = inner.advance(min(sensor.rate_Hz, m - first))
        for column, kind in enumerate(errors):
            kind[first : first + sensor.rate_Hz] = newest[..., 3 * column : 3 * column + 3]
    return EgiErrors(np.arange(m) / sensor.rate_Hz, *errors)


def _lane(seed: int, run: int) -> np.random.Generator:
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
