"""Trials of a filter on the path of a recording, with errors of the size that the makers of both units state.

The covariance of the filter takes errors of the EGI for white noise, which they are not: its heading is off by nearly
the same for minutes, position and velocity wander for tens of seconds. How far an estimate is off by them is measured:
the recorded increments, smoothed, are taken for the truth; what both units would send on that path with the offset that
was found gets errors, another draw on each lane, and the filter runs again.

Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), section 6.5 (parametric bootstrap); Gauss-Markov
errors, Brown and Hwang, Introduction to Random Signals and Applied Kalman Filtering (2012), section 4.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from bench.maths.strapdown import Track, navigate
from bench.systems.time_sync.estimators.kalman.covariance import skew
from bench.systems.time_sync.estimators.kalman.redrawn import NoisyIncrements, Redrawn
from bench.systems.time_sync.estimators.kalman.setup import ImuDensities, ImuSamples

Array = NDArray[np.float64]
_SMOOTHED = 41  # samples, so that little of the recorded noise is left in what stands for the truth


@dataclass(frozen=True)
class EgiSpread:
    """Errors of an EGI, one sigma per axis.

    ``position_m``, ``velocity_m_s``: wander and return with the time constant ``wander_s``.   ``heading_deg``: does so
    with ``heading_wander_s``, for a manoeuvre shows the unit its heading while it lasts.   ``level_deg``: roll and
    pitch, constant. The defaults but the position are those of a navigation-grade unit with GPS (0.003 deg/h, 25 ug,
    paper's Table 1).
    """

    position_m: float = 0.3
    velocity_m_s: float = 0.017
    level_deg: float = 0.0013
    heading_deg: float = 0.0144
    wander_s: float = 20.0
    heading_wander_s: float = 100.0


@dataclass(frozen=True)
class Truth:
    """Stand-in for the true path: increments (n, 3) and the solution they give, at the samples of the unit."""

    dv: Array
    dtheta: Array
    track: Track


@dataclass(frozen=True)
class ImuTrials:
    """An ``ImuSource`` of increments that are drawn again when they are read."""

    t_s: Array
    dv: NoisyIncrements
    dtheta: NoisyIncrements
    filled: NDArray[np.bool_]


def stand_in(imu: ImuSamples, first: tuple[Array, Array, Array], latitude_deg: float) -> Truth:
    """Smoothed increments of a recording and the path they give.

    Args:    imu: of one lane.   first: position (3,), velocity (3,), attitude (3, 3) at its first sample.
             latitude_deg: of the origin.
    Source:  see the head of this file.
    """
    dv, dtheta = (
        ndimage.uniform_filter1d(increments[:, 0], _SMOOTHED, axis=0, mode="nearest")
        for increments in (imu.dv, imu.dtheta)
    )
    return Truth(dv, dtheta, navigate(imu.t_s, dv, dtheta, *first, latitude_deg, begin_s=float(imu.t_s[0])))


class EgiTrials:
    """An ``EgiSource`` of what an EGI would send on a path, with other errors on each lane, equal in all groups.

    Args:  t_s: (m,) time tags.   offset_s: by which samples are old.   truth: the path.   spread: of the errors.
           size: (groups, lanes).   rng: seeded.
    """

    def __init__(
        self, t_s: Array, offset_s: float, truth: Truth, spread: EgiSpread, size: tuple[int, int],
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self.t_s, track, self._groups = t_s, truth.track, size[0]
        valid_s = t_s - offset_s
        self._p, self._v, self._C = (_between(valid_s, track.t_s, values) for values in (track.p, track.v, track.C))
        steps_s = np.diff(t_s)
        self._spread = spread
        self._position, self._velocity = (_wander(steps_s, spread.wander_s, size[1], rng) for _ in range(2))
        self._turn = np.radians([spread.level_deg, spread.level_deg, 0.0]) * rng.standard_normal((size[1], 3))
        self._heading = _wander(steps_s, spread.heading_wander_s, size[1], rng)

    def block(self, k0: int, k1: int) -> tuple[Array, Array, Array]:
        """Return samples k0 to k1 - 1: (k, G, R, 3) twice, (k, G, R, 3, 3)."""
        p = self._p[k0:k1, None] + self._spread.position_m * self._position[k0:k1]
        v = self._v[k0:k1, None] + self._spread.velocity_m_s * self._velocity[k0:k1]
        dphi = np.repeat(self._turn[None], len(p), axis=0)
        dphi[..., 2] = np.radians(self._spread.heading_deg) * self._heading[k0:k1][..., 2]
        C = (np.eye(3) + skew(dphi)) @ self._C[k0:k1, None]
        return tuple(np.repeat(values[:, None], self._groups, axis=1) for values in (p, v, C))  # type: ignore[return-value]


def imu_trials(
    imu: ImuSamples, truth: Truth, densities: ImuDensities, lanes: int, rng: np.random.Generator
) -> ImuTrials:
    """Increments of the path with noise and constant biases, others on each lane.

    Args:    imu: the recording, for times and lost samples.   truth: the path.   densities: of the errors.
             lanes: how many.   rng: seeded.
    Returns: an ``ImuSource`` of as many lanes.
    Source:  see the head of this file.
    """
    interval_s = float(np.median(np.diff(imu.t_s)))
    bias_m_s2, bias_rad_s = densities.bias_sigmas
    out = []
    for column, walk, bias in (
        (truth.dv, densities.velocity_walk, bias_m_s2), (truth.dtheta, densities.angle_walk, bias_rad_s),
    ):  # fmt: skip
        noise = Redrawn(len(column), lanes, rng)
        constant = bias * interval_s * rng.standard_normal((lanes, 3))
        out.append(NoisyIncrements(column, constant, noise, walk * math.sqrt(interval_s)))
    return ImuTrials(imu.t_s, out[0], out[1], imu.filled)


def _between(at_s: Array, t_s: Array, values: Array) -> Array:
    """Return values (n, ...) at other times by lines between them; NaN before the first and behind the last."""
    flat = values.reshape(len(values), -1)
    columns = np.stack([np.interp(at_s, t_s, column, np.nan, np.nan) for column in flat.T], axis=1)
    return columns.reshape(at_s.size, *values.shape[1:])


def _wander(steps_s: Array, time_s: float, lanes: int, rng: np.random.Generator) -> Redrawn:
    """Gauss-Markov errors of unit variance, (m, lanes, 3)."""
    return Redrawn(steps_s.size + 1, lanes, rng, np.exp(-np.maximum(steps_s, 0.0) / time_s))
