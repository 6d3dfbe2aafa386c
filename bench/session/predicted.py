"""Predicts how well a campaign will know each result, by its own fit of the records that are planned."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, cast

from bench.analysis import PROMPT, Estimate, Planned, Prediction, Reading
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.model.ports import RecordWindow
from bench.model.systems import analysis_declaration, named
from bench.model.titles import quantity_title
from bench.model.units import format_quantity
from bench.plan import Plan, PlannedCall, PlannedPrompt, PlannedRecord, decisions_of

_TOLD = ("quantity", "unit", "conditions", "std_uncertainty", "coverage_factor", "expanded_uncertainty", "limit")


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
    bounds = [asdict(bound) for bound in prediction.bounds]
    return {"estimates": told, "missing": prediction.missing, "bounds": bounds}


def predicted_lines(plan: Plan, prediction: Prediction) -> Iterator[str]:
    """Yield a line for each quantity: its name, the least and the largest expanded uncertainty, its limit.

    "At least", because what only the unit can tell, such as its temperature coefficients, is not in it.
    """
    analysis = str(plan.campaign["analysis"])
    by_quantity: dict[str, list[Estimate]] = {}
    for entry in prediction.estimates:
        by_quantity.setdefault(entry["quantity"], []).append(entry)
    for quantity, entries in by_quantity.items():
        unit, limit = entries[0]["unit"], entries[0]["limit"]
        known = sorted({_two_digits(U) for entry in entries if (U := entry["expanded_uncertainty"]) is not None})
        ends = [format_quantity(U, unit) for U in dict.fromkeys((known[0], known[-1]))] if known else ["not known"]
        allowed = "" if limit is None else f", limit {format_quantity(limit, unit)}"
        count = f" ({len(entries)} values)" if len(entries) > 1 else ""
        title = quantity_title(analysis, quantity)
        yield f"{title}: U at least {' to '.join(ends)}{allowed}{count}"
    for bound in prediction.bounds:
        about = ", ".join(map(str, bound.conditions.values()))
        smallest = format_quantity(_two_digits(bound.bound), bound.unit)
        title = quantity_title(analysis, bound.quantity)
        yield f"{title} ({about}): {bound.ratio:.3f} of the Cramér-Rao bound, {smallest}"
    for sentence in prediction.missing:
        yield f"missing: {sentence}"


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def planned_of(plan: Plan) -> Planned:
    """Return what an analysis may see of a plan."""
    rates_Hz = {link: definition.rate_Hz for link, definition in plan.definitions().items()}
    return Planned(
        list(_windows(plan)),
        plan.campaign,
        plan.station.standards(),
        readings=list(_readings(plan)),
        rates_Hz={link: rate_Hz for link, rate_Hz in rates_Hz.items() if rate_Hz},
    )


def _readings(plan: Plan) -> Iterator[Reading]:
    for step in plan.steps:
        at_s = step.at_s + (plan.prepare_s if step.phase == "campaign" else 0.0)
        if step.phase == "finally":
            return
        if isinstance(step, PlannedCall):
            yield Reading(at_s, step.number, step.role, step.name, None, step.conditions, step.arguments)
        elif isinstance(step, PlannedPrompt) and step.sets:
            yield Reading(at_s, step.number, "", PROMPT, None, step.conditions, step.sets)


def _windows(plan: Plan) -> Iterator[RecordWindow]:
    records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord)]
    for number, step in enumerate(records, start=1):
        begin_ns = round((plan.prepare_s + step.at_s) * NS)
        yield RecordWindow(
            number=number, link=plan.measurement_link, first_counter=0, frames=0, t_start_ns=begin_ns,
            t_end_ns=begin_ns + round(step.seconds * NS), conditions=step.conditions, step=step.number,
        )  # fmt: skip
