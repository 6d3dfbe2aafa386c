"""The scale-factor campaign: from records to estimates, residuals, budget and notes.

Source: AF-converter paper section 3; docs/method-af-converter.md.

Before its first hour they are those of the records that a unit without error and noise would give. What their
uncertainties rest on is planned or declared: times, levels, temperatures, noise, quantum, standards.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import (
    LEAST_MOVE,
    Analysis,
    Estimate,
    Material,
    Planned,
    Prediction,
    Table,
    unseen_tables,
    worded_table,
)
from bench.maths.arrays import Flags, rms
from bench.maths.verdict import coverage_factor
from bench.systems.af_converter.coefficients import scale_factor_compensation
from bench.systems.af_converter.constants import Campaign, Standards, read_campaign
from bench.systems.af_converter.estimators.readings import Readings
from bench.systems.af_converter.estimators.scale_factor import METHODS as FIT_METHODS
from bench.systems.af_converter.estimators.scale_factor import ScaleFactor
from bench.systems.af_converter.group_fit import (
    QUANTITIES,
    Fitted,
    GroupFit,
    UNKNOWN_SLOPE_ppm_degC,
    conditions_of,
    left_out_notes,
    missing_groups,
    quality_of,
    refit,
)
from bench.systems.af_converter.groups import Group, LONGEST_REACH_s, place_name
from bench.systems.af_converter.scale_factor.budgets import budget_tables, components
from bench.systems.af_converter.scale_factor.departures import judged
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.systems.af_converter.wording import kind_name, say

if TYPE_CHECKING:
    from bench.record import RecordRow


_STEP_ppm = 0.01 * UNKNOWN_SLOPE_ppm_degC  # what 0.01 degC counts without coefficients
METHODS = FIT_METHODS
_FEWEST = 5  # records that tell a change of temperature


def analyse(material: Material, method: str = "gls") -> Analysis:
    """Return estimate scale-factor errors, their temperature coefficients, biases and clock errors of a campaign.

    Args:    material: records with their counts and conditions, sections of the session manifest.
             method: "gls", "paper" (equation 11) or "ols" (equation 10).
    Returns: Analysis. Groups that are not determined have no estimate and are named in ``missing`` and ``notes``.
    Raises:  FitError B-FIT-003 to B-FIT-009; B-FIT-001, -005, -006 or -012 if no group at all is determined.
    Source:  AF-converter paper section 3; docs/method-af-converter.md.
    """
    known = determine(material, method)
    constants, register, fitted, chosen = known.constants, known.standards, known.fitted, known.rows
    entries, zero_gain = known.estimates, zero_gain_table(fitted, constants, register, method)
    heard, searched = judged(fitted, entries, constants, register, material)
    missing = missing_groups(chosen, {visit.group.place for visit in fitted.groups}, fitted.refused, constants)
    return Analysis(
        constants.analysis,
        method,
        constants.uut,
        entries,
        evidence=heard,
        residuals=residuals(fitted.groups, constants),
        components=components(fitted, constants, register),
        groups=[quality_of(visit.group, visit.fit, constants) for visit in fitted.groups],
        notes=[
            *(say("note.no_result", what=sentence) for sentence in missing),
            *notes(fitted, constants, register, chosen),
            *known.drift.notes,
            *zero_gain_notes(zero_gain),
        ],
        missing=missing,
        tables=[*budget_tables(fitted, constants, register, method), *zero_gain, *unseen_tables([searched])],
        compensation=scale_factor_compensation(fitted, constants),
    )


def residuals(groups: Iterable[GroupFit], campaign: Campaign) -> list[dict[str, Any]]:
    """One entry per closed row of the first visits and repeats: what the fit left over, ampere and ppm of the level.

    ``current_A`` is signed; ``residual_ppm`` and ``std_ppm`` are NaN for zero rows.
    """
    entries = []
    for visit in groups:
        conditions = conditions_of(visit.group, visit.fit.unit_temperature_degC, campaign)
        rows = visit.group.closed
        for index, number in enumerate(visit.group.numbers):
            level_A = float(rows.level_A[index])
            to_ppm = 1e6 / level_A if level_A else float("nan")
            entries.append(
                {
                    "number": number,
                    "channel": visit.group.channel,
                    "kind": conditions["kind"],
                    "temperature_degC": visit.group.temperature_degC,
                    "repeat": visit.group.repeat,
                    "current_A": float(rows.polarity[index]) * level_A,
                    "range_A": float(rows.range_A[index]),
                    "residual_A": float(visit.fit.residual_A[index]),
                    "residual_ppm": float(visit.fit.residual_A[index]) * to_ppm,
                    "std_ppm": float(visit.fit.std_A[index]) * to_ppm,
                }
            )
    return entries


def notes(fitted: Fitted, campaign: Campaign, standards: Standards, rows: Sequence[RecordRow]) -> list[str]:
    """All notes but those on missing groups: records left out, and what the uncertainties do not hold."""
    notes = list(standards.notes) + _extrapolation(fitted, campaign)
    notes += _records(fitted, rows) + _temperature(fitted, campaign) + _short_soak(fitted)
    notes.append(say("note.bias_is_diagnostic"))
    return notes


def _extrapolation(fitted: Fitted, campaign: Campaign) -> list[str]:
    notes: list[str] = []
    for kind in dict.fromkeys(campaign.channel(visit.group.channel).kind for visit in fitted.groups):
        members = [visit.group for visit in fitted.groups if campaign.channel(visit.group.channel).kind == kind]
        share = min(
            float(group.closed.level_A.max()) / campaign.channel(group.channel).full_scale_A for group in members
        )
        if share < 0.999:
            notes.append(say("note.extrapolated", kind=kind_name(kind), share=100 * share))
    return notes


def _records(fitted: Fitted, rows: Sequence[RecordRow]) -> list[str]:
    groups = [visit.group for visit in fitted.groups] + [group for group, _ in fitted.refused]
    notes = left_out_notes(groups)
    interpolated = sum(
        int(np.count_nonzero(readings.temperature_std_degC))
        for group in groups
        for readings in (group.closed, group.opened)
    )
    if interpolated:
        notes.append(say("note.interpolated", count=interpolated, reach=LONGEST_REACH_s / 60))
    without_fg = sum(int(row.sums.get("fg_count", 0)) == 0 for row in rows)
    if without_fg:
        notes.append(say("note.without_generator", count=without_fg))
    for visit in fitted.groups:
        if visit.group.open_planned and visit.bias is None:
            notes.append(say("note.no_bias", place=place_name(visit.group.place)))
    return notes


def _temperature(fitted: Fitted, campaign: Campaign) -> list[str]:
    notes: list[str] = []
    known = [key for key in fitted.polynomials if key[0] in QUANTITIES]
    if campaign.temperature_sensor_u95_degC is None:
        notes.append(say("note.sensor_not_stated"))
    elif known:
        notes.append(say("note.sensor_gain"))
    if not known:
        notes.append(say("note.one_temperature", slope=UNKNOWN_SLOPE_ppm_degC))
    elif any(len(fitted.visits(key[1])) <= fitted.polynomials[key].coefficients.size for key in known):
        notes.append(say("note.no_verdict"))
    return notes


def _short_soak(fitted: Fitted) -> list[str]:
    """Say where the unit was still warming up: its converter may lag behind the sensor by what changes in a visit.

    Of a temperature coefficient the part counts that is beyond its own uncertainty.
    """
    worst = LEAST_MOVE
    notes: list[str] = []
    for visit in fitted.groups:
        change_degC, at_degC = _warming_degC(visit.group), visit.group.unit_temperature_degC
        for index, quantity in enumerate(QUANTITIES):
            polynomial = fitted.polynomials.get((quantity, visit.group.channel))
            if polynomial is None:
                continue
            least = abs(polynomial.slope(at_degC)) - coverage_factor() * polynomial.slope_std(at_degC)
            moved_ppm = max(least, 0.0) * abs(change_degC)
            share = moved_ppm / (coverage_factor() * float(np.sqrt(visit.fit.covariance_ppm2[index, index])))
            if share > worst:
                worst = share
                place = place_name(visit.group.place)
                notes = [say("note.short_soak", change=change_degC, place=place, moved=moved_ppm, share=share)]
    return notes


def _warming_degC(group: Group) -> float:
    """Return the change of the unit's temperature over a visit, by a straight line through its records."""
    time_s = np.concatenate([group.closed.time_s, group.opened.time_s])
    if time_s.size < _FEWEST or np.ptp(time_s) <= 0.0:
        return 0.0
    warmth_degC = np.concatenate([group.closed.unit_temperature_degC, group.opened.unit_temperature_degC])
    return float(np.polyfit((time_s - time_s.mean()) / np.ptp(time_s), warmth_degC, 1)[0])


def zero_gain_table(fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> list[Table]:
    """Standard uncertainty of the fit per kind, before the calibrator's gain is added: with all zeros, with one pair.

    Empty for a campaign with zeros in one range, and for methods that subtract zeros instead of weighting them.
    """
    pairs: dict[str, list[tuple[float, float]]] = {}
    for visit in fitted.groups:
        kept = one_zero_pair(visit.group.closed)
        if method != "gls" or visit.group.repeat or kept.all():
            continue
        alone = refit(visit, kept, fitted, campaign, standards, method)
        if alone is not None:
            kind = campaign.channel(visit.group.channel).kind
            pairs.setdefault(kind, []).append((_largest_ppm(visit.fit), _largest_ppm(alone)))
    rows = [[kind_name(kind), *(rms(side) for side in zip(*differences, strict=True))]
            for kind, differences in pairs.items()]  # fmt: skip
    if not rows:
        return []
    return [worded_table(say, "zeros", ["kind", "every", "pair"], rows)]


def zero_gain_notes(tables: list[Table]) -> list[str]:
    """Return the table in a sentence."""
    said = [
        say("zeros.said", kind=kind, every=every, pair=pair) for table in tables for kind, every, pair in table.rows
    ]
    together = said[0] if said else ""
    for more in said[1:]:
        together = say("list", first=together, rest=more)
    return [say("note.zeros", said=together)] if said else []


def one_zero_pair(rows: Readings) -> Flags:
    """Mask (m,) that leaves out the zeros of all ranges but the lowest that has any."""
    zeros = rows.level_A == 0
    lowest_A = rows.range_A[zeros].min(initial=np.inf)
    return np.asarray(~zeros | (rows.range_A == lowest_A))


def _largest_ppm(fit: ScaleFactor) -> float:
    return float(np.sqrt(np.diag(fit.covariance_ppm2).max()))


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a campaign will give; the values are those of a nominal unit.

    What only the temperature coefficients of the unit bring, the error of its temperature sensor above all, is missing:
    those of a nominal unit are zero. Where a plan does not determine them, the change between visits of a channel is
    named as missing: its uncertainty is that of coefficients by what the unit is warmer in one of both. All others then
    hold for a unit that is steady while a channel is measured.

    Raises:  FitError as ``analysis.analyse``, where no group at all is determined.
    """
    from bench.systems.af_converter.nominal import stimulated_row  # no fit needs it

    constants = read_campaign(planned.campaign)
    rows = [stimulated_row(window, constants) for window in planned.windows]
    known = determine(Material(rows, planned.campaign, planned.standards), METHODS[0])
    there = {visit.group.place for visit in known.fitted.groups}
    missing = missing_groups(rows, there, known.fitted.refused, constants)
    entries = [entry for entry in known.estimates if not _is_untold(entry, known.fitted)]
    return Prediction(entries, [*missing, *_untold(known.fitted)], _assumed(known.fitted))


def _is_untold(entry: Estimate, fitted: Fitted) -> bool:
    """Return whether an estimate is a change between visits that warming could be."""
    channel = entry.conditions.get("channel")  # a check by the meter has none
    return entry.quantity.endswith("_drift") and channel is not None and not fitted.knows_slopes(channel)


def _assumed(fitted: Fitted) -> list[str]:
    """Return a sentence on the unit, where no coefficients refer the rows of a visit to one temperature."""
    guessed = any(fitted.guesses_slopes(visit.group.channel) for visit in fitted.groups)
    return [say("predicted.steady", step=_STEP_ppm)] if guessed else []


def _untold(fitted: Fitted) -> Iterator[str]:
    for group in (visit.group for visit in fitted.groups):
        if group.repeat and not fitted.knows_slopes(group.channel):
            yield say("predicted.untold", place=place_name(group.place), step=_STEP_ppm)
