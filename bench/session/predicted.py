"""Predicts how well a campaign will know each result, by its own fit of the records that are planned.

An analysis sees of a plan what a session would hold; all times begin with the preparation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from bench.analysis import (
    PROMPT,
    Common,
    Document,
    Estimate,
    Exchange,
    Planned,
    Prediction,
    Reading,
    Trace,
    foreseen_material,
    judged_values,
    limits_of,
    rule_of,
    values_of,
)
from bench.maths.verdict import chance_of_pass
from bench.model.clock import NS
from bench.model.errors import FitError
from bench.model.installed import named
from bench.model.ports import RecordWindow
from bench.model.quantities import key_of_value
from bench.model.systems import declared_by
from bench.model.texts import quantity_title
from bench.model.units import format_quantity, read_quantity
from bench.plan import (
    UNIT,
    Plan,
    PlannedCall,
    PlannedCommand,
    PlannedRecord,
    Step,
    decisions_of,
    planned_temperature,
    round_count,
)
from bench.session.one_unit import plan_of_unit

_MINUTE_s = 60.0


def planned_of(plan: Plan, begin_utc_s: float | None = None) -> Planned:
    """Return what an analysis may see of a plan that begins at a UTC, None if that is not known."""
    records = [step for step in plan.phase("campaign") if isinstance(step, PlannedRecord)]
    rates_Hz = {link: definition.rate_Hz for link, definition in plan.definitions().items()}
    return Planned(
        [_window(plan, number, step) for number, step in enumerate(records, start=1)],
        plan.campaign,
        plan.station.standards(),
        timed={number for number, step in enumerate(records, start=1) if step.pulse_timing},
        trace=_trace(plan),
        readings=list(_readings(plan)),
        exchanges=[_exchange(plan, step) for step in plan.phase("campaign") if isinstance(step, PlannedCommand)],
        steps_s={link: plan.station.links[link].poll for link in rates_Hz} if plan.station.in_process else {},
        begin_utc_s=begin_utc_s,
        rates_Hz={link: rate_Hz for link, rate_Hz in rates_Hz.items() if rate_Hz},
    )


def _window(plan: Plan, number: int, step: PlannedRecord) -> RecordWindow:
    begin_ns, rate_Hz = _ns(plan, step, step.at_s), float(plan.campaign.get("rate_Hz") or 0.0)
    return RecordWindow(
        number=number, link=plan.measurement_link, first_counter=round(begin_ns / NS * rate_Hz),
        frames=round(step.seconds * rate_Hz), t_start_ns=begin_ns, t_end_ns=_ns(plan, step, step.at_s + step.seconds),
        conditions=step.conditions, step=step.number,
    )  # fmt: skip


def _readings(plan: Plan) -> Iterator[Reading]:
    for step in (*plan.phase("prepare"), *plan.phase("campaign")):
        t_s = _ns(plan, step, step.at_s) / NS
        calls = [(t_s, step)] if isinstance(step, PlannedCall) else []
        if step.sets:
            yield Reading(t_s, step.number, "", PROMPT, None, step.conditions, step.sets)
        elif isinstance(step, PlannedRecord) and step.readings:
            calls = [(t_s + turn * step.every_s, call) for turn in range(round_count(step)) for call in step.calls]
        for at_s, call in calls:
            yield Reading(at_s, step.number, call.role, call.name, None, call.conditions, call.arguments)


def _exchange(plan: Plan, step: PlannedCommand) -> Exchange:
    begin_s = _ns(plan, step, step.at_s) / NS
    return Exchange(
        step=step.number, item=step.item, name=step.name, sequence=0, attempts=0, begin_s=begin_s,
        end_s=begin_s + (step.takes_s or 0.0), status=None, refused=False, sent=bytes(step.payload), received=b"",
        conditions=step.conditions,
    )  # fmt: skip


def _ns(plan: Plan, step: Step, at_s: float) -> int:
    return round((at_s if step.phase == "prepare" else plan.prepare_s + at_s) * NS)


def _trace(plan: Plan) -> Trace:
    """Return the planned air once a minute and at its corners, as far as anything is planned for it."""
    corners_s, degC = planned_temperature(plan.steps, plan.prepare_s)
    if not corners_s.size:
        return Trace()
    t_s = np.union1d(np.arange(corners_s[0], corners_s[-1], _MINUTE_s), corners_s)
    air_degC = np.interp(t_s, corners_s, degC)
    return Trace(t_s + plan.prepare_s, air_degC, np.full(t_s.shape, np.nan))


OWN = "independent noise"
_TOLD = ("quantity", "unit", "conditions", "std_uncertainty", "coverage_factor", "expanded_uncertainty", "limit")


def predicted(plan: Plan, begin_utc_s: float | None = None) -> Prediction:
    """Return the estimates of a plan with the uncertainties they will have; their values are those of a nominal unit.

    Of several units each is predicted by itself; of an analysis that predicts nothing there is nothing. What is not
    determined is ``missing``, all of a run that decides which records it takes among it. ``begin_utc_s``: when the run
    begins, which the age of certificates depends on.
    """
    declared = declared_by(plan.campaign)
    if declared is None or not declared.predicted:
        return Prediction([])
    if decisions_of(plan.steps):
        return Prediction([], ["records that the run decides on are not predicted"])
    if plan.units:
        parts = {unit.serial: plan_of_unit(plan, unit.serial) for unit in plan.units}
        return _of_all({serial: predicted(part, begin_utc_s) for serial, part in parts.items()})
    predict: Callable[[Planned], Prediction] = named(declared.predicted)
    planned = planned_of(plan, begin_utc_s)
    try:
        own = predict(planned)
    except FitError as error:
        own = Prediction([], [error.message])
    return _with_values(own, planned) if planned.campaign.get("expected") else own


def _with_values(own: Prediction, planned: Planned) -> Prediction:
    """Return a prediction with the values that the sequence expects of its readings."""
    material, missing = foreseen_material(planned)
    unstated = [value for value in values_of(material) if value.unstated]
    left_out = {key_of_value(value.quantity, value.conditions) for value in unstated}
    values = [
        entry
        for entry in judged_values(material).estimates
        if entry.std_uncertainty > 0.0 and key_of_value(entry.quantity, entry.conditions) not in left_out
    ]
    why = dict.fromkeys(f"{value.quantity}: {value.unstated}" for value in unstated)
    return replace(own, estimates=[*own.estimates, *values], missing=[*own.missing, *missing, *why])


def _of_all(parts: Mapping[str, Prediction]) -> Prediction:
    """Return the predictions of all units as one."""
    estimates = [
        entry.model_copy(update={"conditions": {UNIT: serial, **entry.conditions}})
        for serial, part in parts.items()
        for entry in part.estimates
    ]
    said_by: dict[str, list[str]] = {}
    for serial, part in parts.items():
        for sentence in part.missing:
            said_by.setdefault(sentence, []).append(serial)
    missing = [
        sentence if len(serials) == len(parts) else f"unit {', '.join(serials)}: {sentence}"
        for sentence, serials in said_by.items()
    ]
    assumed = dict.fromkeys(sentence for part in parts.values() for sentence in part.assumed)
    return Prediction(estimates, missing, list(assumed))


def components_of(entry: Estimate) -> dict[str, float]:
    """Return the standard uncertainties that an estimate is made of, by name, in its unit, the largest first.

    ``OWN`` is what it shares with no other estimate; the squares of all add up to that of its standard uncertainty.
    """
    common = entry.common or Common(standards={}, campaign={})
    parts = {name: abs(part) for name, part in (*common.standards.items(), *common.campaign.items())}
    own = entry.std_uncertainty**2 - math.fsum(part**2 for part in parts.values())
    return dict(sorted({OWN: math.sqrt(max(own, 0.0)), **parts}.items(), key=lambda part: -part[1]))


def chance_of(entry: Estimate, campaign: Document) -> float | None:
    """Return the chance that a unit of the declared spread passes; None without a spread or without both limits.

    Raises: FitError B-FIT-051 if the spread has a unit of another kind than the quantity.
    """
    spread, limits = campaign.get("spread", {}).get(entry.quantity), limits_of(entry)
    if spread is None or limits is None or not all(map(math.isfinite, limits)):
        return None
    factor = read_quantity(f"1 {entry.unit}")
    if factor is None or factor[1] != spread["unit"]:
        raise FitError(
            "B-FIT-051",
            f"the spread of {entry.quantity} is in {spread['unit']}, and the quantity is in {entry.unit}",
            where="uut: spread",
            next_step=f"state it in {entry.unit}",
        )
    rule = rule_of(campaign.get("decision"))
    return chance_of_pass(spread["value"] / factor[0], entry.std_uncertainty, limits, rule)


def predicted_document(plan: Plan, prediction: Prediction) -> dict[str, Any]:
    """Return a prediction for JSON: uncertainties and limits; no value and no verdict, since nothing was measured."""
    told = [
        {
            **{key: getattr(entry, key) for key in _TOLD},
            "components": components_of(entry),
            "chance_of_pass": chance_of(entry, plan.campaign),
        }
        for entry in prediction.estimates
    ]
    bounds = [asdict(bound) for bound in prediction.bounds]
    return {"estimates": told, "missing": prediction.missing, "assumed": prediction.assumed, "bounds": bounds}


def predicted_lines(plan: Plan, prediction: Prediction) -> Iterator[str]:
    """Yield a line for each quantity: its name, the least and the largest expanded uncertainty, its limit.

    Of the largest it says what brings most. "At least", because what only the unit can tell, such as its temperature
    coefficients, is not in it.
    """
    analysis = str(plan.campaign["analysis"])
    by_quantity: dict[str, list[Estimate]] = {}
    for entry in prediction.estimates:
        by_quantity.setdefault(entry.quantity, []).append(entry)
    for quantity, entries in by_quantity.items():
        unit, limit = entries[0].unit.removeprefix("1"), entries[0].limit
        known = sorted({_two_digits(U) for entry in entries if (U := entry.expanded_uncertainty) is not None})
        ends = (
            [format_quantity(U, unit).rstrip() for U in dict.fromkeys((known[0], known[-1]))]
            if known
            else ["not known"]
        )
        allowed = "" if limit is None else f", limit {format_quantity(limit, unit).rstrip()}"
        chances = [chance for entry in entries if (chance := chance_of(entry, plan.campaign)) is not None]
        each = "at each value at least " if len(chances) > 1 else ""
        passing = f", {each}{100.0 * min(chances):.3g} % of units pass" if chances else ""
        count = f" ({len(entries)} values)" if len(entries) > 1 else ""
        title = quantity_title(analysis, quantity)
        yield f"{title}: U at least {' to '.join(ends)}{_most(entries)}{allowed}{passing}{count}"
    for quantity in plan.campaign.get("spread", {}).keys() - by_quantity.keys():
        yield f"missing: {quantity}, of which a spread is declared, is no result of this plan"
    for bound in prediction.bounds:
        about = ", ".join(map(str, bound.conditions.values()))
        smallest = format_quantity(_two_digits(bound.bound), bound.unit)
        title = quantity_title(analysis, bound.quantity)
        yield f"{title} ({about}): {bound.ratio:.3f} of the Cramér-Rao bound, {smallest}"
    yield from (f"missing: {sentence}" for sentence in prediction.missing)
    yield from (f"assumed: {sentence}" for sentence in prediction.assumed)


def _most(entries: list[Estimate]) -> str:
    """Return what brings most to the largest uncertainty, and how much of its variance, if others share it."""
    widest = max(entries, key=lambda entry: entry.std_uncertainty)
    name, part = next(iter(components_of(widest).items()))
    share = (part / widest.std_uncertainty) ** 2 if widest.std_uncertainty else 0.0
    return f", {100.0 * share:.0f} % of its variance by {name}" if name != OWN else ""


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")
