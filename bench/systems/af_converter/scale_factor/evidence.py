"""What the data of a scale-factor campaign say against its model, group by group.

The levels must lie on one straight line within their uncertainties: a line
that is carried by one level is not that of the converter.
Source: docs/decisions/0025-doubt.md.

Repeats of a channel that do not lie on a steady drift: the bound of the drift says nothing of what happened then.

The temperature coefficients take a change of the calibrator as steady, and an order of temperatures that eliminates a
steady drift lets a step through. An opening, a middle and a closing visit tell the two apart.
Source: docs/decisions/0049-the-shortest-plan.md.

A step in time that all channels share: then it is not the units but the standard, or the clock, that changed.

What a polynomial in temperature leaves over may be the unit's own; a pattern in time that is the same in every counter
of every channel is not.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from bench.analysis import Estimates, Evidence, Material
from bench.maths.arrays import Floats
from bench.maths.tests import chi2_tail, of_many, t_both
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.constants import CALIBRATOR, Campaign, Standards, expired
from bench.systems.af_converter.estimators.pulses import count_step
from bench.systems.af_converter.estimators.readings import QUANTISATION
from bench.systems.af_converter.group_fit import (
    QUANTITIES,
    SCALE_FACTORS,
    Fitted,
    GroupFit,
    about,
    plausible,
    probability_of,
    refit,
)
from bench.systems.af_converter.groups import place_name
from bench.systems.af_converter.scale_factor.calibrator_drift import Pair, change_ppm, repeats
from bench.systems.af_converter.wording import say

COEFFICIENTS = {quantity: (f"{quantity}_tc1", f"{quantity}_tc2") for quantity in QUANTITIES}
_HOUR_S = 3600.0
_AGREED = 1e-3  # counters that scatter by chance no more often have steps of their own
_LEAST_SHARE = 1e-3  # of a step that the polynomial does not take in
_MEAN = np.array([-0.5, -0.5])  # a calibrator that delivers more makes both counters count more
_LOOKED_AT = 1e-3  # far above the level of any campaign, so that the refits cost nothing in a right world


@dataclass(frozen=True)
class _Series:
    """DSF_N or DSF_P of a channel over its visits, (k,), in order of time, and what its polynomial makes of them.

    ``noise_ppm2`` (k, 2, 2): that of both counters, which share the rows of a visit.
    """

    quantity: str
    channel: int
    time_s: Floats
    value_ppm: Floats
    noise_ppm2: Floats
    operator: Floats
    design: Floats

    def weights(self, at_s: float) -> Floats | None:
        """Return what makes the step at a time of the values, (k,); None if the polynomial takes it in."""
        pattern = self._pattern(at_s)
        left = pattern - self.design @ (self.operator @ pattern)
        index = QUANTITIES.index(self.quantity)
        variance = self.noise_ppm2[:, index, index]
        information = float(left @ (left / variance))
        if information * variance.min() < _LEAST_SHARE:
            return None
        taken = left / variance / information
        return taken - (taken @ self.design) @ self.operator

    def move(self, at_s: float, step_ppm: float, entries: Estimates) -> float:
        """Return how far a step moves a coefficient, in its expanded uncertainty; the constant goes with the values."""
        moved = np.abs(self.operator @ self._pattern(at_s)) * abs(step_ppm)
        stated = _stated(entries, COEFFICIENTS[self.quantity], self.channel)
        return float(np.max(moved[1:] / stated))

    def _pattern(self, at_s: float) -> Floats:
        return np.asarray(self.time_s > at_s, dtype=np.float64)


def common_step(fitted: Fitted, entries: Estimates) -> list[Evidence]:
    """Return what the counters of all channels say of one step in time between their visits.

    Of the values, and of their temperature coefficients, which a smaller step moves; ``entries`` state both.
    Source: the noise of the visits, or Student's t over the channels where these scatter more; union bound over times.
    """
    series = _all_series(fitted)
    times_s = np.unique(np.concatenate([np.zeros(1), *(entry.time_s for entry in series)]))[1:]
    found = [(at_s, *_judged(series, at_s)) for at_s in (times_s[1:] + times_s[:-1]) / 2.0]
    if not found:
        return []
    at_s, step_ppm, chance = min(found, key=lambda each: each[2])
    probability = of_many(chance, len(found))
    hours = (at_s - times_s.min(initial=at_s)) / _HOUR_S
    of_values = max((abs(step_ppm) / U_ppm for U_ppm in _stated(entries, QUANTITIES)), default=0.0)
    of_slopes = max((entry.move(at_s, step_ppm, entries) for entry in series), default=0.0)
    return [
        Evidence(
            "common_step",
            say("evidence.common_step", step=step_ppm, hours=hours, move=move),
            step_ppm,
            probability,
            move,
            quantities,
        )
        for quantities, move in ((SCALE_FACTORS, of_values), (tuple(chain(*COEFFICIENTS.values())), of_slopes))
    ]


def _stated(entries: Estimates, quantities: Collection[str], channel: int | None = None) -> list[float]:
    """Return the expanded uncertainties of some estimates, in their order."""
    return [
        entry.expanded_uncertainty
        for entry in entries
        if entry.quantity in quantities and channel in (None, entry.conditions.get("channel"))
    ]


def _all_series(fitted: Fitted) -> list[_Series]:
    series = []
    for (quantity, channel), polynomial in fitted.polynomials.items():
        visits = fitted.visits(channel)
        if quantity in QUANTITIES and len(visits) > polynomial.coefficients.size:
            warmth = np.array([visit.fit.unit_temperature_degC for visit in visits]) - polynomial.reference_degC
            series.append(
                _Series(
                    quantity=quantity,
                    channel=channel,
                    time_s=np.array([visit.fit.time_s for visit in visits]),
                    value_ppm=np.array([visit.fit.dsf_ppm[QUANTITIES.index(quantity)] for visit in visits]),
                    noise_ppm2=np.array([visit.fit.noise_ppm2 for visit in visits]),
                    operator=polynomial.operator,
                    design=np.vander(warmth, polynomial.coefficients.size, increasing=True),
                )
            )
    return series


def _judged(series: list[_Series], at_s: float) -> tuple[float, float]:
    """Return the common step at a time, ppm, and its probability by chance; a channel is the mean of its counters."""
    of_channel: dict[int, list[tuple[_Series, Floats]]] = {}
    for entry in series:
        weights = entry.weights(at_s)
        if weights is not None:
            of_channel.setdefault(entry.channel, []).append((entry, weights))
    if len(of_channel) < 2:
        return 0.0, 1.0
    values, variances = (np.array(column) for column in zip(*map(_mean_step, of_channel.values()), strict=True))
    mean = float(values.mean())
    if chi2_tail(float(np.sum((values - mean) ** 2 / variances)), values.size - 1) > _AGREED:
        return mean, t_both(mean * values.size / float(np.sqrt(np.sum(variances))))
    return mean, t_both(mean * values.size**0.5 / float(values.std(ddof=1)), values.size - 1)


def _mean_step(counters: list[tuple[_Series, Floats]]) -> tuple[float, float]:
    """Return the step of a channel, ppm, and its variance: its counters share the noise of their rows."""
    step_ppm = float(np.mean([weights @ entry.value_ppm for entry, weights in counters]))
    variance = sum(
        float(
            np.sum(
                one * other * entry.noise_ppm2[:, QUANTITIES.index(entry.quantity), QUANTITIES.index(beside.quantity)]
            )
        )
        for entry, one in counters
        for beside, other in counters
    )
    return step_ppm, variance / len(counters) ** 2


def unsteady(pairs: Sequence[Pair], fitted: Fitted, entries: Estimates) -> list[Evidence]:
    """Return of each channel that is repeated more than once whether its changes lie on a straight line in time.

    Visits whose levels do not lie on a line say nothing of the calibrator, and those of a channel without temperature
    coefficients nothing that warming could not.
    """
    of_channel: dict[int, list[Pair]] = {}
    for pair in pairs:
        channel = pair[1].group.channel
        if fitted.knows_slopes(channel) and all(visit.fits for visit in pair):
            of_channel.setdefault(channel, []).append(pair)
    return [_judged_pairs(repeated, fitted, entries) for repeated in of_channel.values() if len(repeated) > 1]


def _judged_pairs(pairs: Sequence[Pair], fitted: Fitted, entries: Estimates) -> Evidence:
    start = pairs[0][0]
    time_s = np.array([again.fit.time_s - start.fit.time_s for start, again in pairs])
    change = np.array([float(_MEAN @ change_ppm(start, again, fitted)[0]) for start, again in pairs])
    own = [float(_MEAN @ again.fit.noise_ppm2 @ _MEAN) for _, again in pairs]
    covariance = np.diag(own) + float(_MEAN @ start.fit.noise_ppm2 @ _MEAN)
    weighted = np.linalg.solve(covariance, time_s)
    left = change - time_s * (weighted @ change) / (weighted @ time_s)
    chi2 = float(left @ np.linalg.solve(covariance, left))
    probability = chi2_tail(chi2, len(pairs) - 1)
    worst_ppm = float(np.abs(left).max())
    move = worst_ppm * _worst_move(fitted, entries)
    sentence = say("evidence.unsteady_drift", place=place_name(start.group.place), left=worst_ppm, move=move)
    return Evidence("unsteady_drift", sentence, worst_ppm, probability, move, tuple(chain(*COEFFICIENTS.values())))


def _worst_move(fitted: Fitted, entries: Estimates) -> float:
    """Return by how much of its expanded uncertainty a step of 1 ppm at the worst time moves a coefficient."""
    stated = {(entry.quantity, entry.conditions.get("channel")): entry.expanded_uncertainty for entry in entries}
    moves = [0.0]
    for (quantity, channel), polynomial in fitted.polynomials.items():
        if quantity in COEFFICIENTS:
            time_s = np.array([visit.fit.time_s for visit in fitted.visits(channel)])
            steps = np.array([time_s > at_s for at_s in time_s], dtype=np.float64)
            of_orders = np.abs(polynomial.operator[1:] @ steps.T).max(axis=1)
            names = COEFFICIENTS[quantity][: of_orders.size]
            moves += [move / stated[name, channel] for name, move in zip(names, of_orders.tolist(), strict=True)]
    return max(moves)


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
    return Evidence("lack_of_fit", sentence, fit.reduced_chi2, probability, move, SCALE_FACTORS, _about(visit))


def _whole_counts(visit: GroupFit) -> Evidence:
    """Return whether the counts of a visit are single pulses, or go in steps of several of them.

    A step of g moves each reading by as much of a pulse as chance does by one: standard deviation g / sqrt(12).
    """
    fit, rows = visit.fit, visit.group.closed
    counts, levels_A = np.concatenate([rows.n_count, rows.p_count]), np.unique([0.0, *rows.level_A])
    step, probability = count_step(counts, counts.max() * np.diff(levels_A).min() / levels_A[-1])
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
