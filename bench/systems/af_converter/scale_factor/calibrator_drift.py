"""Changes during a campaign: first visits and repeats of a channel, and what the session itself says of the
calibrator's drift by a meter before and after the campaign or by the closing repeat.

Decision: docs/method-af-converter.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from bench.analysis import Estimate, Estimates, Reading, estimate, with_uncertainty
from bench.maths.arrays import Floats
from bench.systems.af_converter.constants import DRIFT_UNKNOWN, Campaign, Standards
from bench.systems.af_converter.dmm_method.estimates import CHECK, ReadingSet, reading_sets
from bench.systems.af_converter.estimators.readings import Readings
from bench.systems.af_converter.group_fit import (
    QUANTITIES,
    Fitted,
    GroupFit,
    UNKNOWN_SLOPE_ppm_degC,
    conditions_of,
    refit,
)
from bench.systems.af_converter.wording import say

if TYPE_CHECKING:
    from bench.record import RecordRow

_HOUR_S = 3600.0
_PPM = 1e6
_IN_THE_LOOP = 1e-3  # a meter that reads further from the level is not in the loop, or on the wrong range
METER_CHECK, CLOSING_REPEAT = say("source.meter_check"), say("source.closing_repeat")
Pair = tuple[GroupFit, GroupFit]


@dataclass(frozen=True)
class CalibratorDrift:
    """Estimates ``calibrator_drift`` in ppm, positive = the calibrator delivers more at the end than before.

    ``bound_ppm``: 95 % bound of the drift over the campaign, None if nothing was seen; ``source``: who saw it.
    """

    bound_ppm: float | None = None
    source: str = ""
    estimates: Estimates = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def applied_to(self, standards: Standards) -> Standards:
        """Return the register with the larger of the declared drift and the one seen."""
        if self.bound_ppm is None:
            return standards
        others = tuple(note for note in standards.notes if note != DRIFT_UNKNOWN)
        seen = self.bound_ppm / _PPM / 2.0
        if standards.drift is not None and standards.drift >= seen:
            return standards
        return replace(standards, drift=seen, drift_source=self.source, notes=others)


def calibrator_drift(
    pairs: Sequence[Pair], fitted: Fitted, rows: Sequence[RecordRow], readings: Iterable[Reading]
) -> CalibratorDrift:
    """Drift of the calibrator by the meter, where it was read before and after, else by the closing repeat."""
    begin_s = 1e-9 * min(row.window.t_start_ns for row in rows)
    end_s = 1e-9 * max(row.window.t_end_ns for row in rows)
    checks = [check for check in reading_sets(readings) if CHECK in check.conditions]
    seen = [check for check in checks if abs(check.mean_A - _level(check)) <= _IN_THE_LOOP * _level(check)]
    by_meter = _by_meter(seen, begin_s, end_s)
    if len(seen) < len(checks):
        said = say("drift.not_seen", count=len(checks) - len(seen), of=len(checks))
        by_meter = replace(by_meter, notes=[said, *by_meter.notes])
    by_repeat = _by_repeat(pairs, fitted, end_s - begin_s)
    if by_meter.bound_ppm is None:
        return replace(by_repeat, notes=by_meter.notes + by_repeat.notes)
    agreed = _compared(by_meter, by_repeat)
    return replace(by_meter, estimates=by_meter.estimates + by_repeat.estimates, notes=by_meter.notes + agreed)


def _by_meter(checks: Sequence[ReadingSet], begin_s: float, end_s: float) -> CalibratorDrift:
    before = {_level(check): check for check in checks if check.end_s <= begin_s}
    after = {_level(check): check for check in checks if check.begin_s >= end_s}
    entries = []
    for level_A in sorted(before.keys() & after.keys()):
        first, last = before[level_A], after[level_A]
        value_ppm = _PPM * (last.mean_A - first.mean_A) / level_A
        std_ppm = _PPM * float(np.hypot(first.std_A, last.std_A)) / level_A
        conditions = {"check": METER_CHECK, "current_A": level_A, "hours": (last.end_s - first.begin_s) / _HOUR_S}
        counted = len(first.values_A) + len(last.values_A)
        entries.append(estimate("calibrator_drift", "ppm", value_ppm, std_ppm, conditions, n=counted))
    if not entries:
        return CalibratorDrift(notes=[say("drift.one_side")] if checks else [])
    widest = max(entries, key=_bound_ppm)
    where, U_ppm = widest.conditions, widest.expanded_uncertainty
    level_mA = 1e3 * where["current_A"]
    note = say("drift.by_meter", hours=where["hours"], value=widest.value, U=U_ppm, level=level_mA)
    return CalibratorDrift(_bound_ppm(widest), METER_CHECK, entries, [note])


def _level(check: ReadingSet) -> float:
    return float(check.conditions[CHECK])


def _bound_ppm(entry: Estimate) -> float:
    return float(abs(entry.value) + entry.expanded_uncertainty)


def _by_repeat(pairs: Sequence[Pair], fitted: Fitted, campaign_s: float) -> CalibratorDrift:
    """A calibrator that delivers more makes the unit count more, which looks like a smaller charge per pulse.

    A change is taken to have gone on steadily through the campaign, at the bound that the repeat leaves, seen or not.
    Where a channel is repeated more than once, the repeat that leaves least counts, and every other that sees a change.
    Where its temperature coefficients are not known, drift and warming cannot be told apart: a repeat that sees no
    change bounds nothing then.
    """
    entries, notes, seen_ppm = [], [], []
    left_ppm: dict[int, tuple[float, float]] = {}  # channel -> what its best repeat leaves unseen, and its bound
    for start, again in pairs:
        change, covariance = change_ppm(start, again, fitted)
        mean = np.array([-0.5, -0.5])
        between_s = float(np.mean(again.group.closed.time_s) - np.mean(start.group.closed.time_s))
        conditions = {
            "check": CLOSING_REPEAT,
            "channel": again.group.channel,
            "temperature_degC": again.group.temperature_degC,
            "hours": between_s / _HOUR_S,
        }
        std_ppm = float(np.sqrt(mean @ covariance @ mean))
        entry = estimate("calibrator_drift", "ppm", float(mean @ change), std_ppm, conditions, n=again.fit.n)
        entries.append(entry)
        scale = max(1.0, campaign_s / between_s) if between_s > 0 else 1.0
        seen = abs(entry.value) > entry.expanded_uncertainty
        bound_ppm = _bound_ppm(entry) * scale
        seen_ppm += [bound_ppm] * seen
        if fitted.knows_slopes(again.group.channel):
            left = entry.expanded_uncertainty * scale, bound_ppm
            left_ppm[again.group.channel] = min(left, left_ppm.get(again.group.channel, left))
        elif not seen:
            notes.append(
                say(
                    "drift.untold",
                    what=_changed(entry),
                    warmer=_warmer_degC(start, again),
                    slope=UNKNOWN_SLOPE_ppm_degC,
                )
            )
            continue
        notes.append(_repeat_note(entry, scale, campaign_s, seen))
    bounds_ppm = [*seen_ppm, *(bound_ppm for _, bound_ppm in left_ppm.values())]
    return CalibratorDrift(max(bounds_ppm, default=None), CLOSING_REPEAT, entries, notes)


def _changed(entry: Estimate) -> str:
    where, change = entry.conditions, with_uncertainty(entry.value, entry.expanded_uncertainty)
    return say("drift.repeat", channel=where["channel"], change=change, hours=where["hours"])


def _repeat_note(entry: Estimate, scale: float, campaign_s: float, seen: bool) -> str:
    what, hours = _changed(entry), campaign_s / _HOUR_S
    if seen:
        return say("drift.seen", what=what, hours=hours)
    return say("drift.unseen", what=what, unseen=scale * entry.expanded_uncertainty, hours=hours)


def _compared(by_meter: CalibratorDrift, by_repeat: CalibratorDrift) -> list[str]:
    """Return whether the closing repeat shows more than the meter did: then it is the unit that changed."""
    hours = by_meter.estimates[0].conditions["hours"]
    mean_ppm = float(np.mean([entry.value for entry in by_meter.estimates]))
    notes: list[str] = []
    for entry in by_repeat.estimates:
        rest_ppm = entry.value - mean_ppm * entry.conditions["hours"] / hours
        if abs(rest_ppm) > entry.expanded_uncertainty:
            notes.append(say("drift.of_unit", channel=entry.conditions["channel"], rest=rest_ppm))
    return notes


def repeats(fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> list[Pair]:
    """First visit and repeat of every channel and temperature that was visited again, by the points both hold.

    With other points in one of them, such as more zeros, the errors of the calibrator would not cancel.
    """
    first = {
        (visit.group.channel, visit.group.temperature_degC): visit for visit in fitted.groups if visit.group.repeat == 0
    }
    pairs = []
    for again in (visit for visit in fitted.groups if visit.group.repeat):
        start = first.get((again.group.channel, again.group.temperature_degC))
        if start is None:
            continue
        sides = ((start, again), (again, start))
        both = [_common(visit, other, fitted, campaign, standards, method) for visit, other in sides]
        pairs.append((both[0], both[1]))
    return pairs


def _common(
    visit: GroupFit, other: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> GroupFit:
    """Return a group fitted by its points that the other group has too; as it was if that is all, or too few."""
    theirs = set(_points(other.group.closed))
    kept = np.array([point in theirs for point in _points(visit.group.closed)])
    if kept.all():
        return visit
    fit = refit(visit, kept, fitted, campaign, standards, method)
    return visit if fit is None else replace(visit, fit=fit)


def _points(rows: Readings) -> list[tuple[float, float, float]]:
    return list(zip(rows.polarity.tolist(), rows.level_A.tolist(), rows.range_A.tolist(), strict=True))


def change_ppm(start: GroupFit, again: GroupFit, fitted: Fitted) -> tuple[Floats, Floats]:
    """Change (2,) of DSF_N, DSF_P from a first visit to its repeat and its covariance (2, 2), ppm.

    At the temperature of the first visit; everything common to both cancels. Temperature coefficients that the campaign
    does not determine count as 0 with the standard uncertainty of coefficients that nobody knows.
    """
    channel, warmer_degC = again.group.channel, _warmer_degC(start, again)
    slopes = fitted.slopes_ppm_degC(channel, again.fit.unit_temperature_degC)
    change = again.fit.dsf_ppm - start.fit.dsf_ppm - np.array(slopes) * warmer_degC
    here, there, nothing = again.fit.standard_ppm, start.fit.standard_ppm, np.zeros(2)
    labels = sorted(here.keys() | there.keys())
    effects = [here.get(label, nothing) - there.get(label, nothing) for label in labels]
    shared = np.sum([np.outer(effect, effect) for effect in effects], axis=0)
    if not fitted.knows_slopes(channel):
        visits_degC = again.fit.unreferred_degC, start.fit.unreferred_degC
        away_degC = warmer_degC * np.eye(2) + visits_degC[0] - visits_degC[1]
        counted = visits_degC if fitted.guesses_slopes(channel) else ()  # in the noise of each visit already
        of_each = np.sum([visit_degC @ visit_degC.T for visit_degC in counted], axis=0)
        shared = shared + UNKNOWN_SLOPE_ppm_degC**2 * (away_degC @ away_degC.T - of_each)
    return np.asarray(change), again.fit.noise_ppm2 + start.fit.noise_ppm2 + shared


def _warmer_degC(start: GroupFit, again: GroupFit) -> float:
    return again.fit.unit_temperature_degC - start.fit.unit_temperature_degC


def drift_estimates(pairs: list[Pair], fitted: Fitted, campaign: Campaign) -> Estimates:
    """Repeat minus first visit of a channel, at the temperature of the first; everything common cancels."""
    entries = []
    for start, again in pairs:
        change, covariance = change_ppm(start, again, fitted)
        for index, quantity in enumerate(QUANTITIES):
            conditions = conditions_of(start.group, start.fit.unit_temperature_degC, campaign) | {
                "repeat": again.group.repeat
            }
            std_ppm = float(np.sqrt(covariance[index, index]))
            entries.append(estimate(f"{quantity}_drift", "ppm", change[index], std_ppm, conditions, n=again.fit.n))
    return entries
