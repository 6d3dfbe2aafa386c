"""Predicts how well a campaign will know each result, by its own fit of the records that are planned."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np

from bench.analysis import Estimate, Planned, Prediction, Reading, Trace
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.model.ports import RecordWindow
from bench.model.systems import analysis_declaration, named
from bench.model.titles import quantity_title
from bench.model.units import format_quantity
from bench.plan import Plan, PlannedCall, PlannedRecord, decisions_of
from bench.report import planned_temperature

_TOLD = ("quantity", "unit", "conditions", "std_uncertainty", "coverage_factor", "expanded_uncertainty", "limit")
_MINUTE_s = 60.0


def predicted(plan: Plan) -> Prediction:
    """Return the estimates of a plan with the uncertainties they will have; their values are those of a nominal unit.

    What is not predicted is ``missing``: all of an analysis that cannot do so, of several units, and of a run that
    decides which records it takes.
    """
    declared = analysis_declaration(str(plan.campaign.get("analysis")))
    if declared is None or not declared.predicted:
        return Prediction([], [f"the analysis {plan.campaign.get('analysis')} predicts no uncertainties"])
    if plan.units or decisions_of(plan.steps):
        return Prediction([], ["several units, or records that the run decides on, are not predicted"])
    predict: Callable[[Planned], Prediction] = named(declared.predicted)
    try:
        return predict(planned_of(plan))
    except FitError as error:
        return Prediction([], [error.message])


def predicted_document(prediction: Prediction) -> dict[str, Any]:
    """Return a prediction for JSON: uncertainties and limits; no value and no verdict, since nothing was measured."""
    told = [{key: entry[key] for key in _TOLD} for entry in cast("list[dict[str, Any]]", prediction.estimates)]
    return {"estimates": told, "missing": prediction.missing, "assumed": prediction.assumed}


def predicted_lines(plan: Plan, prediction: Prediction) -> Iterator[str]:
    """Yield a line for each quantity: its name, the least and the largest expanded uncertainty, its limit.

    "At least", because what only the unit can tell, such as its temperature coefficients, is not in it.
    """
    by_quantity: dict[str, list[Estimate]] = {}
    for entry in prediction.estimates:
        by_quantity.setdefault(entry["quantity"], []).append(entry)
    for quantity, entries in by_quantity.items():
        unit, limit = entries[0]["unit"], entries[0]["limit"]
        known = sorted({_two_digits(U) for entry in entries if (U := entry["expanded_uncertainty"]) is not None})
        ends = [format_quantity(U, unit) for U in dict.fromkeys((known[0], known[-1]))] if known else ["not known"]
        allowed = "" if limit is None else f", limit {format_quantity(limit, unit)}"
        count = f" ({len(entries)} values)" if len(entries) > 1 else ""
        title = quantity_title(str(plan.campaign["analysis"]), quantity)
        yield f"{title}: U at least {' to '.join(ends)}{allowed}{count}"
    yield from (f"missing: {sentence}" for sentence in prediction.missing)
    yield from (f"assumed: {sentence}" for sentence in prediction.assumed)


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def planned_of(plan: Plan) -> Planned:
    """Return what an analysis may see of a plan; its times begin with the preparation."""
    records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord)]
    return Planned(
        [_window(plan, number, step) for number, step in enumerate(records, start=1)],
        plan.campaign,
        plan.station.standards(),
        timed={number for number, step in enumerate(records, start=1) if step.pulse_timing},
        trace=_trace(plan),
        readings=[_reading(plan, step) for step in plan.phase("campaign") if isinstance(step, PlannedCall)],
    )


def _window(plan: Plan, number: int, step: PlannedRecord) -> RecordWindow:
    begin_ns, rate_Hz = _ns(plan, step.at_s), float(plan.campaign.get("rate_Hz", 0.0))
    return RecordWindow(
        number=number, link=plan.measurement_link, first_counter=round(begin_ns / NS * rate_Hz),
        frames=round(step.seconds * rate_Hz), t_start_ns=begin_ns, t_end_ns=_ns(plan, step.at_s + step.seconds),
        conditions=step.conditions, step=step.number,
    )  # fmt: skip


def _reading(plan: Plan, call: PlannedCall) -> Reading:
    t_s = 1e-9 * _ns(plan, call.at_s)
    return Reading(t_s, call.number, call.role, call.name, None, call.conditions, call.arguments)


def _ns(plan: Plan, at_s: float) -> int:
    return round((plan.prepare_s + at_s) * NS)


def _trace(plan: Plan) -> Trace:
    """Return the planned air once a minute and at its corners, as far as anything is planned for it."""
    corners_s, degC = planned_temperature(plan.steps, plan.prepare_s)
    if not corners_s.size:
        return Trace()
    t_s = np.union1d(np.arange(corners_s[0], corners_s[-1], _MINUTE_s), corners_s)
    air_degC = np.interp(t_s, corners_s, degC)
    return Trace(t_s + plan.prepare_s, air_degC, np.full(t_s.shape, np.nan))
