"""Estimates of the DMM method: scale-factor errors, bias, and the two tests of its assumption 2.

Readings of the current meter, sorted to the records they stand beside, to its zeros, and to the drift check.

A range that is set begins a new set of readings. What a set is for, the names of its loops say: ``zero_range`` a zero
with nothing connected, ``check_level`` the check of the calibrator before and after a campaign, neither a record.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import Common, Document, Estimate, Estimates, Reading, estimate, sharing
from bench.systems.af_converter.constants import METER, Campaign, Register, common_errors
from bench.systems.af_converter.estimators.dmm_method import DmmScaleFactor, Meter
from bench.systems.af_converter.estimators.readings import (
    QUANTISATION,
    Converter,
    RangeSpecification,
    Readings,
    clock_A2,
    open_input_bias,
    pulse_currents_A,
    quantisation_A2,
    specification,
    white_A2,
)
from bench.systems.af_converter.group_fit import bias_estimate, conditions_of
from bench.systems.af_converter.groups import Group
from bench.systems.af_converter.wording import kind_name, say

_PPM = 1e6
_COMPONENTS = {
    "noise of the meter": "meter_noise",
    "zero of the meter": "meter_zero",
    "linearity of the meter": "meter_linearity",
    "gain of the meter's ranges": "meter_gain",
    "traceability of the meter": "meter_traceability",
    QUANTISATION: "quantisation",
    "quantisation of the AF clock count": "clock",
    "white noise of the converter": "white",
    "random walk of the bias": "walk",
    "combined": "combined",
}


if TYPE_CHECKING:
    from bench.record import RecordRow

CONFIGURE, MEASURE = "configure_current", "measure_current"
ZERO, CHECK = "zero_range_A", "check_level_A"
DISPLAY_PART = 1e-8  # of the range: a digit of the meter; readings that all agree are not without noise


@dataclass
class ReadingSet:
    """Readings on one range without a change of it; values in ampere."""

    range_A: float
    conditions: Document
    begin_s: float
    end_s: float
    values_A: list[float] = field(default_factory=list)

    @property
    def mean_A(self) -> float:
        """Mean of the readings."""
        return float(np.mean(self.values_A))

    @property
    def std_A(self) -> float:
        """Standard uncertainty of the mean by the scatter of the readings, at least a digit of the display."""
        digit_A = DISPLAY_PART * self.range_A
        scatter_A = float(np.std(self.values_A, ddof=1)) if len(self.values_A) > 1 else digit_A
        return max(scatter_A, digit_A) / math.sqrt(len(self.values_A))


def reading_sets(readings: Iterable[Reading]) -> list[ReadingSet]:
    """Sets in the order of time; a reading that was flagged (no value) is left out, an empty set too."""
    sets: list[ReadingSet] = []
    for reading in sorted(readings, key=lambda reading: reading.t_s):
        if reading.role != METER or not isinstance(reading.value, (int, float)) or not math.isfinite(reading.value):
            continue
        if reading.name == CONFIGURE:
            sets.append(ReadingSet(float(reading.value), dict(reading.conditions), reading.t_s, reading.t_s))
        elif reading.name == MEASURE and sets:
            sets[-1].values_A.append(float(reading.value))
            sets[-1].end_s = reading.t_s
    return [reading_set for reading_set in sets if reading_set.values_A]


class MeterLog:
    """Readings by record number. A record owns the last set taken between the end of the record before it and itself.

    So a record that was taken again owns the readings of the attempt that counts.
    """

    def __init__(self, rows: Sequence[RecordRow], readings: Iterable[Reading]) -> None:
        sets = reading_sets(readings)
        self._zeros = [reading_set for reading_set in sets if ZERO in reading_set.conditions]
        points = [reading_set for reading_set in sets if not {ZERO, CHECK} & reading_set.conditions.keys()]
        self._of: dict[int, ReadingSet] = {}
        before_s = -np.inf
        for row in sorted(rows, key=lambda row: row.window.t_start_ns):
            begin_s = 1e-9 * row.window.t_start_ns
            own = [point for point in points if before_s <= point.begin_s and point.end_s <= begin_s]
            if own:
                self._of[row.window.number] = own[-1]
            before_s = 1e-9 * row.window.t_end_ns

    def meter(self, numbers: Sequence[int]) -> Meter:
        """Return readings beside these records, minus the zero of their range; NaN for a record without any."""
        rows = [self._row(self._of.get(number)) for number in numbers]
        current_A, std_A, zero_std_A, range_A = np.array(rows, dtype=np.float64).reshape(-1, 4).T
        return Meter(current_A=current_A, std_A=std_A, zero_std_A=zero_std_A, range_A=range_A)

    def _row(self, own: ReadingSet | None) -> tuple[float, float, float, float]:
        if own is None:
            return (np.nan,) * 4
        zero = self._zero(own)
        if zero is None:
            return own.mean_A, own.std_A, np.nan, own.range_A
        return own.mean_A - zero.mean_A, own.std_A, zero.std_A, own.range_A

    def _zero(self, own: ReadingSet) -> ReadingSet | None:
        """Return the zero of a range last measured before a set, else the first after it."""
        same = [zero for zero in self._zeros if abs(zero.range_A - own.range_A) <= 1e-6 * own.range_A]
        earlier = [zero for zero in same if zero.end_s <= own.begin_s]
        return earlier[-1] if earlier else next(iter(same), None)

    @property
    def zeros_A(self) -> dict[float, tuple[float, float]]:
        """Last zero of each range with its standard uncertainty, ampere, for the report."""
        return {zero.range_A: (zero.mean_A, zero.std_A) for zero in self._zeros}


@dataclass(frozen=True)
class DmmFit:
    """A group with the readings beside its closed records and its fitted scale-factor errors."""

    group: Group
    meter: Meter
    fit: DmmScaleFactor


def shared_by_standards(fitted: DmmFit, quantity: str, standards: Register) -> Common:
    """Return what the meter's errors bring to a quantity, by label."""
    return common_errors(standards, METER, fitted.fit.standard_ppm[quantity], {})


def scale_factor_estimates(fitted: DmmFit, campaign: Campaign, standards: Register) -> Estimates:
    """dsf_n, dsf_p, dsf_asymmetry and dsf_mean; the last alone by the method as printed."""
    conditions, fit = conditions_of(fitted.group, fitted.fit.unit_temperature_degC, campaign), fitted.fit
    counted = {"n": fit.n, "dropped": fitted.group.dropped + fit.dropped}
    return [
        sharing(
            estimate(name, "ppm", value_ppm, fit.std_ppm[name], conditions, **counted),
            shared_by_standards(fitted, name, standards),
        )
        for name, value_ppm in fit.value_ppm.items()
    ]


def bias_estimates(fitted: DmmFit, campaign: Campaign) -> Estimates:
    """Bias of the open record, diagnostic only."""
    if not fitted.group.opened.gate_s.size:
        return []
    bias = open_input_bias(fitted.group.opened, campaign.converter(fitted.group.channel))
    return [bias_estimate(fitted.group, fitted.fit.unit_temperature_degC, bias, bias.std_uncertainty_A, campaign)]


def leakage_estimates(fitted: DmmFit, campaign: Campaign) -> Estimates:
    """switch_leakage of each polarity: what the unit counts at zero and neither the meter nor the open input explains.

    The open record was taken with the route open; what is left comes from the closed crosspoint.
    """
    if not fitted.group.opened.gate_s.size:
        return []
    converter, rows = campaign.converter(fitted.group.channel), fitted.group.closed
    opened_A, opened_A2 = counted_A(fitted.group.opened, converter)
    zero_A, zero_A2 = counted_A(rows, converter)
    entries = []
    for index in np.flatnonzero(np.isfinite(fitted.meter.current_A) & (rows.level_A == 0)):
        hours = abs(float(rows.time_s[index] - fitted.group.opened.time_s[0])) / 3600.0
        value_A = zero_A[index] - rows.polarity[index] * fitted.meter.current_A[index] - opened_A[0]
        variance = zero_A2[index] + opened_A2[0] + fitted.meter.std_A[index] ** 2 + converter.walk_A_rth**2 * hours
        if np.isfinite(fitted.meter.zero_std_A[index]):
            variance += fitted.meter.zero_std_A[index] ** 2
        conditions = conditions_of(fitted.group, fitted.fit.unit_temperature_degC, campaign) | {
            "polarity": int(rows.polarity[index])
        }
        entries.append(estimate("switch_leakage", "A", float(value_A), float(variance) ** 0.5, conditions, n=1))
    return entries


def counted_A(rows: Readings, converter: Converter) -> tuple[Any, Any]:
    """Current by the nominal charge of a pulse and its variance by all counts and the white noise, (m,) each."""
    n_A, p_A = pulse_currents_A(rows, converter)
    counts_A2 = quantisation_A2(rows, converter) + clock_A2(rows, converter)
    return n_A - p_A, counts_A2 + white_A2(rows, converter)


def shift_estimates(
    fits: Iterable[DmmFit], repeats: Sequence[Group], log: MeterLog, campaign: Campaign,
    register: Mapping[float, RangeSpecification],
) -> Estimates:  # fmt: skip
    """repeat_shift: the unit minus the meter when a point is taken again, minus the same at the first time.

    Negligible (assumption 2) is a shift below what the meter itself does not know of that current (95 %), its limit.
    """
    entries = []
    first = {fitted.group.place[:2]: fitted for fitted in fits}
    for again in repeats:
        start = first.get(again.place[:2])
        if start is None:
            continue
        meter = log.meter(again.numbers)
        for index in np.flatnonzero(np.isfinite(meter.current_A) & (again.closed.level_A > 0)):
            same = np.flatnonzero(
                (start.group.closed.level_A == again.closed.level_A[index])
                & (start.group.closed.polarity == again.closed.polarity[index])
                & np.isfinite(start.meter.current_A)
            )
            if same.size:
                entries.append(_shift(start, int(same[0]), again, meter, int(index), campaign, register))
    return entries


def _shift(
    start: DmmFit, first: int, again: Group, meter: Meter, index: int, campaign: Campaign,
    register: Mapping[float, RangeSpecification],
) -> Estimate:  # fmt: skip
    converter = campaign.converter(again.channel)
    then_A, then_A2 = counted_A(start.group.closed, converter)
    now_A, now_A2 = counted_A(again.closed, converter)
    polarity, level_A = float(again.closed.polarity[index]), float(again.closed.level_A[index])
    value_A = polarity * (now_A[index] - then_A[first]) - (meter.current_A[index] - start.meter.current_A[first])
    hours = abs(float(again.closed.time_s[index] - start.group.closed.time_s[first])) / 3600.0
    noise_A2 = meter.std_A[index] ** 2 + start.meter.std_A[first] ** 2 + converter.walk_A_rth**2 * hours
    known = specification(register, float(meter.range_A[index]))
    conditions = conditions_of(start.group, start.fit.unit_temperature_degC, campaign) | {
        "current_A": level_A,
        "polarity": int(polarity),
        "repeat": again.repeat,
    }
    return estimate(
        "repeat_shift", "ppm", _PPM * float(value_A) / level_A,
        _PPM * float(now_A2[index] + then_A2[first] + noise_A2) ** 0.5 / level_A, conditions, n=2,
        limit=_PPM * (known.relative + known.floor_A / level_A),
    )  # fmt: skip


def budget(fits: Iterable[DmmFit], campaign: Campaign) -> list[dict[str, Any]]:
    """Budget per kind of channel: largest standard uncertainty over channels and temperatures."""
    largest: dict[tuple[str, str, str], float] = {}
    for fitted in fits:
        kind = campaign.channel(fitted.group.channel).kind
        quantity = "dsf_n" if "dsf_n" in fitted.fit.value_ppm else "dsf_mean"
        parts = {name: values[quantity] for name, values in fitted.fit.parts_ppm.items()}
        for name, value in (parts | {"combined": fitted.fit.std_ppm[quantity]}).items():
            place = kind, "dsf_n, dsf_p" if quantity == "dsf_n" else quantity, name
            largest[place] = max(largest.get(place, 0.0), value)
    return [
        {
            "kind": kind_name(kind),
            "quantity": quantity,
            "component": say(f"component.{_COMPONENTS[name]}"),
            "evaluation": {"combined": "", "noise of the meter": "A", "zero of the meter": "A"}.get(name, "B"),
            "distribution": say("budget.triangular" if name.startswith("quantisation") else "budget.normal"),
            "std_uncertainty_ppm": value,
        }
        for (kind, quantity, name), value in largest.items()
        if value > 0
    ]
