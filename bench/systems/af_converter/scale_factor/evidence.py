"""What the data of a scale-factor campaign say against its model, group by group.

What cannot be is told by ``plausible``. The levels must lie on one straight line within their uncertainties: a line
that is carried by one level is not that of the converter.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Estimates, Evidence, Material
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.pulses import count_step
from bench.systems.af_converter.estimators.readings import QUANTISATION
from bench.systems.af_converter.group_fit import (
    SCALE_FACTORS,
    Fitted,
    GroupFit,
    probability_of,
    refit,
)
from bench.systems.af_converter.groups import place_name
from bench.systems.af_converter.plausible import about, plausible
from bench.systems.af_converter.register import CALIBRATOR, Standards, expired
from bench.systems.af_converter.scale_factor.calibrator_drift import repeats
from bench.systems.af_converter.scale_factor.common_step import common_step
from bench.systems.af_converter.scale_factor.unsteady import unsteady
from bench.systems.af_converter.wording import say

Array = NDArray[np.float64]
_LOOKED_AT = 1e-3  # far above the level of any campaign, so that the refits cost nothing in a right world
_SMALLEST = 1e-300  # a probability that is lost in the arithmetic is still one


def evidence(
    fitted: Fitted, entries: Estimates, campaign: Campaign, standards: Standards, method: str, material: Material
) -> list[Evidence]:
    """Return what every check says of the estimates, those that found nothing included."""
    straight = [_straight(visit, fitted, campaign, standards, method) for visit in fitted.groups]
    return [
        *(seen for visit in fitted.groups for seen in plausible(visit.group, visit.fit.dsf_ppm, campaign)),
        *straight,
        *(_whole_counts(visit) for visit in fitted.groups),
        *common_step(fitted, entries),
        *unsteady(repeats(fitted, campaign, standards, method), fitted, entries),
        *expired(material, CALIBRATOR, fitted.ranges_A, SCALE_FACTORS),
    ]


def _about(visit: GroupFit) -> dict[str, float]:
    return about(visit.group)


def _straight(visit: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> Evidence:
    """Return whether the levels lie on a straight line, and how far one level carries the result."""
    fit = visit.fit
    probability = probability_of(fit)
    level_A, move = _carried(visit, fitted, campaign, standards, method) if probability < _LOOKED_AT else (0.0, 0.0)
    place = place_name(visit.group.place)
    sentence = say("evidence.not_straight", place=place, chi2=fit.reduced_chi2, level=1e3 * level_A, move=move)
    return Evidence(
        "lack_of_fit", sentence, fit.reduced_chi2, max(probability, _SMALLEST), move, SCALE_FACTORS, _about(visit)
    )


def _whole_counts(visit: GroupFit) -> Evidence:
    """Return whether the counts of a visit are single pulses, or go in steps of several of them.

    A step of g moves each reading by as much of a pulse as chance does by one: standard deviation g / sqrt(12).
    """
    fit, rows = visit.fit, visit.group.closed
    step, probability = count_step(np.concatenate([rows.n_count, rows.p_count]))
    contrast = np.array([1.0, -1.0])
    std_ppm = np.sqrt([*np.diag(fit.covariance_ppm2), contrast @ fit.covariance_ppm2 @ contrast])
    of_one_ppm = fit.parts_ppm[QUANTISATION] * np.sqrt(6.0 / 12.0)
    move = step * float(np.max([*of_one_ppm, np.hypot(*of_one_ppm)] / std_ppm))
    sentence = say("evidence.steps", place=place_name(visit.group.place), step=step, move=move)
    return Evidence("counts_in_steps", sentence, float(step), probability, move, SCALE_FACTORS, _about(visit))


def _carried(
    visit: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> tuple[float, float]:
    """Return the level without which the result moves most, ampere, and by how much of its expanded uncertainty."""
    rows = visit.group.closed
    expanded_ppm = coverage_factor() * np.sqrt(np.diag(visit.fit.covariance_ppm2))
    moves: list[tuple[float, float]] = []
    for level_A in np.unique(rows.level_A[rows.level_A > 0]):
        without = refit(visit, rows.level_A != level_A, fitted, campaign, standards, method)
        if without is not None:
            moved = np.abs(without.dsf_ppm - visit.fit.dsf_ppm) / expanded_ppm
            moves.append((float(level_A), float(moved.max())))
    return max(moves, key=lambda pair: pair[1], default=(0.0, np.inf))
