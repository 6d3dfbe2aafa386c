"""Innovation of the filter: prediction of an EGI sample from the filter's own past states, and its normalised square.

A correction changes the state of now. A sample of the EGI speaks of some time ago, so what is held against it must
carry the corrections made in between; each stored state therefore keeps the sum of the corrections at its time.

Source: Lee et al. 2020, equations (7)-(13), with the prediction at t - T_hat taken from the filter's states (what the
paper prints as the measurement), errors as estimate minus truth.   Larsen et al., Incorporation of time delayed
measurements in a discrete-time Kalman filter, CDC 1998: delayed measurements by the stored states of then, with the
correction since carried over by the error model.   Bar-Shalom, Li and Kirubarajan, Estimation with applications to
tracking and navigation, 2001, section 5.4: normalised innovation squared.

Consistency and observability: whether a filter knows its errors, and how much it was told about each state.

Normalised errors and innovations of a consistent filter follow chi-square; the mean over N runs times N has N times the
degrees of freedom.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with applications to tracking and navigation, 2001, section 5.4.

Samples of both units into the filter one after the other, lanes last; what a run keeps on the way.

Source: bookkeeping, no estimate is made here; the variance of a filled sample is that of a straight line across a step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.maths.arrays import Flags, Floats
from bench.systems.time_sync.estimators.kalman.setup import (
    OFFSET,
    EgiSource,
    FilterRun,
    ImuDensities,
    ImuSamples,
)

_SUMS = 15  # position, velocity, matrix; behind them the sums of corrections: of position at time 0, velocity, rotation
_ROWS = 24
_SPAN = 4  # intervals over which acceleration and rate are taken: one EGI interval
NIS_DOF = np.array([9.0, 3.0, 3.0, 3.0])  # all, position, velocity, attitude
# 2.5 % and 97.5 % points of chi-square with 9 and 3 degrees of freedom
NIS_BOUNDS = np.array([[2.700389, 19.022768], [0.215795, 9.348404], [0.215795, 9.348404], [0.215795, 9.348404]])
_DOUBT = 4.0  # a motion counts as seen where its square is above this many times that of its noise


@dataclass(frozen=True)
class Past:
    """Navigation states at times of the past, lanes last; corrections up to now included but for ``turned``.

    ``p``, ``v`` (3, G, R), ``C`` (3, 3, G, R); ``turned`` (3, G, R): rotation vector in t by which C still is to be
    corrected, rad.   ``acceleration`` m/s^2, ``rate`` rad/s in t against t: (3, G), means of the groups, without the
    steps of corrections.   ``age_s`` (G,): mean.
    """

    p: Floats
    v: Floats
    C: Floats
    turned: Floats
    acceleration: Floats
    rate: Floats
    age_s: Floats


class History:
    """Ring of the last states.

    Args: t_s: (n,) of all IMU samples.   reach_s: how far back it must go.   groups, runs: lanes.
    """

    def __init__(self, t_s: Floats, reach_s: float, groups: int, runs: int) -> None:
        interval_s = float(np.median(np.diff(t_s)))
        self._t_s, self._size = t_s, int(np.ceil(reach_s / interval_s)) + _SPAN + 2
        self._lanes = (groups, runs)
        self._ring = np.zeros((self._size, _ROWS, groups, runs))
        self._column = np.arange(_ROWS * groups * runs).reshape(_ROWS, -1)
        self._sums = np.zeros((9, groups, runs))
        self._first = self._newest = -1

    def store(self, j: int, state: Floats) -> None:
        """State (15, G, R) right after IMU sample ``j``."""
        row = self._ring[j % self._size]
        row[:_SUMS], row[_SUMS:] = state, self._sums
        self._newest = j
        if self._first < 0:
            self._first = j

    def correct(self, dx: Floats, state: Floats) -> None:
        """The newest state has become ``state`` by taking errors (9, G, R) of position, velocity and rotation off.

        A position of time s is off by that of now less the way that the error in velocity makes in between: dp - (now
        - s) dv. The sum of dp - now dv is kept, and s times the sum of dv added on reading.
        """
        self._sums -= dx
        self._sums[:3] += self._t_s[self._newest] * dx[3:6]
        self.store(self._newest, state)

    def read(self, s_s: Floats) -> Past:
        """Return states at times ``s_s`` (G, R) of the IMU; beyond the stored ones they are carried on straight."""
        oldest = max(self._first, self._newest - self._size + 1)
        s = s_s.ravel()
        before = np.clip(np.searchsorted(self._t_s, s) - 1, oldest, self._newest - 1)
        earlier = np.maximum(before + 1 - _SPAN, oldest)
        a, b = self._take(before), self._take(before + 1)
        step_s = self._t_s[before + 1] - self._t_s[before]
        part = (s - self._t_s[before]) / step_s
        b -= a
        bend = (0.5 * step_s * part * (part - 1.0)) * (b[3:6] - b[18:21])
        acceleration, rate = self._changes(earlier, before + 1)
        b *= part
        a += b
        age_s = self._t_s[self._newest] - s
        due = self._sums.reshape(9, -1) - a[_SUMS:]
        p = a[:3] + bend
        p += due[:3]
        p += s * due[3:6]
        return Past(
            p.reshape(3, *self._lanes),
            (a[3:6] + due[3:6]).reshape(3, *self._lanes),
            a[6:15].reshape(3, 3, *self._lanes),
            due[6:].reshape(3, *self._lanes),
            acceleration,
            rate,
            age_s.reshape(self._lanes).mean(axis=-1),
        )

    def _take(self, j: NDArray[np.intp]) -> Floats:
        flat = (j % self._size) * self._column.size + self._column
        return self._ring.take(flat)

    def _changes(self, j0: NDArray[np.intp], j1: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Mean acceleration and rate (3, G) of the groups between two samples of each lane, without corrections."""
        groups, runs = self._lanes
        begin = self._take(j0).reshape(_ROWS, groups, runs).mean(axis=-1)
        end = self._take(j1).reshape(_ROWS, groups, runs).mean(axis=-1)
        span_s = (self._t_s[j1] - self._t_s[j0]).reshape(groups, runs).mean(axis=-1)
        change = (end - begin) / span_s
        turn = rotation_between(end[6:15].reshape(3, 3, groups), begin[6:15].reshape(3, 3, groups))
        return change[3:6] - change[18:21], turn / span_s - change[21:24]


def rotation_between(a: Floats, b: Floats) -> Floats:
    """Vector of the sine of the rotation a b^T, for (3, 3, ...) matrices of angles of some degrees: (3, ...)."""
    out = np.empty(a.shape[1:])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = 0.5 * np.add.reduce(b[j] * a[k] - b[k] * a[j], axis=0)
    return out


class EgiSample(NamedTuple):
    """One sample: tag, position and velocity (3, G, R), matrix (3, 3, G, R), and which groups can use it (G,); G and R
    may be 1: the same for all.
    """

    t_s: float
    p: Floats
    v: Floats
    C: Floats
    usable: Flags


def predicted_at(t_s: float, offset_s: Floats) -> Floats:
    """Return time of which a sample tagged ``t_s`` speaks, by the present estimate of the offset (G, R)."""
    return t_s - offset_s


def innovation(
    sample: EgiSample, offset_s: Floats, history: History, motion_noise: Floats
) -> tuple[Floats, Past, Floats]:
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


def motion_noise(imu: ImuDensities, interval_s: float, runs: int) -> Floats:
    """Mean square of the noise of acceleration and rate (2,), taken over four intervals and ``runs`` lanes."""
    return np.array([imu.velocity_walk**2, imu.angle_walk**2]) * (3.0 / (4.0 * interval_s * runs))


def _seen(motions: Floats, noise: Floats) -> Floats:
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

    def add(self, dz: Floats, S: Floats, usable: Flags) -> None:
        """Innovations (G, z, R) with their covariance (G, z, z); z = 9, or 3 where only the attitude is used."""
        runs = dz.shape[2]
        if dz.shape[1] == 9:
            blocks = np.stack([S[:, i : i + 3, i : i + 3] for i in (0, 3, 6)], axis=1)
            parts = dz.reshape(-1, 3, 3, runs)
            self._note(slice(0, 1), dz[:, None], S[:, None], usable)
            self._note(slice(1, 4), parts, blocks, usable)
        else:
            self._note(slice(3, 4), dz[:, None], S[:, None], usable)

    def _note(self, where: slice, dz: Floats, S: Floats, usable: Flags) -> None:
        square = np.add.reduce(dz * np.matmul(np.linalg.inv(S), dz), axis=2)  # (G, blocks, R)
        bounds = NIS_BOUNDS[where]
        outside = (square < bounds[:, :1]) | (square > bounds[:, 1:])
        self._sum[:, where] += square.sum(axis=-1) * usable[:, None]
        self._outside[:, where] += outside.sum(axis=-1) * usable[:, None]
        self._count[:, where] += dz.shape[-1] * usable[:, None]

    def take(self) -> tuple[Floats, Floats, Floats]:
        """Return mean, share outside the 95 % interval and count, (G, 4) each; begins anew."""
        count = self._count.copy()
        known = np.where(count > 0.0, count, np.nan)
        mean, share = self._sum / known, self._outside / known
        for sums in (self._sum, self._outside, self._count):
            sums[:] = 0.0
        return mean, share, count


@dataclass(frozen=True)
class NisSummary:
    """Innovations of a whole run, (G, 4) by NIS_BLOCKS: ``ratio`` mean over degrees of freedom, 1 if consistent, above
    1 if the filter expects too little; ``outside`` share outside the 95 % interval, 0.05 if consistent and white;
    ``count`` how many.  NaN where there was none.
    """

    ratio: Floats
    outside: Floats
    count: Floats


def nis_summary(run: FilterRun, from_s: float = -np.inf) -> NisSummary:
    """Innovations of the epochs from ``from_s`` on taken together.

    Source: see the head of this file.
    """
    late = run.t_s >= from_s
    count = run.nis_count[late]
    total = count.sum(axis=0)
    known = np.where(total > 0.0, total, np.nan)
    ratio = np.nansum(run.nis[late] * count, axis=0) / known / NIS_DOF
    return NisSummary(ratio, np.nansum(run.nis_outside[late] * count, axis=0) / known, total)


def state_errors(
    run: FilterRun, p: Floats, v: Floats, C: Floats, accel_bias: Floats, gyro_bias: Floats, offset_s: Floats
) -> Floats:
    """Errors of all states, estimate minus reference, where a reference is known.

    Args:    p m, v m/s: (m, 3) and C (m, 3, 3) body to t at the kept epochs.   accel_bias m/s^2, gyro_bias rad/s:
             (R, 3).   offset_s: (G,).
    Returns: (m, G, R, 16) in the order of the covariance; attitude as rotation vector in t, rad.
    """
    estimate, reference = np.moveaxis(run.C, (-2, -1), (0, 1)), np.moveaxis(C, (-2, -1), (0, 1))[..., None, None]
    parts = (
        run.p - p[:, None, None],
        run.v - v[:, None, None],
        np.moveaxis(rotation_between(estimate, np.broadcast_to(reference, estimate.shape)), 0, -1),
        run.accel_bias - accel_bias,
        run.gyro_bias - gyro_bias,
        (run.offset_s - offset_s[:, None])[..., None],
    )
    return np.concatenate(parts, axis=-1)


def nees_of_offset(errors_s: Floats, covariance: Floats) -> Floats:
    """Return the normalised squared error of the offset, one degree of freedom each.

    ``errors_s`` (..., R), ``covariance`` (..., 16, 16).
    NaN where the offset is not a state.
    """
    variance = covariance[..., OFFSET, OFFSET][..., None]
    return errors_s**2 / np.where(variance > 0.0, variance, np.nan)


@dataclass(frozen=True)
class Observability:
    """``associated`` (m, G): the eigenvalue of the offset.   ``component`` (m, G): of
    the offset in its eigenvector, 0 to 1; near 0.7 two directions share it.   ``offset_variance`` (m, G): P'_TdTd.
    NaN in groups where the offset is not a state.
    """

    associated: Floats
    component: Floats
    offset_variance: Floats


def observability(covariance: Floats, first: Floats) -> Observability:
    """Normalise covariances by the first one and take them apart.

    An eigenvalue near 1 belongs to a direction nothing is known of beyond what was known at the begin, near 0 to a well
    observed one. The eigenvalue "associated" with the time offset is the one whose eigenvector has the largest
    component of the offset. That association is a convention with a trap: in level flight position and offset are seen
    only as p - v T_d. Where the first position uncertainty is below v times that of the offset (1 m against 3 m at
    100 m/s and 30 ms) the largest component of the offset is in that well-seen direction, and the eigenvalue is small
    for any manoeuvre although nothing is known of the offset. With 10 m it is in the other one. The normalised variance
    of the offset itself, ``offset_variance``, has no such trap; look at both, and at ``component``.

    Args:    covariance: (m, G, 16, 16).   first: (G, 16, 16), diagonal.
    Source:  Ham and Brown, Observability, eigenvalues and Kalman filtering, IEEE Trans. AES 19(2), 1983; Lee et al.
             2020, equation (14), P' = P0^-1/2 P P0^-1/2 with the symmetric root of a diagonal P0.
    """
    root = np.sqrt(np.diagonal(first, axis1=-2, axis2=-1))
    state = root[:, OFFSET] > 0.0
    scale = np.where(root > 0.0, root, 1.0)
    values, vectors = np.linalg.eigh(covariance / (scale[:, :, None] * scale[:, None, :]))
    sizes = np.abs(vectors[..., OFFSET, :])
    which = np.argmax(sizes, axis=-1)[..., None]
    associated = np.take_along_axis(values, which, axis=-1)[..., 0]
    component = np.take_along_axis(sizes, which, axis=-1)[..., 0]
    variance = covariance[..., OFFSET, OFFSET] / scale[:, OFFSET] ** 2
    associated[:, ~state], component[:, ~state], variance[:, ~state] = (np.nan,) * 3
    return Observability(associated, component, variance)


_EGI_BLOCK = 50


def _usable(p: Floats, v: Floats, C: Floats) -> Flags:
    """(k, G): every lane of the group is there."""
    known = np.isfinite(p).all(axis=(2, 3)) & np.isfinite(v).all(axis=(2, 3))
    return np.asarray(known & np.isfinite(C).all(axis=(2, 3, 4)))


def egi_samples(egi: EgiSource, first: int) -> Iterator[EgiSample]:
    """Yield samples from ``first`` on."""
    for k0 in range(first, egi.t_s.size, _EGI_BLOCK):
        p, v, C = egi.block(k0, k0 + _EGI_BLOCK)
        lanes_last = np.moveaxis(p, -1, 1), np.moveaxis(v, -1, 1), np.moveaxis(C, (-2, -1), (1, 2))
        tags_s = egi.t_s[k0 : k0 + _EGI_BLOCK].tolist()
        yield from map(EgiSample, tags_s, *lanes_last, _usable(p, v, C))


def block_of(t_s: Any, edges_s: Floats) -> Any:
    """Return the block between edges (b + 1,) of each tag, the first or the last for one outside."""
    return np.clip(np.searchsorted(edges_s, t_s, "right") - 1, 0, edges_s.size - 2)


def filled_noise(imu: ImuSamples) -> Floats:
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
