"""Sentences a reader of the azimuths of a north finder must know."""

from __future__ import annotations

import math

import numpy as np

from bench.campaigns.fog_accuracy import Accuracy
from bench.campaigns.fog_estimates import SENSES
from bench.campaigns.fog_solution import LIKELIHOOD, LITERAL, QUADRANT, Solution

_MOST_CHI = 2.0  # RMS error over its standard uncertainty from which the uncertainty is in doubt
_FEWEST = 4
_MOST_REPEATS = 4  # a calibration of fewer sets than that limits what repeats can do


def north_notes(found: Solution, method: str, accuracy: list[Accuracy]) -> list[str]:
    """All of them."""
    notes = [*_bounded(found), *_uncertainty(found, method, accuracy), *_formulas(accuracy), *_whiteness(found)]
    return notes + [f"Missing: {one}." for one in found.missing]


def _bounded(found: Solution) -> list[str]:
    if not np.isfinite(found.bound_deg).any():
        return ["No raw samples: no maximum likelihood and no bound."]
    return [
        "The bound is that of the samples of the four records. A lock-in averages over the time its filters are made "
        "for, so its azimuth may be a little better than the bound of the records, or worse."
    ]


def _uncertainty(found: Solution, method: str, accuracy: list[Accuracy]) -> list[str]:
    notes = []
    if not any(one.tilt_mrad for one in found.sets):
        notes.append("The tilt of the rotation axis was not measured: it is neither corrected nor in the uncertainty.")
    elif not found.site.tilt_std_deg:
        notes.append("The uncertainty of the level is not stated (site: tilt); it is not included.")
    if not found.site.azimuth_std_deg:
        notes.append("The uncertainty of the stated azimuth is not stated; it is not included.")
    notes += [
        f"No calibration for a table that turns {SENSES[sense]}: nominal index placement there."
        for sense in sorted({one.sense for one in found.sets})
        if found.calibrations and sense not in found.calibrations
    ]
    share_deg = found.by_method[method].common_deg
    if share_deg > found.by_method[method].noise_deg / math.sqrt(_MOST_REPEATS):
        notes.append(
            f"The calibration alone is uncertain by {share_deg:.3g} deg: no number of repeats goes below that, more "
            "sets at the known azimuth do."
        )
    by_name = {one.method: one for one in accuracy}
    chosen, noise_deg = by_name[method], found.by_method[method].noise_deg
    due_deg = math.hypot(noise_deg, share_deg, 0.0 if method == LIKELIHOOD else math.sqrt(2.0) * found.swing_deg)
    if chosen.used >= _FEWEST and chosen.rms_deg > _MOST_CHI * due_deg > 0.0:
        notes.append(
            f"Errors at the known azimuths are {chosen.rms_deg:.3g} deg RMS, their uncertainty says {due_deg:.3g} deg: "
            "something acts that is neither noise nor calibration."
        )
    return notes


def _formulas(accuracy: list[Accuracy]) -> list[str]:
    return [
        f"{one.method}: {one.gross} of {one.used} tests are more than 90 deg off."
        for one in accuracy
        if one.method in (LITERAL, QUADRANT) and one.gross
    ]


def _whiteness(found: Solution) -> list[str]:
    widened = sum(bool(one.widened) for one in found.raw if one is not None)
    if not widened:
        return []
    return [
        f"The noise of {widened} of {len(found.sets)} waveforms is not white: the uncertainty by {LIKELIHOOD} is "
        "widened, the bound is not."
    ]
