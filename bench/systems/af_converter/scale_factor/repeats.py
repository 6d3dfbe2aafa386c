"""First visits and repeats of a channel: what has changed between them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import estimate
from bench.model.errors import FitError
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.estimators.noise import Readings
from bench.systems.af_converter.estimators.scale_factor import Referral, fit_scale_factor
from bench.systems.af_converter.group_estimates import conditions_of
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted, GroupFit

Array = NDArray[np.float64]
Pair = tuple[GroupFit, GroupFit]


def repeats(fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> list[Pair]:
    """First visit and repeat of every channel and temperature that was visited again, by the points both hold.

    With other points in one of them, such as more zeros, the errors of the calibrator would not cancel.
    """
    first = {(one.group.channel, one.group.temperature_degC): one for one in fitted.groups if one.group.repeat == 0}
    found = []
    for again in (one for one in fitted.groups if one.group.repeat):
        start = first.get((again.group.channel, again.group.temperature_degC))
        if start is None:
            continue
        sides = ((start, again), (again, start))
        both = [_common(one, other, fitted, campaign, standards, method) for one, other in sides]
        found.append((both[0], both[1]))
    return found


def _common(
    one: GroupFit, other: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> GroupFit:
    """Return a group fitted by its points that the other group has too; as it was if that is all, or too few."""
    theirs = set(_points(other.group.closed))
    kept = np.array([point in theirs for point in _points(one.group.closed)])
    if kept.all():
        return one
    rows, at_degC = one.group.closed.take(kept), one.fit.unit_temperature_degC
    referral = Referral(at_degC, fitted.slopes_ppm_degC(one.group.channel, at_degC))
    try:
        fit = fit_scale_factor(rows, campaign.converter(one.group.channel), standards.ranges, method, referral)
    except FitError:
        return one
    return replace(one, fit=fit)


def _points(rows: Readings) -> list[tuple[float, float, float]]:
    return list(zip(rows.polarity.tolist(), rows.level_A.tolist(), rows.range_A.tolist(), strict=True))


def change_ppm(start: GroupFit, again: GroupFit, fitted: Fitted) -> tuple[Array, Array]:
    """Change (2,) of DSF_N, DSF_P from a first visit to its repeat and its covariance (2, 2), ppm.

    At the temperature of the first visit; everything common to both cancels.
    """
    slopes = fitted.slopes_ppm_degC(again.group.channel, again.fit.unit_temperature_degC)
    warmer_degC = again.fit.unit_temperature_degC - start.fit.unit_temperature_degC
    change = again.fit.dsf_ppm - start.fit.dsf_ppm - np.array(slopes) * warmer_degC
    effects = [again.fit.gain_ppm - start.fit.gain_ppm]
    for label in again.fit.shared_ppm.keys() | start.fit.shared_ppm.keys():
        there = start.fit.shared_ppm.get(label, np.zeros(2))
        effects.append(again.fit.shared_ppm.get(label, np.zeros(2)) - there)
    shared = np.sum([np.outer(effect, effect) for effect in effects], axis=0)
    return np.asarray(change), np.asarray(again.fit.noise_ppm2 + start.fit.noise_ppm2 + shared)


def drift_estimates(pairs: list[Pair], fitted: Fitted, campaign: Campaign) -> list[dict[str, Any]]:
    """Repeat minus first visit of a channel, at the temperature of the first; everything common cancels."""
    found = []
    for start, again in pairs:
        change, covariance = change_ppm(start, again, fitted)
        for index, quantity in enumerate(QUANTITIES):
            conditions = conditions_of(start, campaign) | {"repeat": again.group.repeat}
            std_ppm = float(np.sqrt(covariance[index, index]))
            found.append(estimate(f"{quantity}_drift", "ppm", change[index], std_ppm, conditions, n=again.fit.n))
    return found
