"""The angle of a dithered ring laser as its electronics have it: a count, latched where the dither angle is zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.systems.lock_in.estimators.edges import EdgeLevels
from bench.systems.lock_in.estimators.motion import solve_rows
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, half_period_ticks

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]

_ROUND = 4  # edges on each side of the pick-off's


@dataclass(frozen=True)
class CycleIncrements:
    """Net phase of each dither period, mean of the one from rising to rising and the one from falling to falling zero.

    ``increment_rad`` (c,), NaN where a turnaround in it is not usable or events are lost; ``interval_s``: the mean
    period; ``start`` (c,): the rising pick-off edge at which each begins.
    """

    increment_rad: Array
    interval_s: float
    start: Int64


def net_angle(edges: EdgeLevels, pickoff_tick: Int64) -> Array:
    """Phase at the edges of the pick-off: the latched count, and what the edges round it say of the rest of a turn.

    Two pieces of the dither's motion that meet at the pick-off's edge are put through the 4 edges before and the 4
    behind it: the amplitude may change there, and a straight line from edge to edge would then be off by up to 0.05
    rad. The quantisation of the ticks is in it: that of the pick-off's own time stamp, times the rate, is the most.

    Args:    edges: of the beat.   pickoff_tick: (n,), edges of the pick-off, rising and falling.
    Returns: (n,), rad; NaN where there are not enough edges, and at the first pick-off behind a break, for the step to
             it is not known.
    Raises:  FitError B-FIT-096 if the pick-off does not tell the dither's period.
    Source:  latched count with interpolation; the sign of the phase is that of ``EdgeLevels.direction``.
    """
    pickoff = np.asarray(pickoff_tick, np.int64)
    omega = np.pi / half_period_ticks(pickoff)
    first = np.searchsorted(edges.tick, pickoff, side="right") - _ROUND
    inside = (first >= 0) & (first + 2 * _ROUND <= edges.tick.size)
    index = np.where(inside, first, 0)[:, None] + np.arange(2 * _ROUND)
    index = np.minimum(index, edges.tick.size - 1)
    count = edges.level[index[:, _ROUND - 1]]
    motion = np.sin(omega * (edges.tick[index] - pickoff[:, None])) / omega
    before = np.arange(2 * _ROUND) < _ROUND
    design = np.stack((np.ones_like(motion), motion * before, motion * ~before), axis=-1)
    psi = np.full(pickoff.size, np.nan)
    turned = np.asarray(np.pi * (edges.level[index] - count[:, None]), np.float64)
    solved = solve_rows(design[inside], turned[inside])[0]
    psi[inside] = np.pi * count[inside] + solved[:, 0]
    torn = np.searchsorted(pickoff, edges.tick[edges.breaks])
    psi[torn[torn < psi.size]] = np.nan
    return psi


def cycle_increments(
    psi_rad: Array, pickoff_rising: ArrayLike, turns: Turnarounds, jumps: Jumps | None = None
) -> CycleIncrements:
    """Net phase of each dither period, less what a compensator says that lock-in added.

    Both senses of the pick-off are used: an error of its time stamp, times the rate, has the other sign in the other
    sense and drops out of the mean. One sense alone keeps the step of a tick each time the dither's period has slid by
    one against the clock: at 20 MHz, 28 cm and 0.1 ppm it makes a walk of 0.13 of that of lock-in.

    Args:    psi_rad: of ``net_angle``, (n + 1,).   pickoff_rising: (n + 1,).   turns: of the same pick-off.
             jumps: of a compensator; None leaves the lock-in errors in.
    Returns: CycleIncrements.
    Source:  lock-in paper (9) and figure 11: the error is taken off at each turnaround.
    """
    upward = np.asarray(pickoff_rising, bool)
    start = np.flatnonzero(upward[:-3])
    step = np.where(turns.regular, np.diff(psi_rad), np.nan)
    if jumps is not None:
        step = step - jumps.dpsi_rad
    increment = (step[start] + step[start + 2]) / 2.0 + step[start + 1]
    return CycleIncrements(increment, float(2.0 * np.pi / turns.omega_rad_s), start)
