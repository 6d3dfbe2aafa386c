"""Predicts what a compensator of single turnarounds leaves, by its own fit at those of a declared laser.

What the lock-in leaves of its ripple in such a fit goes with the phase at the turnaround, which the dither's scatter
makes any; that, the steps of the clock and the random walk between the crossings are the walk behind it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.systems.lock_in.estimators.expected_constants import NominalLaser, covariance_of_walk, expected_turnarounds
from bench.systems.lock_in.estimators.motion import lock_in_shapes
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds

Array = NDArray[np.float64]
_ROUNDS = 4  # in which lock-in moves the crossings to where they are
_SMALL_rad = 1e-5  # of one crossing, to see how the jump goes with it


@dataclass(frozen=True)
class ExpectedOutput:
    """``walk_rad_rt_s``: random walk of an output, of phase.   ``shared``: squared correlation with that of lock-in and
    random walk before compensation.
    """

    walk_rad_rt_s: float
    shared: float


def expected_output(laser: NominalLaser, compensator: Callable[[Turnarounds], Jumps]) -> ExpectedOutput:
    """Return what is behind a compensator on average over the phases at which the dither turns round.

    Args:    laser: with its dither.   compensator: of ``single_turnarounds``.
    Raises:  FitError B-FIT-097 if the dither has not 16 crossings on each side of a turnaround.
    Source:  first order of the compensator at each crossing; variance of a step of the clock, tick^2 / 12; covariance
             of a random walk. Jumps of turnarounds are independent where the dither scatters.
    """
    turns, jump = _turns(laser)
    found = compensator(turns).dpsi_rad
    slopes = np.stack([_slope(turns, compensator, found, k) for k in range(turns.time_s.shape[1])], axis=-1)
    own, half_s = laser.walk_rad_rt_s**2, math.pi / laser.omega_rad_s
    seen = own * float(np.mean(np.sum(slopes * turns.time_s, axis=1)))  # of the walk between pick-offs, as jumps
    step = np.square(slopes * _rate(laser, turns.time_s) * laser.tick_s) / 12.0
    noise = np.sum(step, axis=1) + np.einsum("uk,ukl,ul->u", slopes, covariance_of_walk(laser, turns.time_s), slopes)
    before, left = _centred(jump, turns.sign), _centred(jump - found, turns.sign)
    raw = float(np.mean(before**2)) + own * half_s
    behind = float(np.mean(left**2 + noise)) + own * half_s - 2.0 * seen
    common = float(np.mean(before * left)) + own * half_s - seen
    return ExpectedOutput(math.sqrt(behind / half_s), common**2 / (raw * behind))


def _turns(laser: NominalLaser) -> tuple[Turnarounds, Array]:
    """Return turnarounds with their crossings where lock-in puts them, and the jumps, (u,)."""
    time_s, motion = expected_turnarounds(laser)
    constants = laser.kappa_rad_s * np.array([[math.cos(laser.beta_rad), math.sin(laser.beta_rad)]])
    constants = np.repeat(constants, time_s.shape[0], axis=0)
    level, amplitude = motion.phase(time_s), laser.rate_rad_s / laser.omega_rad_s
    for _ in range(_ROUNDS):
        shapes = lock_in_shapes(time_s, motion)
        bare = level - np.einsum("ukp,up->uk", shapes.columns, constants)
        risen = np.maximum(motion.sign[:, None] * (bare - motion.coefficients[:, :1]), 0.0)
        time_s = np.copysign(np.arccos(1.0 - risen / amplitude) / laser.omega_rad_s, time_s)
    middle = time_s.shape[1] // 2
    every = np.ones(time_s.shape[0], bool)
    return Turnarounds(
        clock_Hz=1.0 / laser.tick_s,
        omega_rad_s=laser.omega_rad_s,
        rate_rad_s=0.0,
        sign=motion.sign,
        regular=every,
        usable=every,
        grazing=~every,
        reference_tick=np.zeros(every.size, np.int64),
        level0=np.zeros(every.size, np.int64),
        time_s=time_s - time_s[:, middle - 1 : middle + 1].mean(axis=1, keepdims=True),
        phase_rad=level,
        counts={},
    ), shapes.jump(constants)


def _slope(turns: Turnarounds, compensator: Callable[[Turnarounds], Jumps], found: Array, place: int) -> Array:
    """Return by what the jumps go with the phase of one crossing, (u,)."""
    phase = turns.phase_rad.copy()
    phase[:, place] += _SMALL_rad
    return np.asarray((compensator(replace(turns, phase_rad=phase)).dpsi_rad - found) / _SMALL_rad)


def _rate(laser: NominalLaser, time_s: Array) -> Array:
    return np.asarray(laser.rate_rad_s * np.sin(laser.omega_rad_s * time_s))


def _centred(jump: Array, sign: NDArray[np.int64]) -> Array:
    """Return jumps less the mean of their sense, which is a rate, (u,)."""
    mean = [float(np.mean(jump[sign == sense])) for sense in (-1, 1)]
    return np.asarray(jump - np.where(sign < 0, *mean))
