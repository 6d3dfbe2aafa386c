"""Lock-in errors from two lock-in constants that all turnarounds of a while share, by variable projection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, spread

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
        blocks: constants of each block.
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
    blocks: Constants
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
    block, middle_s, when_s = _blocks(turns, block_s)
    fit = _settled(turns, lambda both: _constants(both, block, middle_s.size), middle_s, when_s)
    kappa, kappa_std, beta, beta_std = _constants(fit.projected, np.zeros_like(block), 1).polar()
    steps = _steps_left(fit.projection, fit.left, time_s, fit.motion)
    lock_in = fit.projected[:, :, :2]
    return GlobalConstants(
        jumps=jumps_of("global_constants", turns.usable, fit.step, fit.motion),
        kappa_rad_s=float(kappa[0]),
        kappa_std_rad_s=float(kappa_std[0]),
        beta_rad=float(beta[0]),
        beta_std_rad=float(beta_std[0]),
        blocks=_constants(fit.projected, block, middle_s.size),
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


def _settled(
    turns: Turnarounds, constants_of: Callable[[Floats], Constants], middle_s: Floats, when_s: Floats
) -> _Settled:
    """Shapes, constants and local dithers by turns until they settle."""
    time_s, phase = turns.inner(turns.crossings)
    projection, dithered = Projection(time_s, turns.omega_rad_s), phase - turns.rate_rad_s * time_s
    motion = stepped_motion(turns, turns.crossings)[1]
    for _ in range(_ROUNDS):
        shapes = lock_in_shapes(time_s, motion)
        lock_in = shapes.columns
        both = projection.residual(np.concatenate((lock_in, dithered[:, :, None]), axis=-1))
        local = _between(constants_of(both).value, middle_s, when_s)
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
