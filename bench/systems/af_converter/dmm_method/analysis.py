"""The DMM method as an analysis: the current meter's readings beside the records are the reference; notes and tables.

Where the calibrator is in the register too, both methods are compared, what both share being left out: they count the
same pulses, and both standards may have been calibrated with the same one.
Source: AF-converter paper section 3.1.2; docs/method-af-converter.md; docs/method-uncertainty.md; ISO/IEC 17043 for
E_n.

What the data say against the model: all visits of all channels are rows of one fit, readings being counted currents
against those that the meter read. Free are both counters of each channel and temperature, a current of each visit and
the leakage of the switch; errors of the meter are known as far as its specification. A point that is taken again must
show the same unit against the same meter, so its rows are here too.

Before its first hour the readings are those of a meter without noise: what counts of it is its register and a digit of
its display.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Estimate,
    Estimates,
    Material,
    Planned,
    Prediction,
    Reading,
    Searched,
    Table,
    covariance_by_standards,
    departures_of,
    evidence_of,
    operators_of,
    search,
    unseen_tables,
    worded_table,
)
from bench.maths.arrays import Flags, Floats
from bench.maths.verdict import coverage_factor
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.systems.af_converter.constants import (
    CALIBRATOR,
    METER,
    Campaign,
    Standards,
    common_errors,
    expired,
    read_campaign,
    read_ranges,
    read_standards,
    untraced,
)
from bench.systems.af_converter.dmm_method.estimates import (
    CHECK,
    CONFIGURE,
    MEASURE,
    ZERO,
    DmmFit,
    MeterLog,
    bias_estimates,
    budget,
    leakage_estimates,
    scale_factor_estimates,
    shared_by_standards,
    shift_estimates,
)
from bench.systems.af_converter.estimators.dmm_method import METHODS as FIT_METHODS
from bench.systems.af_converter.estimators.dmm_method import (
    DmmScaleFactor,
    Meter,
    by_range,
    fit_dmm_method,
    reference_A_of,
)
from bench.systems.af_converter.estimators.readings import GAIN, Converter, RangeSpecification, noise_parts
from bench.systems.af_converter.estimators.scale_factor import ScaleFactor, fit_scale_factor, usable_rows
from bench.systems.af_converter.group_fit import (
    LIKELY,
    NO_CHANCE,
    ODD,
    QUANTITIES,
    SCALE_FACTORS,
    fit_each,
    left_out_notes,
    missing_groups,
    plausible,
    probability_of,
    quality_of,
    require_closed,
)
from bench.systems.af_converter.groups import Group, campaign_rows, group_rows
from bench.systems.af_converter.scale_factor.departures import PPM, LevelRows, words_of
from bench.systems.af_converter.wording import say


def searched_rows(
    fits: Sequence[DmmFit], again: Sequence[Visit], entries: Estimates, campaign: Campaign,
    register: Mapping[float, RangeSpecification],
) -> Searched:  # fmt: skip
    """Return the search of the rows.

    ``again``: points that were taken again, with the readings beside their closed records.
    """
    rows = _rows_of(fits, again, campaign, register)
    residuals = rows.residuals(*rows.operators(entries))
    return Searched(search(residuals, departures_of(rows.labels())), words_of(rows.groups))


def _rows_of(
    fits: Sequence[DmmFit], again: Sequence[Visit], campaign: Campaign, register: Mapping[float, RangeSpecification]
) -> _Rows:
    known = {fitted.group.place[:2] for fitted in fits}
    visits = [(fitted.group, fitted.meter) for fitted in fits]
    visits += [(group, meter) for group, meter in again if group.place[:2] in known]
    of_visits, reference_A, std_A = [], [], []
    for group, meter in visits:
        usable = _usable(group, meter)
        rows, read = group.closed.take(usable), meter.take(usable)
        of_visits.append(replace(rows, range_A=read.range_A))
        reference_A.append(reference_A_of(rows, read, register))
        std_A.append(read.std_A)
    groups = [group for group, _ in visits]
    return _Rows(groups, of_visits, np.concatenate(reference_A), campaign, fits, register, np.concatenate(std_A))


def _usable(group: Group, meter: Meter) -> Flags:
    return usable_rows(group.closed) & np.isfinite(meter.current_A) & np.isfinite(meter.std_A)


@dataclass(frozen=True)
class _Rows(LevelRows):
    """Records against the meter. ``std_A`` (r,): of its readings beside each, by their scatter."""

    fits: Sequence[DmmFit]
    register: Mapping[float, RangeSpecification]
    std_A: Floats

    @cached_property
    def noise_A2(self) -> Floats:
        """Covariance of the readings, (r, r): those of a range have one scatter, as three tell it badly."""
        range_A, variance = self.column("range_A"), self.std_A**2
        of_range = {full_A: variance[range_A == full_A].mean() for full_A in np.unique(range_A).tolist()}
        return super().noise_A2 + np.diag([of_range[full_A] for full_A in range_A.tolist()])

    def free(self) -> list[Floats]:
        """Return what nobody knows: both counters and the leakage of each channel and temperature, the current of each
        visit.
        """
        places = [group.place[:2] for group in self.groups]
        polarity, driven = self.column("polarity"), self.column("level_A") > 0
        columns = [1.0 * (self.visit == at) for at in range(len(places))]
        for place in dict.fromkeys(places):
            here = np.array([place == other for other in places])[self.visit]
            columns += [side_A * here for side_A in self.sides_A]
            if not driven[here].all():  # zeros show the leakage; without them it is taken as negligible
                columns.append(polarity * here)
        return columns

    def held(self) -> list[Floats]:
        """Return one standard uncertainty of each error of the meter, its gains by range, and of what a counter may
        differ by when it is visited again.
        """
        errors, range_A = self.of_standard(self.register), self.column("range_A")
        gain_A = errors.pop(GAIN, np.zeros(self.visit.size))
        columns = [*errors.values(), *by_range(gain_A, range_A).T]
        for at in range(len(self.fits), len(self.groups)):
            columns += [PPM * _AGAIN_ppm * side_A * (self.visit == at) for side_A in self.sides_A]
        return columns

    def operators(self, entries: Estimates) -> tuple[Floats, list[Estimate]]:
        """Return what each estimate gains per ampere that is counted, (k, r), and those that follow from the rows."""
        of_place: dict[tuple[Any, ...], Floats] = {}
        for fitted, part in zip(self.fits, self.slices[: len(self.fits)], strict=True):
            usable = _usable(fitted.group, fitted.meter)
            for quantity, operator in fitted.fit.operators_ppm.items():
                whole = of_place[quantity, *fitted.group.place[:2]] = np.zeros(self.visit.size)
                whole[part] = -operator[usable]

        def operator_of(entry: Estimate) -> Floats | None:
            where = entry.conditions
            return of_place.get((entry.quantity, where.get("channel"), where.get("temperature_degC")))

        return operators_of(entries, operator_of, self.visit.size)


METHODS = FIT_METHODS
STEADY_degC = 0.05  # at 8 ppm/degC less than half a ppm between the first record of a channel and its last
_QUANTITIES = (*SCALE_FACTORS, "dsf_mean")
_HEADS = ("channel", "quantity", "degC", "dmm", "calibrator", "difference", "U", "E_n")
_TESTS = ("repeat_shift", "switch_leakage")


@dataclass(frozen=True)
class Determined:
    """Fits and estimates of a campaign. ``missing``: a sentence for each group without a result."""

    fits: list[DmmFit]
    groups: list[Group]
    log: MeterLog
    estimates: Estimates
    missing: list[str]


def determine(material: Material, method: str) -> Determined:
    """Return fits and estimates of a campaign, without what explains them. Raises: as ``analysis.analyse``."""
    constants, register = read_campaign(material.campaign), read_ranges(material.standards, METER)
    chosen = campaign_rows(material.rows)
    groups, log = group_rows(chosen, constants.master_Hz), MeterLog(chosen, material.readings)
    first = [group for group in groups if not group.repeat]
    fits, refused = fit_each(first, lambda group: _fit_one(group, log, constants, register, method))
    if not fits:
        raise refused[0][1]
    entries: Estimates = []
    for fitted in fits:
        entries += scale_factor_estimates(fitted, constants, material.standards) + bias_estimates(fitted, constants)
        entries += leakage_estimates(fitted, constants)
    entries += shift_estimates(fits, [group for group in groups if group.repeat], log, constants, register)
    first_visits = [row for row in chosen if not row.window.conditions.get("repeat")]
    missing = missing_groups(first_visits, {fitted.group.place for fitted in fits}, refused, constants)
    return Determined(fits, groups, log, entries, missing)


def _fit_one(
    group: Group, log: MeterLog, campaign: Campaign, register: Mapping[float, RangeSpecification], method: str
) -> DmmFit:
    require_closed(group)
    meter = log.meter(group.numbers)
    converter = campaign.converter(group.channel)
    fit = fit_dmm_method(group.closed, meter, converter, register, method)
    even, meter = _without_odd_level(group, meter, converter, register, fit)
    if even is not group:
        fit = fit_dmm_method(even.closed, meter, converter, register, method)
    return DmmFit(even, meter, fit)


def _without_odd_level(
    group: Group, meter: Meter, converter: Converter, register: Mapping[float, RangeSpecification], fit: DmmScaleFactor
) -> tuple[Group, Meter]:
    """Leave out the one level that is unlike all others: with it the rows cannot fit, without it they do.

    Not the largest one, for there it may be the converter, and none if there are several such levels.
    """

    def fits_without(level: float) -> bool:
        kept = level_A != level
        try:
            other = fit_dmm_method(group.closed.take(kept), meter.take(kept), converter, register)
        except FitError:
            return False
        return probability_of(other) > LIKELY

    level_A = group.closed.level_A
    if probability_of(fit) >= NO_CHANCE:
        return group, meter
    between_A = np.unique(level_A[(level_A > 0) & (level_A < level_A.max())])
    odd_A = [level for level in between_A if fits_without(level)]
    if len(odd_A) != 1:
        return group, meter
    for row in np.flatnonzero(level_A == odd_A[0])[::-1]:
        group = group.without(int(row), ODD)
    return group, meter.take(level_A != odd_A[0])


def analyse(material: Material, method: str = "joint") -> Analysis:
    """Return estimate scale-factor errors against the current meter, and test that nothing moved between its readings.

    Args:    material: records, readings of the role "dmm", sections of the session manifest.
             method: "joint" (differential and common-mode rows) or "as_printed" (equation (18), the mean only).
    Returns: Analysis. Groups that are not determined have no estimate and are named in ``missing`` and ``notes``; that
             "as_printed" refuses K_N and K_P apart is a note with the rank.
    Raises:  FitError B-FIT-003, -004, -007, -008, -009; B-FIT-001, -005, -012 or -050 if no group is determined.
    Source:  AF-converter paper section 3.1.2; docs/method-af-converter.md.
    """
    constants, register = read_campaign(material.campaign), read_ranges(material.standards, METER)
    known = determine(material, method)
    fits, groups, entries, missing = known.fits, known.groups, known.estimates, known.missing
    again = [(group, known.log.meter(group.numbers)) for group in groups if group.repeat]
    impossible = {one.group.place: list(plausible(one.group, _values_ppm(one.fit), constants)) for one in fits}
    possible = [one for one in fits if not impossible[one.group.place]]
    searches = [searched_rows(possible, again, entries, constants, register)] if possible else []
    return Analysis(
        constants.analysis,
        method,
        constants.uut,
        entries,
        evidence=[
            *chain.from_iterable(impossible.values()),
            *evidence_of(searches),
            *expired(material, METER, {float(at) for fitted in fits for at in fitted.meter.range_A}, _QUANTITIES),
        ],
        components=budget(fits, constants),
        groups=[quality_of(fitted.group, fitted.fit, constants) for fitted in fits],
        notes=[
            *(say("note.no_result", what=sentence) for sentence in missing),
            *notes(fits, groups, entries),
            *untraced(register, METER),
        ],
        missing=missing,
        tables=[*_agreement_table(fits, material, constants), *zero_table(known.log), *unseen_tables(searches)],
    )


def _values_ppm(fit: DmmScaleFactor) -> Floats:
    return np.array([fit.value_ppm[name] for name in ("dsf_n", "dsf_p", "dsf_mean") if name in fit.value_ppm])


def notes(fits: Sequence[DmmFit], groups: Sequence[Group], estimates: Estimates) -> list[str]:
    """Return all notes but those on missing groups."""
    sentences = _refusal(fits) + [_assumption(name, estimates) for name in _TESTS]
    fitted_groups = {fitted.group.place: fitted.group for fitted in fits}
    sentences += left_out_notes(fitted_groups.get(group.place, group) for group in groups)
    without = sum(int(np.count_nonzero(np.isnan(fitted.meter.current_A))) for fitted in fits)
    if without:
        sentences.append(say("meter.no_reading", count=without))
    if any(np.any(np.isnan(fitted.meter.zero_std_A[np.isfinite(fitted.meter.current_A)])) for fitted in fits):
        sentences.append(say("meter.no_zero"))
    moved_degC = max(float(np.ptp(_warmth_degC(fitted, groups))) for fitted in fits)
    if moved_degC > STEADY_degC:
        sentences.append(say("meter.moved", degC=moved_degC))
    return [*sentences, say("meter.gains"), say("meter.no_temperature"), say("note.bias_is_diagnostic")]


def _warmth_degC(fitted: DmmFit, groups: Sequence[Group]) -> Floats:
    """Return the unit's temperatures of a channel, those of its points that were taken again included."""
    again = (group for group in groups if group.repeat and group.place[:2] == fitted.group.place[:2])
    return np.concatenate([group.closed.unit_temperature_degC for group in (fitted.group, *again)])


def _refusal(fits: Sequence[DmmFit]) -> list[str]:
    refused = [fitted for fitted in fits if fitted.fit.refusal]
    if not refused:
        return []
    reason = refused[0].fit.refusal
    conditions = sorted(fitted.fit.condition for fitted in refused)
    means = say.listed(
        say(
            "meter.mean",
            channel=fitted.group.channel,
            value=fitted.fit.value_ppm["dsf_mean"],
            U=1.96 * fitted.fit.std_ppm["dsf_mean"],
        )
        for fitted in refused
    )
    return [
        say("meter.refused", reason=reason, low=conditions[0], high=conditions[-1]),
        say("meter.means", means=means),
    ]


def _assumption(quantity: str, estimates: Estimates) -> str:
    tested = [estimate for estimate in estimates if estimate.quantity == quantity]
    what = say(f"meter.by.{quantity}")
    if not tested:
        return say("meter.not_tested", what=what)
    seen = [estimate for estimate in tested if abs(estimate.value) > estimate.expanded_uncertainty]
    largest = max(tested, key=lambda estimate: abs(estimate.value))
    (value, expanded), unit = _shown(largest)
    verdict = say("meter.by_chance") if _chance(len(seen), len(tested)) else say("meter.beyond_chance")
    return say(
        "meter.tested", what=what, quantity=quantity, outside=len(seen), of=len(tested), verdict=verdict, value=value,
        unit=unit, U=expanded,
    )  # fmt: skip


def _shown(estimate: Estimate) -> tuple[tuple[float, float], str]:
    scale, unit = (1e9, "nA") if estimate.unit == "A" else (1.0, str(estimate.unit))
    return (scale * estimate.value, scale * estimate.expanded_uncertainty), unit


def _chance(outside: int, tested: int) -> bool:
    """Whether so many of independent 95 % intervals may miss zero by chance, at about three standard deviations."""
    return bool(outside <= 0.05 * tested + 3.0 * (0.05 * 0.95 * tested) ** 0.5)


def zero_table(log: MeterLog) -> list[Table]:
    """Zeros of the meter's ranges."""
    rows = [[1e3 * range_A, 1e9 * zero_A, 1e9 * std_A] for range_A, (zero_A, std_A) in sorted(log.zeros_A.items())]
    if not rows:
        return []
    return [worded_table(say, "meter.zeros", ["range", "zero", "u"], rows)]


def _agreement_table(fits: Iterable[DmmFit], material: Material, campaign: Campaign) -> list[Table]:
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
            std_ppm = _difference_std_ppm(fitted, other, index, campaign, standards)
            expanded = coverage_factor() * std_ppm
            place = [fitted.group.channel, name, fitted.group.temperature_degC]
            difference = value_ppm - other_ppm
            rows.append([*place, value_ppm, other_ppm, difference, expanded, difference / expanded])
    if not rows:
        return []
    largest = max(abs(row[-1]) for row in rows)
    return [worded_table(say, "agreement", _HEADS, rows, largest=largest)]


def _difference_std_ppm(
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


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a campaign will give; the values are those of a nominal unit.

    The scatter of the readings is not known before; a digit of the display stands for it.

    Raises:  FitError as ``analysis.analyse``, where no group at all is determined.
    """
    from bench.systems.af_converter.nominal import stimulated_row  # no fit needs it

    constants = read_campaign(planned.campaign)
    rows = [stimulated_row(window, constants) for window in planned.windows]
    ranges_A = sorted(read_ranges(planned.standards, METER))
    known = determine(
        Material(rows, planned.campaign, planned.standards, readings=list(_readings(planned, ranges_A))), METHODS[0]
    )
    return Prediction(known.estimates, known.missing)


def _readings(planned: Planned, ranges_A: Sequence[float]) -> Iterator[Reading]:
    """Yield the readings of the meter with the values of a nominal bench: the range it takes, the planned current.

    The range is the smallest of the register that holds the current without its over-range.
    """
    windows = sorted(planned.windows, key=lambda window: window.t_start_ns)
    for reading in planned.readings:
        if reading.role != METER:
            continue
        t_ns = round(reading.t_s * NS)
        at = replace(reading, t_s=1e-9 * t_ns)  # to the digit as the log of the meter has the ends of windows
        if reading.name == CONFIGURE:
            asked_A = float(reading.arguments["range"])
            yield replace(at, value=next((full for full in ranges_A if asked_A <= full), asked_A))
        elif reading.name == MEASURE:
            following = next((window.conditions for window in windows if window.t_start_ns >= t_ns), {})
            yield replace(at, value=_current_A(reading.conditions, following))


def _current_A(own: Document, following: Document) -> float:
    """Return what flows while the meter reads, by its own conditions and those of the next record."""
    if {ZERO, CHECK} & own.keys():
        return float(own.get(CHECK) or 0.0)
    return abs(float(following.get("current_A") or 0.0))


# Standard, of a counter: one repeat does not tell; four times that stays below half the U of asymmetry.
_AGAIN_ppm = 0.5
Visit = tuple[Group, Meter]
