"""The last navigation states, read at any time in between and as if all corrections since had been made before.

A correction changes the state of now. A sample of the EGI speaks of some time ago, so what is held against it must
carry the corrections made in between; each stored state therefore keeps the sum of the corrections at its time.

Source: delayed measurements in a filter, by the stored states of then (Larsen et al., Incorporation of time delayed
measurements in a discrete-time Kalman filter, CDC 1998), with the correction since carried over by the error model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SUMS = 15  # position, velocity, matrix; behind them the sums of corrections: of position at time 0, velocity, rotation
_ROWS = 24
_SPAN = 4  # intervals over which acceleration and rate are taken: one EGI interval


@dataclass(frozen=True)
class Past:
    """Navigation states at times of the past, lanes last; corrections up to now included but for ``turned``.

    ``p``, ``v`` (3, G, R), ``C`` (3, 3, G, R); ``turned`` (3, G, R): rotation vector in t by which C still is to be
    corrected, rad.   ``acceleration`` m/s^2, ``rate`` rad/s in t against t: (3, G), means of the groups, without the
    steps of corrections.   ``age_s`` (G,): mean.
    """

    p: Array
    v: Array
    C: Array
    turned: Array
    acceleration: Array
    rate: Array
    age_s: Array


class History:
    """Ring of the last states.

    Args: t_s: (n,) of all IMU samples.   reach_s: how far back it must go.   groups, runs: lanes.
    """

    def __init__(self, t_s: Array, reach_s: float, groups: int, runs: int) -> None:
        interval_s = float(np.median(np.diff(t_s)))
        self._t_s, self._size = t_s, int(np.ceil(reach_s / interval_s)) + _SPAN + 2
        self._lanes = (groups, runs)
        self._ring = np.zeros((self._size, _ROWS, groups, runs))
        self._column = np.arange(_ROWS * groups * runs).reshape(_ROWS, -1)
        self._sums = np.zeros((9, groups, runs))
        self._first = self._newest = -1

    def store(self, j: int, state: Array) -> None:
        """State (15, G, R) right after IMU sample ``j``."""
        row = self._ring[j % self._size]
        row[:_SUMS], row[_SUMS:] = state, self._sums
        self._newest = j
        if self._first < 0:
            self._first = j

    def correct(self, dx: Array, state: Array) -> None:
        """The newest state has become ``state`` by taking errors (9, G, R) of position, velocity and rotation off.

        A position of time s is off by that of now less the way that the error in velocity makes in between: dp - (now
        - s) dv. The sum of dp - now dv is kept, and s times the sum of dv added on reading.
        """
        self._sums -= dx
        self._sums[:3] += self._t_s[self._newest] * dx[3:6]
        self.store(self._newest, state)

    def read(self, s_s: Array) -> Past:
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

    def _take(self, j: NDArray[np.intp]) -> Array:
        flat = (j % self._size) * self._column.size + self._column
        return np.asarray(self._ring.take(flat))

    def _changes(self, j0: NDArray[np.intp], j1: NDArray[np.intp]) -> tuple[Array, Array]:
        """Mean acceleration and rate (3, G) of the groups between two samples of each lane, without corrections."""
        groups, runs = self._lanes
        begin = self._take(j0).reshape(_ROWS, groups, runs).mean(axis=-1)
        end = self._take(j1).reshape(_ROWS, groups, runs).mean(axis=-1)
        span_s = (self._t_s[j1] - self._t_s[j0]).reshape(groups, runs).mean(axis=-1)
        change = (end - begin) / span_s
        turn = rotation_between(end[6:15].reshape(3, 3, groups), begin[6:15].reshape(3, 3, groups))
        return change[3:6] - change[18:21], turn / span_s - change[21:24]


def rotation_between(a: Array, b: Array) -> Array:
    """Vector of the sine of the rotation a b^T, for (3, 3, ...) matrices of angles of some degrees: (3, ...)."""
    out = np.empty(a.shape[1:])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = 0.5 * np.add.reduce(b[j] * a[k] - b[k] * a[j], axis=0)
    return out
