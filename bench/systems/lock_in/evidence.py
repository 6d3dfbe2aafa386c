"""What the records of ring lasers say against their own results, record by record.

The constants must be the same in every group of turnarounds, the output must be a random walk all along, and the walk
before compensation must be the one that the constants make. Nothing of a laser's truth is needed for that.
Source: docs/method-uncertainty.md.

What cannot be in a record of a ring laser: counts, time stamps, dither and lock-in beyond what one can have.

That needs no statistics.

Groups of turnarounds are the rows of one fit of two constants of the lock-in. Readings are the constants that a group
gives by itself, relative to those of the record: along them (size), then across (phase, rad). A group shares time,
sense, phase and swing; noise is what turnarounds that follow each other differ by.
Source: docs/method-ring-laser.md (model), method-uncertainty.md (departures).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import LEAST_MOVE, Estimates, Evidence, Labels, Residuals, Searched, departures_of, search
from bench.maths.allan_terms import TERMS
from bench.maths.arrays import Floats, Integers
from bench.maths.samples import few
from bench.maths.tests import chi2_both, f_tail
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.lock_in.compensation import GLOBAL, RAW, SINGLE
from bench.systems.lock_in.estimators.global_constants import NominalLaser, expected_output
from bench.systems.lock_in.estimators.random_walk import RandomWalk, random_walk
from bench.systems.lock_in.estimators.steadiness import change, enough, line, wander
from bench.systems.lock_in.result import LaserResult, constant_estimates, walk_dof, walk_std_deg_rth
from bench.systems.lock_in.wording import label, say

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
    searched = Searched(found, turns.words, lambda _: say("departs.advice"))
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
        stated=stated,
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


CONSTANTS = ("lock_in_rate", "backscatter_phase")
RATIOS = ("random_walk_ratio", "alignment_time_ratio")
BIASES = ("bias_instability", "bias_alignment_error")
WALKS = ("angle_random_walk", "quantisation_noise", "alignment_time", "path_length_exponent", *BIASES, *RATIOS)
_SENSOR_OFF = 0.05  # of the dither amplitude, five times what its sensor is good to
_LEAST_SCATTER = 0.02  # of the dither's amplitude; with less the jumps are no random walk (docs/method-ring-laser.md)
_NO_LOCK_IN, _MOST_JUMP_rad = "implausible_lock_in", 0.5  # the fit is of first order in it
_MOST_STEP_rad = 0.2  # of the phase in one step of the time stamps, where the rate is largest
_MOST_REPEATED = 0.01  # of the blocks
_SHARE = 0.5  # of the chance of a false doubt: that of all constants; the other checks have theirs
_TAIL = 60  # degrees of freedom of an F-test: variances are no normal variables, so a chi-squared is too short
_LOOKED_AT = 1e-3  # far above the level of any campaign, so that the fits cost nothing in a right world


def implausible(laser: LaserResult) -> Iterator[Evidence]:
    """Yield what cannot be, of one record."""
    found, events, record, counted = laser.found, laser.events, laser.record, laser.counted_dither_deg_s
    odd, repeated, blocks = len(found.odd_s), events.repeated, record.blocks
    sensed, scatter = record.dither_deg_s, found.dither_scatter
    off = 0.0 if sensed is None else counted / sensed - 1.0
    scatter = math.inf if scatter is None else scatter
    turned = found.swing_rad * found.omega_rad_s / 2.0 * events.step_ticks / laser.clock_Hz
    squares = [2.0 * float(np.nanmean(np.square(fit.jumps.dpsi_rad))) for fit in found.constants]
    largest = math.sqrt(max(squares, default=0.0))
    checks: tuple[tuple[str, bool, float, Sequence[str], Mapping[str, float | None]], ...] = (
        ("count_odd", not found.odd_left_out, float(odd), WALKS, {"count": odd}),
        (
            "repeated_blocks", not few(repeated, blocks, _MOST_REPEATED), float(repeated), (),
            {"repeated": repeated, "blocks": blocks},
        ),
        ("dither_disagrees", abs(off) > _SENSOR_OFF, off, (), {"counted": counted, "sensed": sensed}),
        (
            "dither_too_regular", scatter < _LEAST_SCATTER, scatter, (*WALKS, *CONSTANTS),
            {"scatter": 100 * scatter, "least": 100 * _LEAST_SCATTER},
        ),
        ("coarse_time_stamps", turned > _MOST_STEP_rad, turned, (), {"step": events.step_ticks, "turned": turned}),
        (_NO_LOCK_IN, largest > _MOST_JUMP_rad, largest, CONSTANTS, {"largest": largest, "most": _MOST_JUMP_rad}),
    )  # fmt: skip
    for code, wrong, figure, quantities, fields in checks:
        if wrong:
            sentence, refuses = say(f"evidence.{code}", name=laser.name, **fields), code == _NO_LOCK_IN
            yield Evidence(code, sentence, figure, 0.0, math.inf, quantities, laser.place, refuses)


def evidence(results: Sequence[LaserResult]) -> tuple[list[Evidence], list[Searched]]:
    """Return what every check says of the estimates, those that found nothing included, and the searches among them."""
    heard: list[Evidence] = []
    searches: list[Searched] = []
    for laser in results:
        searched, changing = constants_depart(laser, _SHARE / len(results))
        heard += [*implausible(laser), *_against_theory(laser)]
        if searched is not None:
            searches.append(searched)
            heard += searched.evidence
        heard += [] if changing is None else _with_lock_in(laser, changing)
        for method, walk in laser.walks.items():
            heard += _output(laser, method, walk)
    return heard, searches


def _output(laser: LaserResult, method: str, walk: RandomWalk) -> Iterator[Evidence]:
    """Yield whether one output is a random walk all along; ``walk``: what was fitted to it."""
    increment = laser.found.increments[method]
    if not enough(increment):
        return
    of_it = say("evidence.output", name=laser.name, method=label(method))
    ticks = laser.found.interval_s * laser.clock_Hz
    checks: tuple[tuple[str, Callable[[Floats], Any]], ...] = (
        ("rate_wanders", wander),
        ("line_in_rate", lambda values: line(values, ticks)),
    )
    for code, check in checks:
        seen = check(increment)
        move = _move(laser, walk, seen.left) if seen.probability < _LOOKED_AT else 0.0
        sentence = say(f"evidence.{code}", output=of_it, figure=seen.figure)
        yield from _of_walk(laser, method, code, sentence, seen.figure, seen.probability, move)
    probability, ratio = change(increment)
    halves = np.array((1.0, ratio)) / math.sqrt((1.0 + ratio**2) / 2.0)
    move = float(np.max(np.abs(halves - 1.0))) * walk.n_deg_rth / _U(walk)
    sentence = say("evidence.walk_changes", output=of_it, ratio=ratio)
    yield from _of_walk(laser, method, "walk_changes", sentence, ratio, probability, move)
    yield from _misfit(laser, method, walk, of_it)


def _misfit(laser: LaserResult, method: str, walk: RandomWalk, of_it: str) -> Iterator[Evidence]:
    """Yield whether more noise than random walk and quantisation is there: all five terms are the rival."""
    probability = f_tail(walk.chi2 / max(walk.dof, 1), walk.dof, _TAIL)
    move = 0.0
    if probability < _LOOKED_AT:
        move = _move(laser, walk, laser.found.increments[method], TERMS)
    sentence = say("evidence.allan_misfit", output=of_it, chi2=walk.chi2, dof=walk.dof)
    yield from _of_walk(laser, method, "allan_misfit", sentence, walk.chi2 / max(walk.dof, 1), probability, move)


def _move(laser: LaserResult, walk: RandomWalk, increment: Floats, terms: Sequence[str] | None = None) -> float:
    """Return by how much of its expanded uncertainty a random walk goes if it is of other increments or terms."""
    words = {} if terms is None else {"terms": tuple(terms)}
    try:
        again = random_walk(increment, laser.found.interval_s, laser.record.path_length_m, **words)
    except FitError:
        return math.inf
    return abs(again.n_deg_rth - walk.n_deg_rth) / _U(walk)


def _U(walk: RandomWalk) -> float:
    return coverage_factor() * walk_std_deg_rth(walk)


def _of_walk(
    laser: LaserResult, method: str, code: str, sentence: str, figure: float, probability: float, move: float
) -> Iterator[Evidence]:
    """Yield a check of one output; what casts doubt on the walk before compensation does so on every ratio to it."""
    place, chance = laser.place, probability
    yield Evidence(code, sentence, figure, chance, move, WALKS, place | {"method": method})
    if method == RAW:
        yield Evidence(code, sentence, figure, chance, move, RATIOS, place)


def _against_theory(laser: LaserResult) -> Iterator[Evidence]:
    """Yield whether the walk before compensation is the one that lock-in makes by equation (6)."""
    walk, behind, expected = laser.walks.get(RAW), laser.walks.get(GLOBAL), laser.expected_deg_rth
    if walk is None or behind is None or expected is None or not walk.n_deg_rth > 0.0:
        return
    theory = math.hypot(expected, behind.n_deg_rth)
    dof = walk_dof(walk)
    square = dof * (walk.n_deg_rth / theory) ** 2
    probability = chi2_both(square, dof)
    sentence = say("evidence.walk_unlike_lock_in", name=laser.name, ratio=walk.n_deg_rth / theory)
    yield from _of_walk(
        laser,
        RAW,
        "walk_unlike_lock_in",
        sentence,
        walk.n_deg_rth / theory,
        probability,
        abs(walk.n_deg_rth - theory) / _U(walk),
    )


def _with_lock_in(laser: LaserResult, changing: Changing) -> Iterator[Evidence]:
    """Yield outputs of which a lock-in that changes makes another random walk in a part of the record than in all.

    One that changes and leaves the walk as it is says nothing of the walk, not even a note.
    """
    for method, walk in laser.walks.items():
        of_parts = _walks_of_parts(laser, method, changing)
        move = float(np.max(np.abs(of_parts - walk.n_deg_rth))) / _U(walk)
        if move > LEAST_MOVE:
            low, high = float(of_parts.min()), float(of_parts.max())
            of_it = say("evidence.output", name=laser.name, method=label(method))
            sentence = say("evidence.walk_with_lock_in", output=of_it, low=1e3 * low, high=1e3 * high)
            yield from _of_walk(laser, method, "walk_with_lock_in", sentence, high, 0.0, move)


def _walks_of_parts(laser: LaserResult, method: str, changing: Changing) -> Floats:
    """Return the random walk of an output in each part of the record, if all that changes is the lock-in, deg/rt-h.

    Before compensation the jumps of a part go with its lock-in, behind the global fit with what its lock-in is off the
    constants of its time, behind another compensator with what that is expected to leave.
    """
    walk, rate = laser.walks[method].n_deg_rth, laser.expected_deg_rth
    if method in SINGLE:
        left = np.array([_left(laser, method, changing.constants * turned) for turned in changing.turned])
        return np.asarray(walk * left / np.sqrt(np.mean(np.square(left))))
    power = np.square(np.abs(changing.left if method == GLOBAL else changing.turned))
    share = 0.0 if rate is None else rate**2
    return np.asarray(np.sqrt(np.maximum(walk**2 + share * (power - power.mean()), 0.0)))


def _left(laser: LaserResult, method: str, constants: complex) -> float:
    """Return the walk, rad/rt-s, expected behind a compensator of single turnarounds by such a lock-in."""
    behind = laser.walks.get(GLOBAL)
    quantum = 0.0 if behind is None else laser.gain * math.radians(behind.n_deg_rth / 60.0)
    nominal = NominalLaser(
        kappa_rad_s=abs(constants),
        beta_rad=cmath.phase(constants),
        omega_rad_s=laser.found.omega_rad_s,
        rate_rad_s=laser.found.swing_rad * laser.found.omega_rad_s / 2.0,
        walk_rad_rt_s=quantum,
        tick_s=1.0 / laser.clock_Hz,
    )
    try:
        return expected_output(nominal, SINGLE[method]).walk_rad_rt_s
    except FitError:  # a dither that hardly reaches 16 crossings: what is left goes with the lock-in at most
        return abs(constants)
