"""Sentences a reader of the azimuths of a north finder must know."""

from __future__ import annotations

import math

import numpy as np

from bench.systems.north.accuracy import Accuracy
from bench.systems.north.estimators.phasors import TURNS
from bench.systems.north.sets import CALIBRATION
from bench.systems.north.solution import LEAST_SQUARES, LIKELIHOOD, LITERAL, QUADRANT, Solution
from bench.systems.north.wording import method_name, say, sense_name

_MOST_CHI = 2.0  # RMS error over its standard uncertainty from which the uncertainty is in doubt
_MOST_APART = 4.0  # standard uncertainties between two methods
_LEAST_APART_deg = 1e-3  # steps of level and lock-ins
_MOST_UNSTEADY = 25.0  # variance along the signal over that across it
_MOST_NOISE_deg = 10.0  # of one set: beyond, a direction is no longer normal (half a percent of the interval)
_FEWEST = 4
_MOST_REPEATS = 4  # a calibration of fewer sets than that limits what repeats can do


def north_notes(solution: Solution, method: str, accuracy: list[Accuracy]) -> list[str]:
    """Return all of them."""
    notes = [
        *_bounded(solution), *_uncertainty(solution, method, accuracy), *_doubts(solution, method),
        *_formulas(accuracy), *_whiteness(solution), *_left_out(solution),
    ]  # fmt: skip
    return notes + [say("note.missing", what=sentence) for sentence in solution.missing]


def _bounded(solution: Solution) -> list[str]:
    if not np.isfinite(solution.bound_deg).any():
        return [say("note.no_samples")]
    return [say("note.bound")]


def _uncertainty(solution: Solution, method: str, accuracy: list[Accuracy]) -> list[str]:
    notes = []
    if not any(north_set.tilt_mrad for north_set in solution.sets):
        notes.append(say("note.no_tilt"))
    elif not solution.site.tilt_std_deg:
        notes.append(say("note.level_not_stated"))
    if not solution.site.azimuth_std_deg:
        notes.append(say("note.azimuth_not_stated"))
    notes += [
        say("note.no_calibration", sense=sense_name(sense))
        for sense in sorted({north_set.sense for north_set in solution.sets})
        if solution.calibrations and sense not in solution.calibrations
    ]
    share_deg = solution.by_method[method].common_deg
    if share_deg > solution.by_method[method].noise_deg / math.sqrt(_MOST_REPEATS):
        notes.append(say("note.calibration_share", share=share_deg))
    by_name = {errors.method: errors for errors in accuracy}
    chosen, noise_deg = by_name[method], solution.by_method[method].noise_deg
    due_deg = math.hypot(noise_deg, share_deg, 0.0 if method == LIKELIHOOD else math.sqrt(2.0) * solution.swing_deg)
    if chosen.used >= _FEWEST and chosen.rms_deg > _MOST_CHI * due_deg > 0.0:
        notes.append(say("note.errors_beyond", rms=chosen.rms_deg, due=due_deg))
    return notes


def _doubts(solution: Solution, method: str) -> list[str]:
    """Return what no uncertainty can know: a weak signal, sets without a level, two rates, methods that contradict."""
    notes = _unsteady(solution) if method != LIKELIHOOD else []
    one_deg = math.hypot(solution.by_method[method].noise_deg, solution.by_method[method].common_deg)
    if one_deg > _MOST_NOISE_deg:
        notes.append(say("note.weak_signal", noise=one_deg))
    if 0 < (count := sum(north_set.tilt_mrad is None for north_set in solution.sets)) < len(solution.sets):
        notes.append(say("note.no_level", count=count, of=len(solution.sets)))
    rates = {round(abs(north_set.rate_deg_s), 1) for north_set in solution.sets if math.isfinite(north_set.rate_deg_s)}
    if len(rates) > 1 and solution.calibrations:
        notes.append(say("note.two_rates", rates=", ".join(f"{rate:g}" for rate in sorted(rates))))
    return notes + _contradiction(solution)


def _unsteady(solution: Solution) -> list[str]:
    """Noise of the lock-ins by what their eight samples leave over, against that across the signal alone."""
    z = (solution.u2_V + 1j * solution.u1_V) * TURNS
    z = z[np.isfinite(z).all(axis=1)]
    if len(z) < _FEWEST:
        return []
    turned = z * np.exp(-1j * np.angle(z.sum(axis=1, keepdims=True)))
    along, across = (part @ np.array([0.5, -0.5, 0.5, -0.5]) for part in (turned.real, turned.imag))  # offsets cancel
    ratio = float(np.sum(along**2) / np.sum(across**2)) if np.any(across) else math.inf
    if not ratio > _MOST_UNSTEADY:
        return []
    key = "note.unsteady" if solution.unsteady else "note.unsteady_few"
    return [say(key, ratio=math.sqrt(ratio), method=method_name(LEAST_SQUARES))]


def _contradiction(solution: Solution) -> list[str]:
    """The waveform needs no calibration: the mean of what least squares finds beside it must agree."""
    by_samples, by_waveform = solution.by_method[LEAST_SQUARES], solution.by_method[LIKELIHOOD]
    apart_deg = by_samples.azimuth_deg - by_waveform.azimuth_deg
    phasors = np.exp(1j * np.deg2rad(apart_deg[np.isfinite(apart_deg) & ~solution.of(CALIBRATION)]))
    if not phasors.size:
        return []
    mean_deg = float(np.rad2deg(np.angle(phasors.mean())))
    noise_deg = math.hypot(by_samples.noise_deg, by_waveform.noise_deg) / math.sqrt(phasors.size)
    due_deg = math.hypot(noise_deg, by_samples.common_deg, solution.placed_deg, solution.swing_deg, _LEAST_APART_deg)
    if abs(mean_deg) <= _MOST_APART * due_deg:
        return []
    return [say("note.contradiction", one=LEAST_SQUARES, mean=mean_deg, other=LIKELIHOOD, due=due_deg)]


def _formulas(accuracy: list[Accuracy]) -> list[str]:
    return [
        say("note.gross", method=method_name(errors.method), gross=errors.gross, used=errors.used)
        for errors in accuracy
        if errors.method in (LITERAL, QUADRANT) and errors.gross
    ]


def _whiteness(solution: Solution) -> list[str]:
    by_waveform = solution.by_method[LIKELIHOOD]
    if math.isfinite(by_waveform.dof):
        ratio = by_waveform.noise_deg / float(np.sqrt(np.nanmean(solution.bound_deg**2)))
        return [say("note.turns_not_white", ratio=ratio, method=method_name(LIKELIHOOD))]
    widened = sum(bool(waveform.widened) for waveform in solution.raw if waveform is not None)
    if not widened:
        return []
    return [say("note.not_white", count=widened, of=len(solution.sets), method=method_name(LIKELIHOOD))]


def _left_out(solution: Solution) -> list[str]:
    return [
        say("note.left_out", name=north_set.name, count=int(north_set.left_out.sum()), of=north_set.left_out.size)
        for north_set in solution.sets
        if north_set.left_out is not None
    ]
