"""Static check of records: what they say of themselves, and what stands between two without a gap.

What a record says must be what the bench was told before it: the analysis sorts records by these conditions alone, and
a wrong one becomes a wrong number without any other sign.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Iterator
from dataclasses import dataclass
from typing import Any

from bench.model.ports import Effect
from bench.model.quantities import Values
from bench.model.stopping import STAGE
from bench.plan.check.state import BenchState
from bench.plan.decision import decisions_of
from bench.plan.drivers import bus_s, declared_action
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step
from bench.plan.station import Station
from bench.plan.step_kinds import PlannedCall, PlannedPrompt, PlannedRecord, PlannedVerify
from bench.plan.values import UNIT
from bench.plan.ways import Followed, walk


def check_record(plan: Plan, step: Step, state: BenchState, findings: Findings) -> None:
    """Note conditions of a record that the bench does not meet (B-PLAN-076), each with both values."""
    declared = {key: value for key, value in step.conditions.items() if value is not None}
    wrong = list(_temperature(declared, state))
    if not state.untrusted:
        if _is_closed(plan, declared, state):
            wrong += [*_route(plan, declared, state), *_stimulus(declared, state)]
        else:
            wrong += _open(declared, state)
    if wrong:
        message = "the record says what the bench does not do: " + "; ".join(wrong)
        findings.add("B-PLAN-076", step.where, message, "correct the conditions, or the calls before the record")


def _is_closed(plan: Plan, declared: Values, state: BenchState) -> bool:
    """Return whether a record has a closed route. Left out, ``route`` means closed, as it does to the analysis."""
    if "route" in declared:
        return bool(declared["route"] != "open")
    analysed = plan.campaign.get("analysis") != "none" and "channel" in declared
    return bool(state.closed or analysed or declared.get("polarity") or declared.get("current_A"))


def _temperature(declared: Values, state: BenchState) -> Iterator[str]:
    if "temperature_degC" in declared and state.target_degC is not None:
        yield from _differs("temperature", declared["temperature_degC"], state.target_degC, "degC", "the chamber is at")


def _route(plan: Plan, declared: Values, state: BenchState) -> Iterator[str]:
    if not state.closed:
        if state.switches:
            yield "its route is closed, but no route is (write 'route: open' if that is meant)"
        return
    route = next(iter(state.closed.values()))
    for key in ("channel", "polarity"):
        if key in declared and key in route:
            yield from _differs(key, declared[key], route[key], "", "the route has")
    unit = plan.unit_of(declared.get(UNIT))
    if unit is not None and "channel" in declared:
        yield from _differs("card", unit.card, route.get("card"), "", "the route has")


def _stimulus(declared: Values, state: BenchState) -> Iterator[str]:
    if not state.sources or not {"current_A", "range_A", "route"} & declared.keys():
        return
    on = sorted(state.output_on)
    if not on:
        yield f"its route is closed, but the output of {' and '.join(sorted(state.sources))} is off"
        return
    for role in on:
        if role in state.unknown:
            yield f"after raw text nobody knows the current of {role}"
            continue
        if role in state.level_A and state.level_A[role] is None:
            continue  # its mistake is noted already
        if "current_A" in declared:
            yield from _differs("current", declared["current_A"], state.level_A.get(role), "A", f"{role} was set to")
        if "range_A" in declared:
            yield from _differs("range", declared["range_A"], state.range_A.get(role), "A", f"{role} is on")


def _open(declared: Values, state: BenchState) -> Iterator[str]:
    for role, route in sorted(state.closed.items()):
        yield f"its route is open, but {role} has channel {route.get('channel', 'unknown')} closed"
    for role in sorted(state.output_on) if "route" in declared else ():
        yield f"its route is open, but the output of {role} is on"
    for key, unit in (("polarity", ""), ("current_A", "A"), ("range_A", "A")):
        if declared.get(key):
            yield from _differs(key.removesuffix("_A"), declared[key], 0, unit, "an open input has")


def _differs(name: str, declared: Any, actual: Any, unit: str, verb: str) -> Iterator[str]:
    numbers = all(isinstance(value, (int, float)) for value in (declared, actual))
    if math.isclose(declared, actual, rel_tol=1e-9) if numbers else declared == actual:
        return
    said, shown = (f"{value:g} {unit}".strip() if isinstance(value, float) else value for value in (declared, actual))
    yield f"{name} {said}, but {verb} {'an unknown one' if actual is None else shown}"


def check_windows(plan: Plan, station: Station, findings: Findings, doubtful: Collection[int]) -> None:
    """Note records that say they follow another one and cannot (B-PLAN-060, -061, -067, -068).

    ``doubtful`` are the numbers of steps whose duration could not be read.
    """
    joins = {branch.stop for decision in decisions_of(plan.steps) for branch in decision.branches}

    def take(chain: _Chain, step: Step) -> None:
        if step.number in joins:
            chain.breaks("the branches of a decision end between it and the record before")
        chain.take(step)
        if not isinstance(step, PlannedRecord):
            return
        if step.follows:
            _follows(step, chain.before, chain.gap, findings)
            _calls(step, list(chain.calls), station, findings, step.number in doubtful)
        chain.before, chain.calls = step, ()

    walk(plan.steps, _Chain(), take, findings)


@dataclass
class _Chain(Followed):
    """The record that another one could follow and the calls since then, or why none could (``gap``)."""

    before: PlannedRecord | None = None
    gap: str = "no record stands before it"
    calls: tuple[Step, ...] = ()

    def key(self) -> Hashable:
        return self.before and self.before.number, self.gap, tuple(call.number for call in self.calls)

    def breaks(self, why: str) -> None:
        self.before, self.gap, self.calls = None, why, ()

    def take(self, step: Step) -> None:
        if self.before is not None and self.before.phase != step.phase:
            self.breaks(f"the record before it belongs to '{self.before.phase}'")
        if step.on_the_bus:
            self.calls = () if self.before is None else (*self.calls, step)
        elif not isinstance(step, PlannedRecord) and not _act(step):
            self.breaks(f"a {step.kind} step stands between it and the record before")


def _act(step: Step) -> bool:
    """Return whether the act of a prompt is part of what is measured: the records go on while the person does it."""
    return isinstance(step, PlannedPrompt) and bool(step.sets)


def _follows(step: PlannedRecord, before: PlannedRecord | None, gap: str, findings: Findings) -> None:
    if before is None:
        advice = "put it right behind a record, or take 'follows' out"
        findings.add("B-PLAN-067", step.where, f"the record follows nothing: {gap}", advice)
        return
    for record, role in ((before, "is followed by another one"), (step, "follows another one")):
        if record.retry and STAGE not in record.conditions:  # a point in stages is taken again as a whole
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
