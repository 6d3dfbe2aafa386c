"""Static check of records that follow each other without a gap: what may stand between them, and for how long."""

from __future__ import annotations

from collections.abc import Collection

from bench.model.ports import Effect
from bench.plan.bus_time import bus_s, declared_action
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedCall, PlannedPrompt, PlannedRecord, PlannedVerify


def check_windows(plan: Plan, station: Station, findings: Findings, doubtful: Collection[int]) -> None:
    """Note records that say they follow another one and cannot (B-PLAN-060, -061, -067, -068).

    ``doubtful`` are the numbers of steps whose duration could not be read.
    """
    before: PlannedRecord | None = None
    gap = "no record stands before it"
    calls: list[Step] = []
    for step in plan.steps:
        if before is not None and before.phase != step.phase:
            gap, before = f"the record before it belongs to '{before.phase}'", None
        if step.on_the_bus:
            calls.append(step)
        elif not isinstance(step, PlannedRecord) and not _act(step):
            before, gap = None, f"a {step.kind} step stands between it and the record before"
        if not isinstance(step, PlannedRecord):
            continue
        if step.follows:
            _follows(step, before, gap, findings)
            _calls(step, calls if before is not None else [], station, findings, step.number in doubtful)
        before, calls = step, []


def _act(step: Step) -> bool:
    """A prompt whose act is part of what is measured: the records go on while the person does it."""
    return isinstance(step, PlannedPrompt) and bool(step.sets)


def _follows(step: PlannedRecord, before: PlannedRecord | None, gap: str, findings: Findings) -> None:
    if before is None:
        advice = "put it right behind a record, or take 'follows' out"
        findings.add("B-PLAN-067", step.where, f"the record follows nothing: {gap}", advice)
        return
    for record, role in ((before, "is followed by another one"), (step, "follows another one")):
        if record.retry:
            message = f"a record that {role} without a gap cannot be taken again (retry {record.retry})"
            findings.add(
                "B-PLAN-068", record.where, message, "leave 'retry' out; lost frames are counted in the record"
            )


def _calls(step: Step, calls: list[Step], station: Station, findings: Findings, doubtful: bool) -> None:
    """Calls fall into the window behind them: they may not touch what it measures, and must be over when it is."""
    wrong = next((call for call in calls if not _harmless(call, station)), None)
    if wrong is not None:
        named = ".".join(filter(None, (wrong.role, wrong.name)))
        message = f"{named} stands between two records without a gap; only actions of chamber or table and readings may"
        findings.add("B-PLAN-061", step.where, message, "add a settle step and take 'follows' out, or move the call")
    total_s = sum(bus_s(call, station) for call in calls)
    if total_s > step.duration_s and not doubtful:
        message = f"the calls before the record take up to {total_s:g} s; it lasts {step.duration_s:g} s"
        findings.add("B-PLAN-060", step.where, message, "take a longer record, or call less")


def _harmless(call: Step, station: Station) -> bool:
    declared = declared_action(station, call.role, call.name)
    if not isinstance(call, PlannedCall | PlannedVerify):
        return False
    if declared is None:
        return True  # a call of nothing is a mistake of its own
    reading = declared.effect is Effect.NONE and (bool(declared.returns) or isinstance(call, PlannedVerify))
    return reading or declared.effect in (Effect.THERMAL, Effect.MOTION_ON, Effect.MOTION_OFF)
