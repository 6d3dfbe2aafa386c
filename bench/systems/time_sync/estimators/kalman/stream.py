"""Samples of both units into the filter one after the other, lanes last; what a run keeps on the way.

Source: bookkeeping, no estimate is made here; the variance of a filled sample is that of a straight line across a step.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.maths.arrays import Flags, Floats
from bench.maths.strapdown import Strapdown
from bench.systems.time_sync.estimators.kalman.innovation import NIS_DOF, EgiSample, NisSums
from bench.systems.time_sync.estimators.kalman.setup import STATES, EgiSource, FilterRun, FineTrack, ImuSource

_EGI_BLOCK = 50
_IMU_BLOCK = 400


def first_sample(egi: EgiSource, from_s: float) -> int:
    """Return the index of the first sample tagged ``from_s`` or later that all groups can use, -1 without one."""
    for k0 in range(int(np.searchsorted(egi.t_s, from_s)), egi.t_s.size, _EGI_BLOCK):
        usable = _usable(*egi.block(k0, min(k0 + _EGI_BLOCK, egi.t_s.size))).all(axis=1)
        if usable.any():
            return k0 + int(np.argmax(usable))
    return -1


def _usable(p: Floats, v: Floats, C: Floats) -> Flags:
    """(k, G): every lane of the group is there."""
    known = np.isfinite(p).all(axis=(2, 3)) & np.isfinite(v).all(axis=(2, 3))
    return np.asarray(known & np.isfinite(C).all(axis=(2, 3, 4)))


def egi_samples(egi: EgiSource, first: int) -> Iterator[EgiSample]:
    """Yield samples from ``first`` on."""
    for k0 in range(first, egi.t_s.size, _EGI_BLOCK):
        p, v, C = egi.block(k0, min(k0 + _EGI_BLOCK, egi.t_s.size))
        usable = _usable(p, v, C)
        p, v = (np.ascontiguousarray(x.transpose(0, 3, 1, 2)) for x in (p, v))
        C = np.ascontiguousarray(C.transpose(0, 3, 4, 1, 2))
        for k in range(len(p)):
            yield EgiSample(float(egi.t_s[k0 + k]), p[k], v[k], C[k], usable[k])


def block_of(t_s: Any, edges_s: Floats) -> Any:
    """Return the block between edges (b + 1,) of each tag, the first or the last for one outside."""
    return np.clip(np.searchsorted(edges_s, t_s, "right") - 1, 0, edges_s.size - 2)


def imu_steps(imu: ImuSource, first: int) -> Iterator[tuple[int, Floats, Floats, float]]:
    """Index, increments (3, 1, R) of velocity and angle, and length of each interval from ``first`` >= 1 on."""
    for j0 in range(first, imu.t_s.size, _IMU_BLOCK):
        part = slice(j0, j0 + _IMU_BLOCK)
        dv, dtheta = (np.ascontiguousarray(x[part].transpose(0, 2, 1))[:, :, None] for x in (imu.dv, imu.dtheta))
        steps = np.diff(imu.t_s[j0 - 1 : j0 + _IMU_BLOCK]).tolist()
        for k, dt in enumerate(steps):
            yield j0 + k, dv[k], dtheta[k], dt


def filled_noise(imu: ImuSource) -> Floats:
    """Sums up to each sample (n, 6) of the variances that filled samples add to velocity and attitude.

    A made-up increment is off by about half of what the sensor changed across the gap; from the means of the lanes,
    (m/s)^2 and rad^2.
    """
    added = np.zeros((imu.t_s.size, 6))
    marks = np.flatnonzero(np.diff(np.concatenate(([0], imu.filled.astype(np.int8), [0]))))
    for begin, end in zip(marks[0::2], marks[1::2], strict=True):
        before, after = max(begin - 1, 0), min(end, imu.t_s.size - 1)
        for columns, x in ((slice(0, 3), imu.dv), (slice(3, 6), imu.dtheta)):
            change = np.linalg.norm(x[after].mean(axis=0) - x[before].mean(axis=0))
            added[begin:end, columns] = (0.5 * change) ** 2 * (end - begin)
    return np.cumsum(added, axis=0)


def lanes_first(rows: Floats) -> Floats:
    """(3, G, R) or (3, 3, G, R) with the axes of space last."""
    return rows.transpose(-2, -1, *range(rows.ndim - 2))


class Keeping:
    """Room for the kept epochs.   Args: epochs: at most.   fine_t_s: (q,) IMU times of the end, may be empty."""

    def __init__(self, epochs: int, fine_t_s: Floats, groups: int, runs: int, first_covariance: Floats) -> None:
        lanes = (groups, runs)
        self._t_s, self._count = np.zeros(epochs), 0
        self._p, self._v, self._accel, self._gyro = (np.zeros((epochs, *lanes, 3)) for _ in range(4))
        self._C, self._offset = np.zeros((epochs, *lanes, 3, 3)), np.zeros((epochs, *lanes))
        self._covariance, self._first = np.zeros((epochs, groups, STATES, STATES)), first_covariance
        self._nis, self._outside, self._nis_count = (np.zeros((epochs, groups, 4)) for _ in range(3))
        self._fine_t_s, self._fine = fine_t_s, 0
        self._fine_p, self._fine_v = (np.zeros((fine_t_s.size, *lanes, 3)) for _ in range(2))
        self._fine_C = np.zeros((fine_t_s.size, *lanes, 3, 3))

    def epoch(self, t_s: float, ins: Strapdown, offset_s: Floats, P: Floats, nis: NisSums) -> None:
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
            self._t_s[k], self._p[k], self._v[k], self._C[k], self._accel[k], self._gyro[k], self._offset[k],
            self._covariance[k], self._first, self._nis[k], self._outside[k], self._nis_count[k], NIS_DOF.copy(),
            fine if self._fine_t_s.size else None,
        )  # fmt: skip
