"""Innovation of the filter: prediction of an EGI sample from the filter's own states, and its normalised square.

Source: Lee et al. 2020, equations (7)-(13), with the prediction at t - T_hat taken from the filter's states (what the
paper prints as the measurement), errors as estimate minus truth.   Bar-Shalom, Li and Kirubarajan, Estimation with
applications to tracking and navigation, 2001, section 5.4: normalised innovation squared.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.kalman.history import History, Past, rotation_between
from bench.systems.time_sync.estimators.kalman.setup import ImuDensities

Array = NDArray[np.float64]

NIS_DOF = np.array([9.0, 3.0, 3.0, 3.0])  # all, position, velocity, attitude
# 2.5 % and 97.5 % points of chi-square with 9 and 3 degrees of freedom
NIS_BOUNDS = np.array([[2.700389, 19.022768], [0.215795, 9.348404], [0.215795, 9.348404], [0.215795, 9.348404]])
_DOUBT = 4.0  # a motion counts as seen where its square is above this many times that of its noise


class EgiSample(NamedTuple):
    """One sample: tag, position and velocity (3, G, R), matrix (3, 3, G, R), and which groups can use it (G,)."""

    t_s: float
    p: Array
    v: Array
    C: Array
    usable: NDArray[np.bool_]


def predicted_at(t_s: float, offset_s: Array) -> Array:
    """Return time of which a sample tagged ``t_s`` speaks, by the present estimate of the offset (G, R)."""
    return t_s - offset_s


def innovation(sample: EgiSample, offset_s: Array, history: History, motion_noise: Array) -> tuple[Array, Past, Array]:
    """Prediction minus sample, and how it depends on the offset.

    Args:    offset_s: (G, R) present estimates.   motion_noise: see ``motion_noise``.
    Returns: innovation (G, 9, R) in m, m/s, rad; the states it was taken from; sensitivity (G, 9): velocity,
             acceleration, rate at that time, means of the groups.
    """
    past = history.read(predicted_at(sample.t_s, offset_s))
    turned = rotation_between(past.C, sample.C) + past.turned
    dz = np.concatenate((past.p - sample.p, past.v - sample.v, turned))
    motions = np.stack((past.v.mean(axis=-1), past.acceleration, past.rate))
    motions[1:] *= _seen(motions[1:], motion_noise)
    return np.ascontiguousarray(dz.transpose(1, 0, 2)), past, motions.transpose(2, 0, 1).reshape(-1, 9)


def motion_noise(imu: ImuDensities, interval_s: float, runs: int) -> Array:
    """Mean square of the noise of acceleration and rate (2,), taken over four intervals and ``runs`` lanes."""
    return np.array([imu.velocity_walk**2, imu.angle_walk**2]) * (3.0 / (4.0 * interval_s * runs))


def _seen(motions: Array, noise: Array) -> Array:
    """Factor (2, 1, G) that takes out of a measured motion what may be noise.

    Where nothing moves the measured rate is noise, and a filter that believes it draws knowledge about the offset from
    it: with one lane and a tight attitude the uncertainty of an unobservable offset would fall by a third in 20 s.
    """
    square = np.add.reduce(motions**2, axis=1, keepdims=True)
    doubt = _DOUBT * noise[:, None, None]
    return np.where(square > doubt, 1.0 - doubt / np.maximum(square, doubt), 0.0)


class NisSums:
    """Normalised innovations squared since the epoch kept before."""

    def __init__(self, groups: int) -> None:
        self._sum, self._outside, self._count = (np.zeros((groups, 4)) for _ in range(3))

    def add(self, dz: Array, S: Array, usable: NDArray[np.bool_]) -> None:
        """Innovations (G, z, R) with their covariance (G, z, z); z = 9, or 3 where only the attitude is used."""
        runs = dz.shape[2]
        if dz.shape[1] == 9:
            blocks = np.stack([S[:, i : i + 3, i : i + 3] for i in (0, 3, 6)], axis=1)
            parts = dz.reshape(-1, 3, 3, runs)
            self._note(slice(0, 1), dz[:, None], S[:, None], usable)
            self._note(slice(1, 4), parts, blocks, usable)
        else:
            self._note(slice(3, 4), dz[:, None], S[:, None], usable)

    def _note(self, where: slice, dz: Array, S: Array, usable: NDArray[np.bool_]) -> None:
        square = np.add.reduce(dz * np.matmul(np.linalg.inv(S), dz), axis=2)  # (G, blocks, R)
        bounds = NIS_BOUNDS[where]
        outside = (square < bounds[:, :1]) | (square > bounds[:, 1:])
        self._sum[:, where] += square.sum(axis=-1) * usable[:, None]
        self._outside[:, where] += outside.sum(axis=-1) * usable[:, None]
        self._count[:, where] += dz.shape[-1] * usable[:, None]

    def take(self) -> tuple[Array, Array, Array]:
        """Return mean, share outside the 95 % interval and count, (G, 4) each; begins anew."""
        count = self._count.copy()
        known = np.where(count > 0.0, count, np.nan)
        mean, share = self._sum / known, self._outside / known
        for sums in (self._sum, self._outside, self._count):
            sums[:] = 0.0
        return mean, share, count
