"""Lock-in errors from two lock-in constants that all turnarounds of a while share, by variable projection.

Predicts what the global fit will know of lock-in, by its own columns at turnarounds of a declared laser.

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
from bench.systems.lock_in.estimators.single_turnarounds import (
    DitherMotion,
    dither_columns,
    jumps_of,
    lock_in_shapes,
    stepped_motion,
)
from bench.systems.lock_in.estimators.turnarounds import CROSSINGS, GRAZING_rad, Jumps, Turnarounds, spread

_ROUNDS = 5
_FEWEST = 50  # turnarounds that two constants are taken from


@dataclass(frozen=True)
class Constants:
    """kc, ks and their covariance, of each block: (b, 2), (b, 2, 2)."""

    value: Floats
    covariance: Floats

    def polar(self) -> tuple[Floats, Floats, Floats, Floats]:
        """kappa, its uncertainty, beta, its uncertainty, (b,) each."""
        kappa = np.hypot(self.value[:, 0], self.value[:, 1])
        along = self.value / kappa[:, None]
        across = np.column_stack((-along[:, 1], along[:, 0]))
        spread_along = np.sqrt(np.einsum("bp,bpq,bq->b", along, self.covariance, along))
        spread_across = np.sqrt(np.einsum("bp,bpq,bq->b", across, self.covariance, across))
        return kappa, spread_along, np.arctan2(self.value[:, 1], self.value[:, 0]), spread_across / kappa


@dataclass(frozen=True)
class GlobalConstants:
    """Lock-in constants and the jumps that follow from them.

    Attributes:
        jumps: of all turnarounds.
        kappa_rad_s, beta_rad: lock-in rate in phase (K W_L) and backscatter phase, of the whole stretch, beta in
            (-pi, pi]; with standard uncertainties.
        residual_jump_rad: step at the zero-rate instant that the crossings still show, (n,): what the model lacks.
        score, information: what each usable turnaround says against the constants of its time, (u, 2), and with what
            weight, (u, 2, 2); ``information`` times a change of (kc, ks) is the score that it explains.
        local: constants of its time, (u, 2), rad/s.   sense: -1 at a maximum of the phase, (u,).
    """

    jumps: Jumps
    kappa_rad_s: float
    kappa_std_rad_s: float
    beta_rad: float
    beta_std_rad: float
    residual_jump_rad: Floats
    score: Floats
    information: Floats
    local: Floats
    sense: Integers


class Projection:
    """Takes the dither (constant and two columns of each turnaround) out of values at crossings ``time_s``, (u, k)."""

    def __init__(self, time_s: Floats, omega_rad_s: float) -> None:
        columns = np.concatenate((np.ones((*time_s.shape, 1)), dither_columns(time_s, omega_rad_s)), axis=-1)
        self.columns = columns
        self.across = columns.transpose(0, 2, 1)
        scale = 1.0 / np.sqrt(np.einsum("ukp,ukp->up", columns, columns))
        unit = columns * scale[:, None, :]
        inverse = np.linalg.inv(unit.transpose(0, 2, 1) @ unit)
        self.inverse = scale[:, :, None] * inverse * scale[:, None, :]

    def solve(self, values: Floats) -> Floats:
        """Return coefficients of the columns, (u, 3, r), of values (u, k, r)."""
        return np.asarray(self.inverse @ (self.across @ values))

    def residual(self, values: Floats) -> Floats:
        """Return values without what the columns explain, (u, k, r)."""
        return values - self.columns @ self.solve(values)


def global_constants(turns: Turnarounds, block_s: float = 5.0) -> GlobalConstants:
    """Local dither (c, A, t0) of each turnaround and kc, ks of each block, by variable projection.

    Then dpsi = -kappa sqrt(2 pi / a) sin(psi0 + beta + s pi / 4) with the constants carried over from block to block
    by straight lines. Their covariance comes from the scatter of the turnarounds themselves, so it counts noise that
    the crossings of one turnaround share.

    Args:    turns: with 16 crossings a side.   block_s: length of time over which the constants are taken as constant.
    Raises:  FitError B-FIT-098 if there are fewer than 50 usable turnarounds.
    Source:  Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413 (variable projection); lock-in paper (5), (10).
    """
    time_s = turns.inner(turns.crossings)[0]
    require_turnarounds(len(time_s))
    fit = _settled(turns, block_s)
    kappa, kappa_std, beta, beta_std = _constants(fit.projected, np.zeros(len(time_s), np.int64), 1).polar()
    steps = _steps_left(fit.projection, fit.left, time_s, fit.motion)
    lock_in = fit.projected[:, :, :2]
    return GlobalConstants(
        jumps=jumps_of(turns.usable, fit.step, fit.motion),
        kappa_rad_s=float(kappa[0]),
        kappa_std_rad_s=float(kappa_std[0]),
        beta_rad=float(beta[0]),
        beta_std_rad=float(beta_std[0]),
        residual_jump_rad=spread(turns.usable, steps),
        score=np.asarray(np.einsum("ukp,uk->up", lock_in, fit.left)),
        information=np.asarray(lock_in.transpose(0, 2, 1) @ lock_in),
        local=fit.local,
        sense=turns.sign[turns.usable],
    )


def require_turnarounds(count: int) -> None:
    """Refuse fewer usable turnarounds than two constants are taken from.

    Raises:  FitError B-FIT-098 if there are fewer than 50.
    Source:  none; bookkeeping.
    """
    if count < _FEWEST:
        raise FitError(
            "B-FIT-098",
            f"{count} usable dither turnarounds do not tell the lock-in constants, at least {_FEWEST} are due",
            next_step="record longer, 20 s for a random walk, and look why turnarounds are not usable",
        )


@dataclass(frozen=True)
class _Settled:
    """The fit: ``step`` (u,), ``left`` (u, k) residuals; ``projected`` (u, k, 3): lock-in's columns and the phase;
    ``local`` (u, 2): kc, ks of each turnaround.
    """

    projection: Projection
    motion: DitherMotion
    projected: Floats
    step: Floats
    left: Floats
    local: Floats


def _settled(turns: Turnarounds, block_s: float) -> _Settled:
    """Shapes, constants and local dithers by turns until they settle."""
    block, middle_s, when_s = _blocks(turns, block_s)
    time_s, phase = turns.inner(turns.crossings)
    projection, dithered = Projection(time_s, turns.omega_rad_s), phase - turns.rate_rad_s * time_s
    motion = stepped_motion(turns, turns.crossings)[1]
    for _ in range(_ROUNDS):
        shapes = lock_in_shapes(time_s, motion)
        lock_in = shapes.columns
        both = projection.residual(np.concatenate((lock_in, dithered[:, :, None]), axis=-1))
        local = _between(_constants(both, block, middle_s.size).value, middle_s, when_s)
        bare = dithered - np.einsum("ukp,up->uk", lock_in, local)
        solved = projection.solve(bare[:, :, None])[:, :, 0]
        motion = DitherMotion(solved, motion.sign, motion.omega_rad_s, motion.rate_rad_s)
    left = projection.residual(bare[:, :, None])[:, :, 0]
    step = shapes.jump(local)
    return _Settled(projection, motion, both, step, left, local)


def _blocks(turns: Turnarounds, block_s: float) -> tuple[Integers, Floats, Floats]:
    """Block of each usable turnaround, (u,), middle of each block, (b,), and time of each turnaround, (u,), second."""
    tick = turns.reference_tick[turns.usable]
    when_s = (tick - tick[0]) / turns.clock_Hz
    count = max(1, min(round(float(when_s[-1]) / block_s), when_s.size // _FEWEST))
    block = np.minimum(np.arange(when_s.size) * count // when_s.size, count - 1)
    middle_s = np.bincount(block, when_s) / np.bincount(block)
    return np.asarray(block), np.asarray(middle_s), np.asarray(when_s)


def _constants(projected: Floats, block: Integers, count: int) -> Constants:
    """Constants of each block from projected columns and phases, (u, k, 3)."""
    lock_in, values = projected[:, :, :2], projected[:, :, 2]
    normal = np.zeros((count, 2, 2))
    np.add.at(normal, block, lock_in.transpose(0, 2, 1) @ lock_in)
    right = np.zeros((count, 2))
    np.add.at(right, block, np.einsum("ukp,uk->up", lock_in, values))
    value = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    left = values - np.einsum("ukp,up->uk", lock_in, value[block])
    score = np.einsum("ukp,uk->up", lock_in, left)
    scatter = np.zeros((count, 2, 2))
    np.add.at(scatter, block, score[:, :, None] * score[:, None, :])
    return Constants(np.asarray(value, np.float64), covariance_of(normal, scatter))


def covariance_of(normal: Floats, scatter: Floats) -> Floats:
    """Return covariance of least squares, (b, 2, 2), from normal matrices and what the scores scatter by, (b, 2, 2).

    Source:  Huber, Proc. 5th Berkeley Symp. 1 (1967) 221.
    """
    inverse = np.linalg.inv(normal)
    return np.asarray(inverse @ scatter @ inverse, np.float64)


def _between(value: Floats, middle_s: Floats, when_s: Floats) -> Floats:
    """Constants at each turnaround, (u, 2), on straight lines between the middles of the blocks and on to the ends."""
    if middle_s.size > 1:
        middle_s = np.concatenate(([2.0 * middle_s[0] - middle_s[1]], middle_s, [2.0 * middle_s[-1] - middle_s[-2]]))
        value = np.vstack((2.0 * value[0] - value[1], value, 2.0 * value[-1] - value[-2]))
    return np.column_stack([np.interp(when_s, middle_s, column) for column in value.T])


def _steps_left(projection: Projection, left: Floats, time_s: Floats, motion: DitherMotion) -> Floats:
    """Step at the zero-rate instant that fits the residuals best, (u,), rad."""
    step = 0.5 * np.sign(time_s - motion.zero_rate_s[:, None])
    bare = projection.residual(step[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("uk,uk->u", bare, left) / np.einsum("uk,uk->u", bare, bare))


_PHASES = 64  # at which the dither turns round, over a turn
_LEAST_ROUNDS = 4  # in which lock-in moves the crossings to where they are
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
    Returns: GlobalConstants without residuals; jumps, score and information of 128 turnarounds.
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
    kappa, kappa_std, beta, beta_std = Constants(value, covariance[None]).polar()
    local = np.repeat(value, sides, axis=0)
    return GlobalConstants(
        jumps=jumps_of(np.ones(sides, bool), shapes.jump(local), motion),
        kappa_rad_s=float(kappa[0]),
        kappa_std_rad_s=float(kappa_std[0]),
        beta_rad=float(beta[0]),
        beta_std_rad=float(beta_std[0]),
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
    for _ in range(_LEAST_ROUNDS):
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
