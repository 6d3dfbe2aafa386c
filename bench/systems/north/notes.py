"""Sentences a reader of the azimuths of a north finder must know."""

from __future__ import annotations

import math

import numpy as np

from bench.systems.north.accuracy import Accuracy
from bench.systems.north.estimators.phasors import TURNS
from bench.systems.north.sets import CALIBRATION, SENSES
from bench.systems.north.solution import LEAST_SQUARES, LIKELIHOOD, LITERAL, QUADRANT, Solution

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
    return notes + [f"Missing: {sentence}." for sentence in solution.missing]


def _bounded(solution: Solution) -> list[str]:
    if not np.isfinite(solution.bound_deg).any():
        return ["No raw samples: no maximum likelihood and no bound."]
    return [
        "The bound is that of the samples of the four records. A lock-in averages over the time its filters are made "
        "for, so its azimuth may be a little better than the bound of the records, or worse."
    ]


def _uncertainty(solution: Solution, method: str, accuracy: list[Accuracy]) -> list[str]:
    notes = []
    if not any(north_set.tilt_mrad for north_set in solution.sets):
        notes.append("The tilt of the rotation axis was not measured: it is neither corrected nor in the uncertainty.")
    elif not solution.site.tilt_std_deg:
        notes.append("The uncertainty of the level is not stated (site: tilt); it is not included.")
    if not solution.site.azimuth_std_deg:
        notes.append("The uncertainty of the stated azimuth is not stated; it is not included.")
    notes += [
        f"No calibration for a table that turns {SENSES[sense]}: nominal index placement there."
        for sense in sorted({north_set.sense for north_set in solution.sets})
        if solution.calibrations and sense not in solution.calibrations
    ]
    share_deg = solution.by_method[method].common_deg
    if share_deg > solution.by_method[method].noise_deg / math.sqrt(_MOST_REPEATS):
        notes.append(
            f"The calibration alone is uncertain by {share_deg:.3g} deg: no number of repeats goes below that, more "
            "sets at the known azimuth do."
        )
    by_name = {errors.method: errors for errors in accuracy}
    chosen, noise_deg = by_name[method], solution.by_method[method].noise_deg
    due_deg = math.hypot(noise_deg, share_deg, 0.0 if method == LIKELIHOOD else math.sqrt(2.0) * solution.swing_deg)
    if chosen.used >= _FEWEST and chosen.rms_deg > _MOST_CHI * due_deg > 0.0:
        notes.append(
            f"Errors at the known azimuths are {chosen.rms_deg:.3g} deg RMS, their uncertainty says {due_deg:.3g} deg: "
            "something acts that is neither noise nor calibration."
        )
    return notes


def _doubts(solution: Solution, method: str) -> list[str]:
    """Return what no uncertainty can know: a weak signal, sets without a level, two rates, methods that contradict."""
    notes = _unsteady(solution) if method != LIKELIHOOD else []
    one_deg = math.hypot(solution.by_method[method].noise_deg, solution.by_method[method].common_deg)
    if one_deg > _MOST_NOISE_deg:
        notes.append(
            f"One set is uncertain by {one_deg:.3g} deg: the signal is hardly stronger than its noise, and the "
            "intervals are too short."
        )
    if 0 < (count := sum(north_set.tilt_mrad is None for north_set in solution.sets)) < len(solution.sets):
        notes.append(f"{count} of {len(solution.sets)} sets have no reading of the level: their tilt is not corrected.")
    rates = {round(abs(north_set.rate_deg_s), 1) for north_set in solution.sets if math.isfinite(north_set.rate_deg_s)}
    if len(rates) > 1 and solution.calibrations:
        notes.append(
            f"The table turned at {', '.join(f'{rate:g}' for rate in sorted(rates))} deg/s: a delay of the signal is "
            "another angle at another rate, so a calibration holds for its own only."
        )
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
    of_noise = (
        "its uncertainty is that of the noise across the signal"
        if solution.unsteady
        else "its uncertainty takes it for noise, for there are too few sets to tell them apart"
    )
    return [
        f"The amplitude changes between index positions ({math.sqrt(ratio):.2g} times as much as its noise): "
        f"{LEAST_SQUARES} is not touched by that; {of_noise}."
    ]


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
    return [
        f"{LEAST_SQUARES} finds azimuths {mean_deg:+.3g} deg beside those of {LIKELIHOOD}, {due_deg:.3g} deg are due: "
        "azimuth or head of the calibration, zero of the encoder or lock-ins (delay, harmonics) are not as stated."
    ]


def _formulas(accuracy: list[Accuracy]) -> list[str]:
    return [
        f"{errors.method}: {errors.gross} of {errors.used} tests are more than 90 deg off."
        for errors in accuracy
        if errors.method in (LITERAL, QUADRANT) and errors.gross
    ]


def _whiteness(solution: Solution) -> list[str]:
    widened = sum(bool(waveform.widened) for waveform in solution.raw if waveform is not None)
    if not widened:
        return []
    return [
        f"The noise of {widened} of {len(solution.sets)} waveforms is not white: the uncertainty by {LIKELIHOOD} is "
        "widened, the bound is not."
    ]


def _left_out(solution: Solution) -> list[str]:
    return [
        f"{north_set.name}: {int(north_set.left_out.sum())} of {north_set.left_out.size} samples are unlike all others "
        "and left out."
        for north_set in solution.sets
        if north_set.left_out is not None
    ]
