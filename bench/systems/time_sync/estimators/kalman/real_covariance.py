"""How far a filter really is off, when the errors of the EGI are not the white noise that it takes them for.

The gains of the filter are what they are. Its errors and those of the EGI together, 16 and 9, go through the same
linear steps, and their covariance with them: errors of position and velocity wander for tens of seconds, that of the
heading for minutes, roll and pitch stay. No draws are needed.

Source: covariance analysis of a suboptimal filter with augmented states, Gelb, Applied Optimal Estimation (1974),
section 7.2; Gauss-Markov errors, Brown and Hwang (2012), section 4.6.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.kalman.setup import STATES, EgiSpread, ImuDensities

Array = NDArray[np.float64]
_EGI = 9  # errors of the EGI: position, velocity, rotation vector


class RealCovariance:
    """Covariance (G, 25, 25) of errors of the filter and of the EGI, from the first solution on.

    Args: groups: filters.   spread: errors of the EGI.   imu: of the inertial unit.
    """

    def __init__(self, groups: int, spread: EgiSpread, imu: ImuDensities) -> None:
        heading, level = math.radians(spread.heading_deg), math.radians(spread.level_deg)
        sigma = np.array([*(spread.position_m,) * 3, *(spread.velocity_m_s,) * 3, level, level, heading])
        self._variance = sigma**2
        self._rate = np.repeat([1.0 / spread.wander_s, 0.0, 1.0 / spread.heading_wander_s], [6, 2, 1])
        self._S = np.zeros((groups, STATES + _EGI, STATES + _EGI))
        first, own = np.arange(_EGI), np.arange(STATES, STATES + _EGI)
        for rows in (first, own):  # the filter begins with a solution, and with its errors
            self._S[:, rows, first] = self._S[:, rows, own] = self._variance
        accel, gyro = imu.bias_sigmas
        self._S[:, range(9, 15), range(9, 15)] = np.repeat([accel, gyro], 3) ** 2

    def propagate(self, phi: Array, noise: Array) -> None:
        """Take the errors of the filter on; ``phi`` (G, 16, 16), ``noise`` (16,): as those of the filter itself."""
        S = self._S
        S[:, :STATES] = np.matmul(phi, S[:, :STATES])
        S[:, :, :STATES] = np.matmul(S[:, :, :STATES], phi.transpose(0, 2, 1))
        S[:, range(STATES), range(STATES)] += noise

    def wander(self, dt: float) -> None:
        """Take the errors of the EGI on from one solution to the next."""
        kept = np.exp(-self._rate * dt)
        S, own = self._S, np.arange(STATES, STATES + _EGI)
        S[:, STATES:] *= kept[:, None]
        S[:, :, STATES:] *= kept
        S[:, own, own] += self._variance * (1.0 - kept**2)

    def update(self, K: Array, H: Array) -> None:
        """Correct by a solution; ``K`` (G, 16, z), ``H`` (G, z, 16): gain and rows of the last z of 9 differences."""
        S = self._S
        change = np.concatenate((-H, np.zeros((*H.shape[:2], _EGI))), axis=2)
        change[:, range(H.shape[1]), range(STATES + _EGI - H.shape[1], STATES + _EGI)] = 1.0
        step = np.matmul(K, change)
        S[:, :STATES] += np.matmul(step, S)
        S[:, :, :STATES] += np.matmul(S, step.transpose(0, 2, 1))

    @property
    def of_filter(self) -> Array:
        """Return the covariance of the errors of the filter, (G, 16, 16)."""
        return self._S[:, :STATES, :STATES].copy()
