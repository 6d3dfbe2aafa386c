"""What an imported ramp says against its fits: rivals of the models, with the noise fitted again beside each.

The noise of a log is not declared; it is fitted to the residuals and takes a misfit for noise that is alike for hours.
So a rival is weighed by the likelihood of the readings with the noise that suits it best.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bench.analysis import LEAST_MOVE, Evidence, Floats
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.estimators.correlated_noise import CorrelatedNoise, whitening
from bench.systems.af_converter.estimators.drift_ramp import (
    BRANCH,
    DRIFT_NAMES,
    NAMES,
    TEMPERATURE_NAMES,
    Blocks,
    RampHysteresis,
    drift_design,
    ramp_shape,
    search_bounds,
)
from bench.systems.af_converter.estimators.gates import usable_drive
from bench.systems.af_converter.estimators.hysteresis import rivals
from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, LAG
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH, Gates, HysteresisModel
from bench.systems.af_converter.estimators.hysteresis.search import Bounds, Problem, descend
from bench.systems.af_converter.temperature_ramp.fits import RampColumns, ReadingFit, minute_means
from bench.systems.af_converter.wording import say

_SHARES = (1e-4, 0.003, 0.01, 0.03, 0.1, 0.3, 0.6, 0.9)  # of the white part in the variance
_TIMES = 13  # correlation times, from a third of a step to the whole record
_LOOKED_AT = 1e-2  # above the level of any log, so that a right one is seldom looked at twice
_POLISHED = 2
_SMOOTH = 5  # readings of the drive on either side
_RATCHET, _FROM_ABOVE = "play of the smoothed temperature", "play that came from above"
Moves = dict[str, float]


def evidence(fits: Sequence[ReadingFit], columns: RampColumns, blocks: Blocks, reference_degC: float) -> list[Evidence]:
    """Return what every rival of every reading says, those that gain nothing included."""
    found: list[Evidence] = []
    for fit in fits:
        joint: list[Evidence] = []
        if fit.joint is not None and not fit.joint.fit.beyond:
            joint = list(_of_joint(fit, fit.joint, columns, blocks, reference_degC))
        drift = list(_of_drift(fit, columns, blocks, reference_degC))
        # A misplaced corner of the play looks like a step to the joint fit alone, a lag like a bend to the drift model.
        both = {seen.code: max(seen.probability, _of(joint, seen.code)) for seen in drift}
        found += [replace(seen, probability=both.get(seen.code, seen.probability)) for seen in (*drift, *joint)]
    return found


def _of(heard: Sequence[Evidence], code: str) -> float:
    """Return the probability of one code, 0 where nothing of it was heard."""
    return max((seen.probability for seen in heard if seen.code == code), default=0.0)


def _noises(blocks: Blocks, fitted: CorrelatedNoise) -> list[rivals.Noise]:
    """Return the covariances that the noise may have: white and decaying parts on a grid, and the fitted one."""
    t_s = blocks.middle_s
    times = np.geomspace(float(np.median(np.diff(t_s))) / 3.0, float(t_s[-1] - t_s[0]), _TIMES)
    places = [(share, 1.0 - share, float(time_s)) for share in _SHARES for time_s in times]
    whole = fitted.white + fitted.slow
    places.append((fitted.white / whole, fitted.slow / whole, fitted.time_s))
    return [_noise(t_s, place) for place in places]


def _noise(t_s: Floats, place: tuple[float, float, float]) -> rivals.Noise:
    filtered = whitening(t_s, place)
    return rivals.Noise(filtered.of, filtered.log_volume, known=False)


def _of_joint(
    fit: ReadingFit, joint: RampHysteresis, columns: RampColumns, blocks: Blocks, reference_degC: float
) -> Iterator[Evidence]:
    for outcome, base in _joint_rivals(fit, joint, columns, blocks, reference_degC):
        shift = {
            name: base.value(name) + outcome.shift[name] - joint.fit.value(name) for name in (WIDTH, LAG, HALF_WIDTH)
        }
        shift[WIDTH] += outcome.shift[_RATCHET] + outcome.shift[_FROM_ABOVE]  # plays too, of the same width
        width = joint.fit.value(WIDTH) + shift[WIDTH]
        would_be = say("would_be.width", width=width, unit=columns.unit)
        yield _seen(fit.name, outcome, _joint_moves(joint, shift), would_be)


def _joint_rivals(
    fit: ReadingFit, joint: RampHysteresis, columns: RampColumns, blocks: Blocks, reference_degC: float
) -> list[tuple[rivals.Outcome, rivals.Base]]:
    """Return what every rival gains over the joint fit.

    Where one gains, lag and half-width are first brought to their best under the likeliest noise, so that the rival
    does not win by what the search left over under another one.
    """
    drive = usable_drive(*minute_means(columns.t_s, columns.temperature_degC))
    model_gates = Gates(blocks.start_s, blocks.end_s)
    model = HysteresisModel(model_gates, drive, ramp_shape(blocks, reference_degC))
    shape = ramp_shape(blocks, reference_degC)
    others = {
        _RATCHET: HysteresisModel(model_gates, replace(drive, degC=_smoothed(drive.degC)), shape),
        _FROM_ABOVE: HysteresisModel(model_gates, drive, replace(shape, play_start=1.0)),
    }
    bounds, noises = search_bounds(blocks, drive), _noises(blocks, joint.noise)
    place = joint.fit.value(LAG), joint.fit.value(HALF_WIDTH)
    problem = Problem(model, fit.readings, joint.noise.whitening(blocks.middle_s).of)
    outcomes, base = _compared(problem, others, place, blocks, bounds, noises)
    for _ in range(_POLISHED):
        if min(outcome.probability for outcome in outcomes) > _LOOKED_AT:
            break
        problem = Problem(model, fit.readings, rivals.likeliest(base, noises).whiten)
        inside = np.clip(place, 1.001 * bounds.low, 0.999 * bounds.high)
        end = descend(problem, float(inside[0]), float(inside[1]), bounds)
        place = end.lag_s, end.half_width_degC
        outcomes, base = _compared(problem, others, place, blocks, bounds, noises)
    return [(outcome, base) for outcome in outcomes]


def _smoothed(degC: Floats) -> Floats:
    """Running means: the noise of a sensor pushes the play to and fro, which the unit's own temperature does not."""
    weights = np.ones(2 * _SMOOTH + 1) / (2 * _SMOOTH + 1)
    return np.convolve(np.pad(degC, _SMOOTH, mode="edge"), weights, mode="valid")


def _compared(
    problem: Problem,
    others: Mapping[str, HysteresisModel],
    place: tuple[float, float],
    blocks: Blocks,
    bounds: Bounds,
    noises: Sequence[rivals.Noise],
) -> tuple[list[rivals.Outcome], rivals.Base]:
    base = rivals.base_of(problem, *place, (LAG, HALF_WIDTH))
    for name, model in others.items():
        base = rivals.beside(base, name, model.shape_column(*place))
    low_s, high_s = bounds.lag_s
    listed = [
        *(rivals.steps(blocks.middle_s), rivals.second_lag(problem, place[0], (low_s, 2.0 * high_s))),
        rivals.finer(problem.model.unit_degC(place[0]), problem.model.shape_column(*place)),
    ]
    return rivals.compare(base, listed, noises), base


def _joint_moves(joint: RampHysteresis, shift: Mapping[str, float]) -> Moves:
    """Return by how much of its expanded uncertainty each quantity of the joint fit moves."""
    fit, twice = joint.fit, coverage_factor()
    moves = {"hysteresis_width": abs(shift[WIDTH]) / (twice * joint.width[1])}
    if fit.lag_determined:
        moves["thermal_lag"] = abs(shift[LAG]) / (twice * fit.std(LAG))
    if fit.half_width_determined:
        moves["play_half_width"] = abs(shift[HALF_WIDTH]) / (twice * fit.std(HALF_WIDTH))
    return moves


def _of_drift(fit: ReadingFit, columns: RampColumns, blocks: Blocks, reference_degC: float) -> Iterator[Evidence]:
    """Yield what a step and a finer dependence on temperature gain beside the drift model.

    Lag and hysteresis, which it does not know, may look like either to it alone.
    """
    temperature, branch = blocks.mean(columns.temperature_degC), blocks.mean(columns.branch / 2.0)
    design = drift_design(blocks, temperature, branch, reference_degC)
    base = rivals.Base(NAMES, design, fit.drift.residual, fit.drift.parameters)
    listed = [rivals.steps(blocks.middle_s), rivals.finer(temperature, branch)]
    for outcome in rivals.compare(base, listed, _noises(blocks, fit.drift.noise)):
        left = fit.drift.estimate(BRANCH)[0] + outcome.shift[BRANCH]
        would_be = say("would_be.branches", left=left, unit=columns.unit)
        yield _seen(fit.name, outcome, _drift_moves(fit, outcome.shift), would_be)


def _drift_moves(fit: ReadingFit, shift: Mapping[str, float]) -> Moves:
    moved = {name: abs(shift[name]) / (coverage_factor() * fit.drift.estimate(name)[1]) for name in shift}
    return {
        fit.name: max(moved[name] for name in TEMPERATURE_NAMES[1:]),
        "up_minus_down_after_drift": moved[BRANCH],
        **{name.replace(" ", "_"): moved[name] for name in DRIFT_NAMES},
    }


def _seen(reading: str, outcome: rivals.Outcome, moves: Moves, would_be: str) -> Evidence:
    code = rivals.code_of(outcome.name)
    name = say(code, place=outcome.place)
    sentence = say("evidence.log_rival", name=name, reading=reading, gain=outcome.gain, would_be=would_be)
    enough = tuple(name for name, move in moves.items() if move > LEAST_MOVE)
    return Evidence(
        code, sentence, outcome.gain, outcome.probability,
        max(moves.values()), enough or tuple(moves), {"reading": reading},
    )  # fmt: skip
