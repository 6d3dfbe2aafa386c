"""Uncertainty budgets of the scale-factor errors, and their check by Monte Carlo: the whole model of a group is drawn
and fitted again; budgets as tables of the report.

The components are those of which ``estimates`` makes the totals of results.json; their sensitivities come from the
fit. What channels share carries one label in all budgets (docs/method-uncertainty.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.analysis import Table, number, significant, with_uncertainty, worded_table
from bench.maths.arrays import Floats
from bench.maths.budget import (
    TYPE_A,
    Budget,
    Component,
    Distribution,
    check_interval,
    combine_all,
    effective_dof,
    propagate,
)
from bench.systems.af_converter.constants import REGISTER, Campaign, Standards
from bench.systems.af_converter.estimators.readings import (
    GAIN,
    SCATTER,
    Readings,
    calibrator_effects,
    count_noise,
    linearity_label,
    offset_label,
    relative_errors,
    scatter_A2,
)
from bench.systems.af_converter.estimators.scale_factor import UNREFERRED, TrialModel
from bench.systems.af_converter.group_fit import QUANTITIES, Fitted, GroupFit, UNKNOWN_SLOPE_ppm_degC
from bench.systems.af_converter.scale_factor.estimates import scale_factor_std_ppm, scatter_parts, sensor_effect_ppm
from bench.systems.af_converter.wording import kind_name, say

_PPM, _nA = 1e6, 1e9
_DECLARED = say("source.campaign")
_COUNTING = say("source.counting")
_DRIFT, _SENSOR, _GRADIENT, _COMBINED = (
    say(f"component.{name}") for name in ("drift", "sensor", "gradient", "combined")
)
_NOISE = tuple(say(f"component.{name}") for name in ("quantisation", "clock", "white", "walk", "interpolated"))
_SCATTER, _UNREFERRED = say("component.scatter"), say("component.unreferred")
_OF_RANGES = say("component.offset"), say("component.linearity")
_COLUMNS = {  # of the table of all channels, by the beginning of a component's name
    "quantisation": say("summary.quantisation"),
    "white noise": say("summary.noise"),
    "random walk": say("summary.noise"),
    "scatter": say("summary.noise"),
    "calibrator offset": say("summary.offsets"),
    "calibrator linearity": say("summary.linearity"),
    "calibrator gain": say("summary.gain"),
    "calibrator traceability": say("summary.traceability"),
    "calibrator drift": say("summary.drift"),
    "interpolated": say("summary.temperature"),
    "temperature sensor": say("summary.temperature"),
    "unknown temperature": say("summary.temperature"),
    "chamber's gradient": say("summary.temperature"),
}
_PREFIXES = {0: "", -1: "m", -2: "µ"}
TRIALS = 100_000
_SEED = 1  # any will do; the same numbers must come out tomorrow
_HEADERS = (
    *("channel", "kind", "unit", "u_budget", "u_trials", "budget", "shortest", "differ", "tolerance", "statement"),
)


def budget_tables(fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> list[Table]:
    """Return tables of the report at the temperature nearest to the reference.

    Full budgets of dsf_n and dsf_p for the first channel of each kind, contributions of all channels side by side, the
    correlation between the channels where there are several, and the check of dsf_n by Monte Carlo.
    """
    groups = nearest_to_reference(fitted, campaign)
    examples = {campaign.channel(visit.group.channel).kind: visit for visit in reversed(groups)}
    tables: list[Table] = []
    to_check: list[tuple[GroupFit, Budget]] = []
    for index, quantity in enumerate(QUANTITIES):
        by_channel = {
            str(visit.group.channel): components_of(visit, index, fitted, campaign, standards) for visit in groups
        }
        combined = combine_all(by_channel)
        for kind, visit in sorted(examples.items(), key=lambda example: example[1].group.channel):
            budget = combined.budgets[str(visit.group.channel)]
            at = {"channel": visit.group.channel, "kind": kind_name(kind), "degC": visit.fit.unit_temperature_degC}
            title = say("budget.title", quantity=quantity, **at)
            tables.append(budget_table(title, "ppm", float(visit.fit.dsf_ppm[index]), budget))
            to_check += [(visit, budget)] if index == 0 else []
        tables.append(_side_by_side(quantity, combined.budgets))
        if len(by_channel) > 1:
            title, caption = say("correlation.title", quantity=quantity), say("correlation.caption")
            tables.append(correlation_table(title, caption, list(by_channel), combined.correlation))
    return [*tables, check_table(to_check, fitted, campaign, standards, method)]


def nearest_to_reference(fitted: Fitted, campaign: Campaign) -> list[GroupFit]:
    """Return first visits at the nominal temperature nearest to the reference temperature, by channel."""
    visits = [visit for visit in fitted.groups if visit.group.repeat == 0]
    reference_degC = campaign.reference_temperature_degC
    nominal = min(
        (visit.group.temperature_degC for visit in visits), key=lambda at: abs(at - reference_degC), default=None
    )
    at_nominal = [visit for visit in visits if visit.group.temperature_degC == nominal]
    return sorted(at_nominal, key=lambda visit: visit.group.channel)


def components_of(
    visit: GroupFit, index: int, fitted: Fitted, campaign: Campaign, standards: Standards
) -> list[Component]:
    """Components of DSF_N (index 0) or DSF_P (1) of a group, ppm; those of the calibrator are common to all groups.

    ``std_uncertainty`` of a noise or range error is that of one reading; the sensitivity is what the fit makes of all.
    """
    slopes = fitted.slopes_ppm_degC(visit.group.channel, visit.fit.unit_temperature_degC)
    drift_ppm, sensor_degC = standards.drift_ppm, campaign.sensor_std_degC
    return [
        *_noise(visit, index, campaign),
        *_scatter(visit, index, campaign),
        *_unreferred(visit, index),
        *_range_errors(visit, index, standards),
        *_gains(visit, index, standards),
        _effect(
            _DRIFT, drift_ppm, "ppm", drift_ppm, standards.drift_source, common="drift"
        ),
        _effect(
            _SENSOR, sensor_degC, "degC", slopes[index] * sensor_degC, _DECLARED,
            common="temperature sensor",
        ),
        *_gradient(slopes[index], campaign),
    ]  # fmt: skip


def _gradient(slope_ppm_degC: float, campaign: Campaign) -> list[Component]:
    """Return what gradient and neighbours bring to a unit that shares a chamber; nothing for one that is alone."""
    gradient_degC = campaign.gradient_std_degC
    if not gradient_degC:
        return []
    source = say("source.slot")
    return [_effect(_GRADIENT, gradient_degC, "degC", slope_ppm_degC * gradient_degC, source, common="gradient")]


def _noise(visit: GroupFit, index: int, campaign: Campaign) -> list[Component]:
    rows, converter = visit.group.closed, campaign.converter(visit.group.channel)
    gate_s = float(np.median(rows.gate_s))
    clock_ppm = float(np.median(count_noise(rows.af_count))) * _PPM
    counts, clock, white, walk, interpolated = _NOISE
    of_one_row = {
        counts: (converter.k0_C / gate_s / np.sqrt(6.0) * _nA, "nA", _COUNTING),
        clock: (clock_ppm, "ppm", _COUNTING),
        white: (converter.white_A_rtHz / np.sqrt(2.0 * gate_s) * _nA, "nA", _DECLARED),
        walk: (converter.walk_A_rth * _nA, "nA", say("source.campaign_1h")),
        interpolated: (float(np.max(rows.temperature_std_degC)), "degC", say("source.neighbours")),
    }
    return [
        _effect(
            name, u, unit, float(visit.fit.parts_ppm[name][index]), source,
            distribution="triangular" if source == _COUNTING else "normal",
        )
        for name, (u, unit, source) in of_one_row.items()
    ]  # fmt: skip


def _scatter(visit: GroupFit, index: int, campaign: Campaign) -> list[Component]:
    """Return what points that are known by the scatter of their records bring; nothing where there is none."""
    if SCATTER not in visit.fit.parts_ppm:
        return []
    rows, part_ppm = visit.group.closed, float(visit.fit.parts_ppm[SCATTER][index])
    variance_A2 = scatter_A2(rows, campaign.converter(visit.group.channel))
    of_one_nA = math.sqrt(float(np.median(variance_A2[variance_A2 > 0]))) * _nA
    dof = effective_dof(part_ppm**2, scatter_parts(visit, np.eye(2)[index], campaign))
    effect = _effect(_SCATTER, of_one_nA, "nA", part_ppm, say("source.scatter"), dof=dof)
    return [replace(effect, evaluation=TYPE_A)]


def _unreferred(visit: GroupFit, index: int) -> list[Component]:
    """Return what rows at other temperatures bring where no coefficients refer them; nothing where some do."""
    if UNREFERRED not in visit.fit.parts_ppm:
        return []
    part_ppm = float(visit.fit.parts_ppm[UNREFERRED][index])
    return [_effect(_UNREFERRED, UNKNOWN_SLOPE_ppm_degC, "ppm/degC", part_ppm, say("source.unreferred"))]


def _gains(visit: GroupFit, index: int, standards: Standards) -> list[Component]:
    """Return errors in proportion to the calibrator's current: of its specification, and of its own calibration."""
    relative = relative_errors(visit.group.closed.range_A, standards.ranges)
    return [
        _effect(
            _name_of_gain(label), float(relative[label].max()) * _PPM, "ppm", float(effect_ppm[index]), REGISTER,
            common=label, dof=standards.dof_of(label),
        )
        for label, effect_ppm in visit.fit.gains_ppm.items()
    ]  # fmt: skip


def _name_of_gain(label: str) -> str:
    return say("component.gain") if label == GAIN else say("component.traceability", label=label)


def _range_errors(visit: GroupFit, index: int, standards: Standards) -> list[Component]:
    """Return offsets of the calibrator's ranges and linearity errors of its levels."""
    effects = calibrator_effects(visit.group.closed, standards.ranges)
    labels = _labels(visit.group.closed)
    u_A = dict(zip(effects.labels, np.abs(effects.matrix).max(axis=0), strict=True))
    return [
        _effect(
            say("component.calibrator", label=labels[label]),
            float(u_A[label]) * _nA,
            "nA",
            float(effect_ppm[index]),
            REGISTER,
            common=label,
            dof=standards.calibrator_dof,
        )
        for label, effect_ppm in visit.fit.shared_ppm.items()
    ]


def _labels(rows: Readings) -> dict[str, str]:
    """Return sentences by the labels of ``calibrator_effects``."""
    places = set(zip(rows.range_A.tolist(), rows.level_A.tolist(), strict=True))
    said = {offset_label(range_A): say("label.offset", range=_current(range_A)) for range_A, _ in places}
    return said | {
        linearity_label(range_A, level_A): say("label.linearity", range=_current(range_A), level=_current(level_A))
        for range_A, level_A in places
    }


def _current(value_A: float) -> str:
    """Return a current with the prefix that people give it: 30 µA."""
    power = max(-2, math.floor(math.log10(value_A) / 3.0 + 1e-9)) if value_A > 0.0 else 0
    return f"{value_A * 10.0 ** (-3 * power):g}\u00a0{_PREFIXES[power]}A"


def _effect(
    name: str, u: float, unit: str, contribution_ppm: float, source: str, *, distribution: str = "normal",
    common: str = "", dof: float = math.inf,
) -> Component:  # fmt: skip
    """Return a component from what it is in its own unit and what the fit makes of it."""
    sensitivity = contribution_ppm / u if u else 0.0
    return Component(name, u, unit, sensitivity, distribution=distribution, source=source, common=common, dof=dof)


def _side_by_side(quantity: str, budgets: Mapping[str, Budget]) -> Table:
    names = dict.fromkeys(part.name for budget in budgets.values() for part in budget.components if part.contribution)
    columns = {name: next(column for start, column in _COLUMNS.items() if name.startswith(start)) for name in names}
    return summary_table(say("summary.title", quantity=quantity), "ppm", budgets, columns)


def check_table(
    checked: Sequence[tuple[GroupFit, Budget]], fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> Table:
    """The budgets of dsf_n beside the shortest intervals of the trials, with the test of JCGM 101:2008 clause 8.1."""
    rows = [_check_row(visit, budget, fitted, campaign, standards, method) for visit, budget in checked]
    return worded_table(say, "trials", _HEADERS, rows, trials=number(TRIALS))


def trials_of(visit: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> Distribution:
    """Distribution of DSF_N of a group, ppm."""
    at_degC = visit.fit.unit_temperature_degC
    model = TrialModel(
        rows=visit.group.closed,
        converter=campaign.converter(visit.group.channel),
        standard=standards.ranges,
        referral=fitted.referral(visit.group.channel, at_degC),
        method=method,
        drift=standards.drift or 0.0,
        sensor_std_degC=campaign.thermal_std_degC,
        standard_dof=standards.calibrator_dof,
    )
    return propagate(lambda generator, trials: model.draw(generator, trials)[:, 0], _SEED, TRIALS)


def _check_row(
    visit: GroupFit, budget: Budget, fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> list[Any]:
    value_ppm, expanded_ppm = float(visit.fit.dsf_ppm[0]), budget.expanded_uncertainty
    drawn = trials_of(visit, fitted, campaign, standards, method)
    check = check_interval(value_ppm, budget.std_uncertainty, expanded_ppm, drawn)
    return [
        visit.group.channel,
        kind_name(campaign.channel(visit.group.channel).kind),
        f"{visit.fit.unit_temperature_degC:.2f}",
        figures(budget.std_uncertainty),
        figures(drawn.std),
        _interval(value_ppm - expanded_ppm, value_ppm + expanded_ppm),
        _interval(drawn.low, drawn.high),
        f"{check.low_difference:.2f}, {check.high_difference:.2f}",
        f"{check.tolerance:g}",
        say(f"trials.statement.{check.statement.replace(' ', '_')}"),
    ]


def _interval(low: float, high: float) -> str:
    return f"{low:.2f} … {high:.2f}".replace("-", "−")


def components(fitted: Fitted, campaign: Campaign, standards: Standards) -> list[dict[str, Any]]:
    """Budget of dsf_n and dsf_p per kind of channel: largest standard uncertainty over channels and temperatures."""
    largest: dict[tuple[str, str], float] = {}
    for visit in fitted.groups:
        kind = campaign.channel(visit.group.channel).kind
        sensor_ppm = sensor_effect_ppm(visit, fitted, campaign)
        parts = {name: float(np.max(values)) for name, values in visit.fit.parts_ppm.items()}
        parts |= {_name_of_gain(label): float(np.max(np.abs(part))) for label, part in visit.fit.gains_ppm.items()}
        parts[_DRIFT] = standards.drift_ppm
        slope_ppm_degC = float(
            np.max(np.abs(fitted.slopes_ppm_degC(visit.group.channel, visit.fit.unit_temperature_degC)))
        )
        parts[_SENSOR] = slope_ppm_degC * campaign.sensor_std_degC
        if campaign.gradient_std_degC:
            parts[_GRADIENT] = slope_ppm_degC * campaign.gradient_std_degC
        std_ppm = [scale_factor_std_ppm(visit, standards, index) for index in (0, 1)]
        parts[_COMBINED] = float(np.max(np.hypot(std_ppm, sensor_ppm)))
        for name, value in parts.items():
            largest[kind, name] = max(largest.get((kind, name), 0.0), value)
    said = {str(name): name for name in (*_NOISE, _SCATTER, _UNREFERRED, *_OF_RANGES)}
    stated = {name for (_, name), value in largest.items() if value > 0}
    return [
        {
            "kind": kind_name(kind),
            "quantity": "dsf_n, dsf_p",
            "component": said.get(name, name),
            "evaluation": {_COMBINED: "", SCATTER: TYPE_A}.get(name, "B"),
            "distribution": say("budget.triangular" if name.startswith("quantisation") else "budget.normal"),
            "std_uncertainty_ppm": value,
        }
        for (kind, name), value in largest.items()
        if name in stated
    ]


_BUDGET_HEADERS = (
    "component",
    "u",
    "unit",
    "sensitivity",
    "contribution",
    "share",
    "dof",
    "type",
    "distribution",
    "source",
)


def budget_table(title: str, unit: str, value: float, budget: Budget) -> Table:
    """Return one budget: a row per component that contributes, then the combined uncertainty; ``value`` in ``unit``."""
    rows = [
        [
            component.name,
            figures(component.std_uncertainty),
            component.unit or unit,
            figures(component.sensitivity),
            figures(component.contribution),
            f"{100.0 * budget.share(component):.2f} %",
            dof_text(component.dof),
            component.evaluation,
            say(f"budget.{component.distribution}"),
            component.source,
        ]
        for component in budget.components
        if component.contribution
    ]
    rows.append(
        [say("component.combined"), "", unit, "", figures(budget.std_uncertainty), "", dof_text(budget.dof), "", "", ""]
    )
    stated = with_uncertainty(value, budget.expanded_uncertainty)
    caption = say("budget.caption", value=stated, unit=unit, k=f"{budget.coverage_factor:.2f}")
    return Table(title, caption, say.heads("budget", *_BUDGET_HEADERS), rows)


def correlation_table(title: str, caption: str, names: Sequence[str], matrix: Floats) -> Table:
    """Correlation between results, both ways by name; three decimals, but 1 for a result with itself alone."""
    rows = [
        [name, *(_correlation(float(matrix[row, column]), row == column) for column in range(len(names)))]
        for row, name in enumerate(names)
    ]
    return Table(title, caption, ["", *names], rows)


def summary_table(title: str, unit: str, budgets: Mapping[str, Budget], kinds: Mapping[str, str]) -> Table:
    """Contributions of the budgets of all channels side by side, components summed by kind.

    ``kinds``: kind of component by its name, in the order of the columns; all others are left to the combined value.
    """
    columns = list(dict.fromkeys(kinds.values()))
    rows = []
    for name, budget in budgets.items():
        sums = dict.fromkeys(columns, 0.0)
        for component in budget.components:
            if component.name in kinds:
                sums[kinds[component.name]] += component.contribution**2
        ends = [significant(budget.std_uncertainty), dof_text(budget.dof), f"{budget.coverage_factor:.2f}"]
        parts = [significant(math.sqrt(sums[column])) for column in columns]
        rows.append([name, *parts, *ends, significant(budget.expanded_uncertainty)])
    headers = [say("budget.head.channel"), *columns, "u", say("budget.head.dof"), "k", "U"]
    return Table(title, say("summary.caption", unit=unit), headers, rows)


def figures(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits: one more than a result has, so that sums can be checked."""
    return number(float(f"{value:.{digits}g}"))


def dof_text(dof: float) -> str:
    """Degrees of freedom: rounded down, as a coverage factor may only become larger by it; the sign for infinity."""
    return "∞" if math.isinf(dof) or dof >= 1e6 else f"{math.floor(dof)}"


def _correlation(value: float, own: bool) -> str:
    return "1" if own else f"{math.copysign(min(abs(value), 0.999), value):.3f}".replace("-", "−")
