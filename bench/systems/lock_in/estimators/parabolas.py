"""Lock-in error of each dither turnaround from one parabola before it and one behind it, as published.

It neglects the ripple that lock-in leaves on the crossings near the turnaround: unless the backscatter phase is near
90 degrees it finds errors larger than those that there are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.lock_in.estimators.motion import rms, solve_rows
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, spread

Array = NDArray[np.float64]


def parabolas(turns: Turnarounds, crossings: int = 4) -> Jumps:
    """Return two parabolas, carried on to the instant midway between their vertices; their difference is the jump.

    Args:    turns: at least that many crossings a side.   crossings: on each side, 3 or 4.
    Returns: Jumps, method "parabolas".
    Source:  lock-in paper equations (7) to (9); Lim, EP 0103080 A2 (1982).
    """
    time_s, phase = turns.inner(crossings)
    before, left = _parabola(time_s[:, :crossings], phase[:, :crossings])
    behind, right = _parabola(time_s[:, crossings:], phase[:, crossings:])
    zero = (_vertex(before) + _vertex(behind)) / 2.0
    at_before, at_behind = _value(before, zero), _value(behind, zero)
    found = (
        at_behind - at_before,
        (at_before + at_behind) / 2.0,
        np.abs(before[:, 2] + behind[:, 2]),
        zero,
        rms(np.column_stack((left, right))),
    )
    return Jumps("parabolas", *(spread(turns.usable, column) for column in found))


def _parabola(time_s: Array, phase: Array) -> tuple[Array, Array]:
    """Return coefficients (u, 3) and residuals of one side."""
    return solve_rows(np.stack((np.ones_like(time_s), time_s, time_s**2), axis=-1), phase)


def _vertex(coefficients: Array) -> Array:
    return np.asarray(-coefficients[:, 1] / (2.0 * coefficients[:, 2]))


def _value(coefficients: Array, time_s: Array) -> Array:
    return np.asarray(coefficients[:, 0] + time_s * (coefficients[:, 1] + time_s * coefficients[:, 2]))
