"""Predicts what the global fit will know of lock-in, by its own columns at turnarounds of a declared laser.

Predicts what a compensator of single turnarounds leaves, by its own fit at those of a declared laser.

What the lock-in leaves of its ripple in such a fit goes with the phase at the turnaround, which the dither's scatter
makes any; that, the steps of the clock and the random walk between the crossings are the walk behind it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError
from bench.systems.lock_in.estimators.global_constants import (
    Constants,
    GlobalConstants,
    Projection,
    covariance_of,
    require_turnarounds,
)
from bench.systems.lock_in.estimators.single_turnarounds import DitherMotion, jumps_of, lock_in_shapes
from bench.systems.lock_in.estimators.turnarounds import CROSSINGS, GRAZING_rad, Jumps, Turnarounds

_PHASES = 64  # at which the dither turns round, over a turn
_ROUNDS = 4  # in which lock-in moves the crossings to where they are
_SMALL_rad = 1e-5  # of one crossing, to see how the jump goes with it


@dataclass(frozen=True)
class NominalLaser:
    """A laser and its dither, of phase.

    ``kappa_rad_s``, ``beta_rad``: lock-in rate and backscatter phase.   ``omega_rad_s``, ``rate_rad_s``: frequency and
    amplitude of the dither.   ``walk_rad_rt_s``: random walk beside lock-in.   ``tick_s``: of the time stamps.
    """

    kappa_rad_s: float
    beta_rad: float
    omega_rad_s: float
    rate_rad_s: float
    walk_rad_rt_s: float
    tick_s: float

    @property
    def jump_squared(self) -> float:
        """Square of the largest jump of a turnaround, rad^2: kappa^2 2 pi / a."""
        return self.kappa_rad_s**2 * math.tau / (self.rate_rad_s * self.omega_rad_s)


def expected_constants(laser: NominalLaser, turnarounds: int) -> GlobalConstants:
    """Return constants as the global fit will find them, with the uncertainties that it will state.

    Its columns at the crossings of turnarounds whose phase is anywhere in a turn, as the dither's scatter leaves it;
    steps of the clock are independent from crossing to crossing, the random walk is shared. That lock-in itself
    moves the crossings, by a hundredth of the distance to the next where the jump is 0.07 rad, is left out.

    Args:    turnarounds: of the record.
    Returns: GlobalConstants with one block and no residuals; jumps, score and information of 128 turnarounds.
    Raises:  FitError B-FIT-097 if the dither has not 16 crossings on each side of a turnaround, B-FIT-098 as
             ``global_constants``.
    Source:  as ``global_constants``; variance of a step of the clock, tick^2 / 12; covariance of a random walk.
    """
    require_turnarounds(turnarounds)
    time_s, motion = expected_turnarounds(laser)
    shapes, sides = lock_in_shapes(time_s, motion), time_s.shape[0]
    columns = Projection(time_s, laser.omega_rad_s).residual(shapes.columns)
    information = columns.transpose(0, 2, 1) @ columns
    scatter = columns.transpose(0, 2, 1) @ _noise(laser, time_s) @ columns
    covariance = covariance_of(information.sum(axis=0), scatter.sum(axis=0)) * sides / turnarounds
    value = laser.kappa_rad_s * np.array([[math.cos(laser.beta_rad), math.sin(laser.beta_rad)]])
    constants = Constants(value, covariance[None])
    kappa, kappa_std, beta, beta_std = constants.polar()
    local = np.repeat(value, sides, axis=0)
    return GlobalConstants(
        jumps=jumps_of("global_constants", np.ones(sides, bool), shapes.jump(local), motion),
        kappa_rad_s=float(kappa[0]),
        kappa_std_rad_s=float(kappa_std[0]),
        beta_rad=float(beta[0]),
        beta_std_rad=float(beta_std[0]),
        blocks=constants,
        residual_jump_rad=np.zeros(sides),
        score=np.zeros((sides, 2)),
        information=information,
        local=local,
        sense=motion.sign,
    )


def expected_turnarounds(laser: NominalLaser) -> tuple[Floats, DitherMotion]:
    """Return times of the crossings, (u, k), about turnarounds of both senses and all phases, and the motion.

    Raises:  FitError B-FIT-097 if the dither has not 16 crossings on each side of a turnaround.
    Source:  s A (1 - cos w t) past each level; lock-in does not move the crossings.
    """
    sign, curvature = np.repeat([-1, 1], _PHASES), laser.rate_rad_s * laser.omega_rad_s
    psi0 = np.tile(math.tau * (np.arange(_PHASES) + 0.5) / _PHASES, 2)
    past = np.mod(-sign * psi0, np.pi)
    risen = (past + np.pi * (past < GRAZING_rad))[:, None] + np.pi * np.arange(CROSSINGS)
    swing = laser.rate_rad_s / laser.omega_rad_s
    if risen.max() > swing:
        raise FitError(
            "B-FIT-097",
            f"a dither of {swing:.3g} rad of phase has not {CROSSINGS} crossings on each side of a turnaround",
            next_step="look at the declared dither: its amplitude, its frequency, and the path length",
        )
    after = np.arccos(1.0 - risen / swing) / laser.omega_rad_s
    coefficients = np.column_stack((psi0, sign * curvature, np.zeros_like(psi0)))
    return np.hstack((-after[:, ::-1], after)), DitherMotion(coefficients, sign, laser.omega_rad_s, 0.0)


def covariance_of_walk(laser: NominalLaser, time_s: Floats) -> Floats:
    """Return covariance of the random walk at the crossings, less its value at the first, (u, k, k), rad^2.

    Args:    time_s: of the crossings, (u, k).
    Source:  definition of a random walk.
    """
    since = time_s - time_s[:, :1]
    return laser.walk_rad_rt_s**2 * np.minimum(since[:, :, None], since[:, None, :])


def _noise(laser: NominalLaser, time_s: Floats) -> Floats:
    """Covariance of the phases at the crossings beside a constant, (u, k, k), rad^2."""
    walk = covariance_of_walk(laser, time_s)
    step_rad = laser.rate_rad_s * np.sin(laser.omega_rad_s * time_s) * laser.tick_s / math.sqrt(12.0)
    return walk + np.square(step_rad)[:, :, None] * np.eye(time_s.shape[1])


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


def _turns(laser: NominalLaser) -> tuple[Turnarounds, Floats]:
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


def _slope(turns: Turnarounds, compensator: Callable[[Turnarounds], Jumps], found: Floats, place: int) -> Floats:
    """Return by what the jumps go with the phase of one crossing, (u,)."""
    phase = turns.phase_rad.copy()
    phase[:, place] += _SMALL_rad
    return (compensator(replace(turns, phase_rad=phase)).dpsi_rad - found) / _SMALL_rad


def _rate(laser: NominalLaser, time_s: Floats) -> Floats:
    return laser.rate_rad_s * np.sin(laser.omega_rad_s * time_s)


def _centred(jump: Floats, sign: Integers) -> Floats:
    """Return jumps less the mean of their sense, which is a rate, (u,)."""
    mean = [float(np.mean(jump[sign == sense])) for sense in (-1, 1)]
    return jump - np.where(sign < 0, *mean)
