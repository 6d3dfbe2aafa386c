"""What a run of the filter keeps: every so many EGI samples, and every IMU sample of the end.

Source: bookkeeping only; no estimate is made here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.maths.strapdown import Strapdown
from bench.systems.time_sync.estimators.kalman.innovation import NIS_DOF, NisSums
from bench.systems.time_sync.estimators.kalman.setup import STATES, FilterRun, FineTrack

Array = NDArray[np.float64]


def lanes_first(rows: Array) -> Array:
    """(3, G, R) or (3, 3, G, R) with the axes of space last."""
    return np.moveaxis(rows, (-2, -1), (0, 1))


class Keeping:
    """Room for the kept epochs.   Args: epochs: at most.   fine_t_s: (q,) IMU times of the end, may be empty."""

    def __init__(self, epochs: int, fine_t_s: Array, groups: int, runs: int, first_covariance: Array) -> None:
        lanes = (groups, runs)
        self._t_s, self._count = np.zeros(epochs), 0
        self._p, self._v, self._accel, self._gyro = (np.zeros((epochs, *lanes, 3)) for _ in range(4))
        self._C, self._offset = np.zeros((epochs, *lanes, 3, 3)), np.zeros((epochs, *lanes))
        self._covariance, self._first = np.zeros((epochs, groups, STATES, STATES)), first_covariance
        self._nis, self._outside, self._nis_count = (np.zeros((epochs, groups, 4)) for _ in range(3))
        self._fine_t_s, self._fine = fine_t_s, 0
        self._fine_p, self._fine_v = (np.zeros((fine_t_s.size, *lanes, 3)) for _ in range(2))
        self._fine_C = np.zeros((fine_t_s.size, *lanes, 3, 3))

    def epoch(self, t_s: float, ins: Strapdown, offset_s: Array, P: Array, nis: NisSums) -> None:
        """Keep the state after a correction."""
        k, self._count = self._count, self._count + 1
        self._t_s[k], self._offset[k], self._covariance[k] = t_s, offset_s, P
        self._p[k], self._v[k], self._C[k] = (lanes_first(x) for x in (ins.p, ins.v, ins.C))
        self._accel[k], self._gyro[k] = lanes_first(ins.bias_v), lanes_first(ins.bias_theta)
        self._nis[k], self._outside[k], self._nis_count[k] = nis.take()

    def fine(self, ins: Strapdown) -> None:
        """Keep the state after an IMU sample of the end."""
        k, self._fine = self._fine, self._fine + 1
        self._fine_p[k], self._fine_v[k], self._fine_C[k] = (lanes_first(x) for x in (ins.p, ins.v, ins.C))

    def result(self) -> FilterRun:
        """Return what was kept."""
        k, q = slice(self._count), slice(self._fine)
        fine = FineTrack(self._fine_t_s[q], self._fine_p[q], self._fine_v[q], self._fine_C[q])
        return FilterRun(
            self._t_s[k],
            self._p[k],
            self._v[k],
            self._C[k],
            self._accel[k],
            self._gyro[k],
            self._offset[k],
            self._covariance[k],
            self._first,
            self._nis[k],
            self._outside[k],
            self._nis_count[k],
            NIS_DOF.copy(),
            fine if self._fine_t_s.size else None,
        )
