"""What the turnarounds of a ring laser say against two constants of its lock-in: groups of them as rows of one fit.

Readings are the constants that a group gives by itself, relative to those of the record: along them (size), then across
(phase, rad). A group shares time, sense, phase and swing; noise is what turnarounds that follow each other differ by.
Source: docs/ring-laser.md (model), docs/decisions/0052 (departures).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Estimates, Labels, Residuals, Searched, departures_of, search
from bench.maths.arrays import Floats, Integers
from bench.maths.verdict import coverage_factor
from bench.systems.lock_in.result import LaserResult, constant_estimates
from bench.systems.lock_in.wording import say

_TIMES, _PHASES, _SWINGS = 16, 8, 4  # parts of the record, of a turn of the phase, of the swings of the dither
_EACH = 40  # turnarounds of one sense and phase, at least, from which their scatter is taken
# The fit's shapes are of first order in the jumps. By exact physics (15 cm, lock-in of 0.3 and 0.9 deg/s, phases of 0
# to 130 deg) what is left goes with even harmonics of the phase at the turnaround, other ones at maxima and at minima,
# up to 0.17 of the largest jump squared; 0.4 to 2 % of its power are none of these.
_HARMONICS, _FIRST_ORDER = (2, 4, 6), 0.2


@dataclass(frozen=True)
class Changing:
    """Lock-in in each part of a record, (t,), complex: over that of the record, and less what was taken off there.

    ``constants``: of the record, kc + j ks, rad/s.
    """

    constants: complex
    turned: NDArray[np.complex128]
    left: NDArray[np.complex128]


def constants_depart(laser: LaserResult, share: float) -> tuple[Searched | None, Changing | None]:
    """Return the search of the turnarounds of a record, and its lock-in over time if that changes.

    ``share``: of the chance of a false doubt.
    """
    stated = constant_estimates(laser)
    if not stated or not (turns := _Turnarounds(laser)).parts:
        return None, None
    rows = _residuals(turns, stated)
    found = search(rows, departures_of(_labels(turns)), share)
    changes = [one.departure.effect for one in found.findings if one.departure.is_of_time]
    searched = Searched(found, stated, turns.words, lambda _: say("departs.advice"))
    return searched, _changing(turns, rows, np.hstack(changes)) if changes else None


class _Turnarounds:
    """Turnarounds of a record, (u,), one stretch behind the other, and their groups, (G,).

    ``constants``: of all stretches together, (2,), rad/s.   ``score`` (u, 2), ``information`` (u, 2, 2): of relative
    changes along and across them.   ``followed`` (u,): what was taken off, over the constants.   ``psi0_rad``,
    ``swing`` (u,): phase; swing of the dither, relative, less its mean.   ``time``, ``group`` (u,): part of the record,
    group.   ``places`` (4, G): time, sense, phase, swing of each group.
    """

    def __init__(self, laser: LaserResult) -> None:
        fits = laser.found.constants
        self.name, self.part_s, self.jump_squared = laser.name, laser.found.seconds / _TIMES, laser.jump_squared
        information, score, local, sense = (
            np.concatenate([getattr(fit, name) for fit in fits]) for name in ("information", "score", "local", "sense")
        )
        self.psi0_rad, curvature = (
            np.concatenate([getattr(fit.jumps, name)[np.isfinite(fit.jumps.dpsi_rad)] for fit in fits])
            for name in ("psi0_rad", "curvature_rad_s2")
        )
        right = score + np.einsum("upq,uq->up", information, local)
        self.constants = np.linalg.solve(information.sum(axis=0), right.sum(axis=0))
        axes = np.column_stack([self.constants, self.constants[::-1] * [-1.0, 1.0]])
        self.information = axes.T @ information @ axes
        self.score = (right - information @ self.constants) @ axes
        self.followed = local @ [1.0, 1.0j] / (self.constants @ [1.0, 1.0j])
        self.swing = curvature / curvature.mean() - 1.0
        self.time, phase = np.arange(len(score)) * _TIMES // len(score), np.zeros_like(sense)
        self.parts = min(_PHASES, int(np.bincount(sense > 0, minlength=2).min()) // _EACH)
        for one in (-1, 1):
            phase[sense == one] = parts_of(np.mod(self.psi0_rad[sense == one], math.tau), self.parts)
        columns = np.array([self.time, sense, phase, parts_of(self.swing, _SWINGS)])
        self.places, self.group = np.unique(columns, axis=1, return_inverse=True)

    def words(self, label: str, value: Any) -> str:
        """Return how a person names a label."""
        if value is None:
            return say(f"departs.of.{label}", name=self.name)
        if label == "sense":
            return say("departs.minima" if value > 0 else "departs.maxima")
        size = {"visit": self.part_s, "phase": 360.0 / self.parts, "swing": 1.0}[label]
        return say(f"departs.{label}", low=size * value, high=size * (value + 1))

    def summed(self, values: Floats) -> Floats:
        """Return sums over each group, (G, ...), of values of the turnarounds, (u, ...)."""
        total = np.zeros((self.places.shape[1], *values.shape[1:]))
        np.add.at(total, self.group, values)
        return total


def parts_of(values: Floats, count: int) -> Integers:
    """Return which of ``count`` parts of equal size each value is in, by its order, (n,).

    Source: definition of quantiles.
    """
    order = np.empty(values.size, np.int64)
    order[np.argsort(values, kind="stable")] = np.arange(values.size)
    return order * count // values.size


def _residuals(turns: _Turnarounds, stated: Estimates) -> Residuals:
    """Return the groups as rows, lock-in rate and backscatter phase ``stated`` from them, and as priors behind the rows
    what shapes of first order leave.
    """
    strata, stratum = np.unique(turns.places[1:3], axis=1, return_inverse=True)
    steps = [np.diff(turns.score[stratum[turns.group] == one], axis=0) for one in range(strata.shape[1])]
    of_one = np.array([step.T @ step / (2 * len(step)) for step in steps])
    covariance = np.bincount(turns.group)[:, None, None] * of_one[stratum]
    factor, information = np.linalg.inv(np.linalg.cholesky(covariance)), turns.summed(turns.information)
    whole = np.linalg.inv(information.sum(axis=0))
    weights = (whole @ information).transpose(1, 2, 0).reshape(2, -1)
    units = np.array([stated[0].value, math.degrees(1.0)])
    prior = _beyond_first_order(turns, factor)

    def white(columns: Floats) -> Floats:
        of_rows = factor @ columns.reshape(len(factor), 2, -1)
        return np.vstack([of_rows.reshape(2 * len(factor), -1), np.zeros((prior.shape[1], of_rows.shape[2]))])

    def whiten(columns: Floats) -> Floats:
        return white(information @ columns.reshape(2, len(factor), -1).swapaxes(0, 1))

    def shift(effect: Floats) -> Floats:
        """Return by what the estimates move: size and angle of the lock-in are not linear in its constants."""
        along, across = weights @ effect
        return units * [math.hypot(1.0 + along, across) - 1.0, math.atan2(across, 1.0 + along)]

    both = np.repeat(np.eye(2), len(factor), axis=0)
    design = np.hstack([whiten(both), np.vstack([prior, np.eye(prior.shape[1])])])
    return Residuals(
        readings=both[:, 0],
        white=white(turns.summed(turns.score))[:, 0],
        design=design,
        whiten=whiten,
        operator=units[:, None] * weights,
        expanded=np.array([entry.expanded_uncertainty for entry in stated]),
        noise=coverage_factor() * units * np.sqrt(np.diag(whole @ covariance.sum(axis=0) @ whole)),
        noise_dof=min(2 * len(step) // 3 for step in steps),  # neighbours share a turnaround
        shift=shift,
    )


def _beyond_first_order(turns: _Turnarounds, factor: Floats) -> Floats:
    """Return what shapes of first order may leave in a right laser, (2 G, c), one standard uncertainty each."""
    angle = np.multiply.outer(turns.psi0_rad, _HARMONICS)
    shapes = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
    sense = turns.places[1][turns.group][:, None]
    shapes = np.hstack([shapes * (sense > 0), shapes * (sense < 0)])
    shapes = _FIRST_ORDER * turns.jump_squared * np.hstack([shapes, shapes * turns.swing[:, None]])
    effects = np.einsum("gpq,gs->gpqs", factor @ turns.information.mean(axis=0), turns.summed(shapes))
    return np.asarray(effects.reshape(2 * len(factor), -1))


def _labels(turns: _Turnarounds) -> Labels:
    time, sense, phase, swing = np.tile(turns.places, 2)
    both = np.repeat(np.eye(2), turns.places.shape[1], axis=1)
    return Labels(
        kinds={"sense": sense, "phase": phase, "swing": swing},
        hours=turns.part_s * time / 3600.0,
        visit=time,
        carriers={"along": ("%", 0.01 * both[0]), "across": ("deg", math.radians(1.0) * both[1])},
        scopes=[(), ("sense",)],
    )


def _changing(turns: _Turnarounds, rows: Residuals, changes: Floats) -> Changing:
    """Return the lock-in by departures of time together, (2 G, c), all of them free."""
    columns = np.hstack([rows.whiten(changes), rows.design])
    sizes = np.linalg.lstsq(columns, rows.white, rcond=None)[0]
    kept = changes.shape[1]
    along, across = np.reshape(changes @ sizes[:kept], (2, -1)) + sizes[kept : kept + 2, None]
    times = np.unique(turns.places[0])
    turned = np.array([1.0 + np.mean((along + 1j * across)[turns.places[0] == one]) for one in times])
    followed = np.array([turns.followed[turns.time == one].mean() for one in times])
    return Changing(complex(*turns.constants), turned, turned - followed)
