"""What the data of a DMM campaign say against its model, group by group, and what the points taken again say.

Half differences and half sums of all levels must lie on one straight line
within the uncertainties of meter and counts, and a line that is carried by one level is not that of the converter. A
point that is taken again must show the same unit against the same meter.
Source: docs/decisions/0025-doubt.md; docs/decisions/0007-dmm-method.md.

Agreement of the DMM method with the calibrator method on the same records, what both share being left out.

Both count the same pulses, and a register may say that both standards were calibrated with the same one.
Source: docs/decisions/0036-standards-once.md; ISO/IEC 17043 for E_n.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.analysis import Estimates, Evidence, Material, Table, covariance_by_standards
from bench.maths.arrays import Flags, Floats
from bench.maths.tests import chi2_tail, of_many, t_both
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.af_converter.constants import CALIBRATOR, Campaign, Standards, common_errors, read_standards
from bench.systems.af_converter.dmm_method.estimates import DmmFit, shared_by_standards
from bench.systems.af_converter.estimators.dmm_method import DmmScaleFactor, Meter, fit_dmm_method
from bench.systems.af_converter.estimators.readings import Converter, RangeSpecification, noise_parts
from bench.systems.af_converter.estimators.scale_factor import ScaleFactor, fit_scale_factor, usable_rows
from bench.systems.af_converter.group_fit import ODD, QUANTITIES, SCALE_FACTORS, about, plausible
from bench.systems.af_converter.groups import Group, place_name
from bench.systems.af_converter.wording import say

Register = Mapping[float, RangeSpecification]
ALL_QUANTITIES = (*SCALE_FACTORS, "dsf_mean")
_NO_CHANCE = 1e-9  # of a chi-square: something is wrong with the group
_LIKELY = 1e-3  # of that of the others, if one level alone is wrong
_LOOKED_AT = 1e-3  # far above the level of any campaign, so that the refits cost nothing in a right world
_ANY_GAIN = 1e-2  # relative, of a range of which nothing is known
_GAINED = 6.6  # of chi-square with one more unknown: once in a hundred
_HEADS = ("channel", "quantity", "degC", "dmm", "calibrator", "difference", "U", "E_n")


def evidence(
    fits: Sequence[DmmFit], repeats: Sequence[Group], entries: Estimates, campaign: Campaign, register: Register,
    method: str,
) -> list[Evidence]:  # fmt: skip
    """Return what every check says of the estimates, those that found nothing included."""
    return [
        *(seen for fitted in fits for seen in plausible(fitted.group, _values_ppm(fitted.fit), campaign)),
        *(_straight(fitted, campaign, register, method) for fitted in fits),
        *(_range_off(fits, campaign, register) if method == "joint" else ()),
        *_taken_again(fits, repeats, entries),
    ]


def without_odd_level(
    group: Group, meter: Meter, converter: Converter, register: Register, fit: DmmScaleFactor
) -> tuple[Group, Meter]:
    """Leave out the one level that is unlike all others: with it the rows cannot fit, without it they do.

    Not the largest one, for there it may be the converter, and none if there are several such levels.
    """
    if probability_of(fit) >= _NO_CHANCE:
        return group, meter
    level_A = group.closed.level_A
    found = [
        level
        for level in np.unique(level_A[(level_A > 0) & (level_A < level_A.max())])
        if (other := _refit(group, meter, level_A != level, converter, register)) and probability_of(other) > _LIKELY
    ]
    if len(found) != 1:
        return group, meter
    for row in np.flatnonzero(level_A == found[0])[::-1]:
        group = group.without(int(row), ODD)
    return group, meter.take(level_A != found[0])


def probability_of(fit: DmmScaleFactor) -> float:
    """Return the probability of a chi-square at least as large; 1 where it says nothing."""
    return chi2_tail(fit.chi2, fit.dof) if math.isfinite(fit.chi2) else 1.0


def _values_ppm(fit: DmmScaleFactor) -> Floats:
    return np.array([fit.value_ppm[name] for name in ("dsf_n", "dsf_p", "dsf_mean") if name in fit.value_ppm])


def _refit(group: Group, meter: Meter, kept: Flags, converter: Converter, register: Register) -> DmmScaleFactor | None:
    try:
        return fit_dmm_method(group.closed.take(kept), meter.take(kept), converter, register)
    except FitError:
        return None


def _straight(fitted: DmmFit, campaign: Campaign, register: Register, method: str) -> Evidence:
    """Return whether the levels lie on a straight line, and how far one level carries the result."""
    fit, probability = fitted.fit, probability_of(fitted.fit)
    looked_at = method == "joint" and probability < _LOOKED_AT
    without, move = _carried(fitted, campaign, register) if looked_at else (say("without.any"), 0.0)
    reduced = fit.chi2 / fit.dof if fit.dof else math.nan
    where = place_name(fitted.group.place)
    sentence = say("evidence.meter_not_straight", place=where, chi2=reduced, without=without, move=move)
    figure = reduced if math.isfinite(reduced) else None
    return Evidence("lack_of_fit", sentence, figure, probability, move, ALL_QUANTITIES, about(fitted.group))


def _carried(fitted: DmmFit, campaign: Campaign, register: Register) -> tuple[str, float]:
    """Return the level or range without which the result moves most, and by how much of its expanded uncertainty.

    A range without its gain counts where the line is a better one then.
    """
    group, converter = fitted.group, campaign.converter(fitted.group.channel)
    moves: list[tuple[str, float]] = []
    for level_A in np.unique(group.closed.level_A[group.closed.level_A > 0]):
        other = _refit(group, fitted.meter, group.closed.level_A != level_A, converter, register)
        if other is not None:
            moves.append((say("without.level", level=1e3 * level_A), _moved(fitted, other)))
    for range_A in np.unique(fitted.meter.range_A):
        gained, moved = _without_gain(fitted, float(range_A), campaign, register)
        if gained > _GAINED:
            moves.append((say("without.gain", range=1e3 * range_A), moved))
    return max(moves, key=lambda pair: pair[1], default=(say("without.any"), math.inf))


def _without_gain(fitted: DmmFit, range_A: float, campaign: Campaign, register: Register) -> tuple[float, float]:
    """Return what chi-square gains where the gain of a range is anything, and by how much the result moves then."""
    free = {full: replace(entry, relative=_ANY_GAIN) if _same(full, range_A) else entry
            for full, entry in register.items()}  # fmt: skip
    every = np.ones(fitted.meter.range_A.size, bool)
    other = _refit(fitted.group, fitted.meter, every, campaign.converter(fitted.group.channel), free)
    return (0.0, 0.0) if other is None else (fitted.fit.chi2 - other.chi2, _moved(fitted, other))


def _range_off(fits: Sequence[DmmFit], campaign: Campaign, register: Register) -> Iterator[Evidence]:
    """Yield whether all channels lie on straight lines once the gain of one range of the meter is anything.

    One channel alone is no evidence against the meter: there it may be the converter.
    """
    ranges_A = sorted({float(range_A) for fitted in fits for range_A in np.unique(fitted.meter.range_A)})
    for range_A in ranges_A:
        gained, moves = zip(*(_without_gain(fitted, range_A, campaign, register) for fitted in fits), strict=True)
        several = sum(gain > _GAINED for gain in gained) > 1
        # the gain of a range is the same in all channels: their gains of chi-square are not independent
        probability = of_many(chi2_tail(max(gained), 1), len(fits)) if several else 1.0
        sentence = say("evidence.meter_range_off", range=1e3 * range_A, move=max(moves))
        yield Evidence("meter_range_off", sentence, 1e3 * range_A, probability, max(moves), ALL_QUANTITIES)


def _same(one_A: float, other_A: float) -> bool:
    return abs(one_A - other_A) <= 1e-6 * other_A


def _moved(fitted: DmmFit, other: DmmScaleFactor) -> float:
    """Return by how much another fit of a group moves its result, in expanded uncertainties."""
    fit = fitted.fit
    moved = max(abs(other.value_ppm[name] - value) / fit.std_ppm[name] for name, value in fit.value_ppm.items())
    return moved / coverage_factor()


def _taken_again(fits: Sequence[DmmFit], repeats: Sequence[Group], entries: Estimates) -> Iterator[Evidence]:
    """Yield by how much a channel that was taken again is another against the meter.

    Half the sum over both polarities of a level, which the bias does not enter, weighted over the levels. A drift is
    in the difference of both polarities by as much of it as lies between their records.
    """
    first = {fitted.group.place[:2]: fitted for fitted in fits}
    for again in repeats:
        fitted = first.get(again.place[:2])
        levels: dict[float, list[tuple[float, float]]] = {}
        for entry in entries:
            at = entry.conditions
            if (
                entry.quantity == "repeat_shift"
                and (at["channel"], at["temperature_degC"], at["repeat"]) == again.place
            ):
                levels.setdefault(at["current_A"], []).append((entry.value, entry.std_uncertainty))
        pairs = np.array([np.mean(both, axis=0) for both in levels.values() if len(both) == 2]).reshape(-1, 2)
        if fitted is None or not len(pairs):
            continue
        weights = 2.0 / pairs[:, 1] ** 2
        shift_ppm, std_ppm = float(np.average(pairs[:, 0], weights=weights)), float(np.sum(weights) ** -0.5)
        sentence = say("evidence.not_repeated", place=place_name(fitted.group.place), shift=shift_ppm)
        probability = t_both(shift_ppm / std_ppm)
        for quantities, moved_ppm in (
            (("dsf_n", "dsf_p", "dsf_mean"), abs(shift_ppm)),
            (("dsf_asymmetry",), abs(shift_ppm) * _between_polarities(fitted.group, again)),
        ):
            move = moved_ppm / (coverage_factor() * _smallest_ppm(fits, quantities))
            yield Evidence("not_repeated", sentence, shift_ppm, probability, move, quantities)


def _between_polarities(first: Group, again: Group) -> float:
    """Return the time between both polarities of a group, of that until it was taken again."""
    rows = first.closed
    between_s = rows.time_s[rows.polarity < 0].mean() - rows.time_s[rows.polarity > 0].mean()
    return abs(float(between_s / (again.closed.time_s.mean() - rows.time_s.mean())))


def _smallest_ppm(fits: Sequence[DmmFit], quantities: Sequence[str]) -> float:
    known = [fitted.fit.std_ppm[name] for fitted in fits for name in quantities if name in fitted.fit.std_ppm]
    return min(known, default=math.inf)


def agreement_table(fits: Iterable[DmmFit], material: Material, campaign: Campaign) -> list[Table]:
    """Return differences to the calibrator method, where the register holds the calibrator and both have a result."""
    if CALIBRATOR not in material.standards:
        return []
    standards = read_standards(material.standards)
    rows: list[list[Any]] = []
    for fitted in fits:
        converter = campaign.converter(fitted.group.channel)
        try:
            other = fit_scale_factor(fitted.group.closed, converter, standards.ranges)
        except FitError:
            continue  # the DMM method stands by itself
        for index, name in enumerate(QUANTITIES):
            if name not in fitted.fit.value_ppm:
                continue
            value_ppm, other_ppm = fitted.fit.value_ppm[name], float(other.dsf_ppm[index])
            std_ppm = difference_std_ppm(fitted, other, index, campaign, standards)
            expanded = coverage_factor() * std_ppm
            place = [fitted.group.channel, name, fitted.group.temperature_degC]
            difference = value_ppm - other_ppm
            rows.append([*place, value_ppm, other_ppm, difference, expanded, difference / expanded])
    if not rows:
        return []
    largest = max(abs(row[-1]) for row in rows)
    headers = say.heads("agreement", *_HEADS)
    return [Table(say("agreement.title"), say("agreement.caption", largest=largest), headers, rows)]


def difference_std_ppm(
    fitted: DmmFit, other: ScaleFactor, index: int, campaign: Campaign, standards: Standards
) -> float:
    """Return the standard uncertainty of DSF_N (index 0) or DSF_P (1) by the meter minus the same by the calibrator.

    Args:    fitted: of the DMM method.   other: of the calibrator method, by the same closed rows.
    Returns: ppm.
    Raises:  nothing.
    Source:  JCGM 100:2008 equation (16), with the covariance by the counts and by what the standards share.
    """
    name, rows = QUANTITIES[index], fitted.group.closed
    usable = usable_rows(rows)
    of_counts = np.sum(list(noise_parts(rows.take(usable), campaign.converter(fitted.group.channel)).values()), axis=0)
    by_counts = other.operator_ppm[index][usable] @ of_counts @ fitted.fit.operators_ppm[name][usable]
    parts = {label: float(effect_ppm[index]) for label, effect_ppm in other.standard_ppm.items()}
    by_standards = covariance_by_standards(
        common_errors(standards.register, CALIBRATOR, parts, {}), shared_by_standards(fitted, name, standards.register)
    )
    of_calibrator = math.fsum(part**2 for part in parts.values()) + standards.drift_ppm**2
    variance = fitted.fit.std_ppm[name] ** 2 + float(other.noise_ppm2[index, index]) + of_calibrator
    return math.sqrt(max(variance - 2.0 * (float(by_counts) + by_standards), 0.0))
