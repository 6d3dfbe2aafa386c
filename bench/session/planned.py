"""What an analysis may see of a plan before it is run; all times begin with the preparation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.analysis import PROMPT, Exchange, Planned, Reading, Trace
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.plan import (
    Plan,
    PlannedCall,
    PlannedCommand,
    PlannedPrompt,
    PlannedRecord,
    Step,
    planned_temperature,
    round_count,
)

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
        if isinstance(step, PlannedPrompt) and step.sets:
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
