"""Static check of records: what a record says of itself must be what the bench was told before it.

The analysis sorts records by these conditions alone; a wrong one becomes a wrong number without any other sign.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from bench.plan.check.state import BenchState
from bench.plan.findings import Findings
from bench.plan.plan import Plan, Step


def check_record(plan: Plan, step: Step, state: BenchState, findings: Findings) -> None:
    """Note conditions of a record that the bench does not meet (B-PLAN-076), each with both values."""
    declared = {key: value for key, value in step.conditions.items() if value is not None}
    wrong = list(_temperature(declared, state))
    if not state.untrusted:
        if _is_closed(plan, declared, state):
            wrong += [*_route(declared, state), *_stimulus(declared, state)]
        else:
            wrong += _open(declared, state)
    if wrong:
        message = "the record says what the bench does not do: " + "; ".join(wrong)
        findings.add("B-PLAN-076", step.where, message, "correct the conditions, or the calls before the record")


def _is_closed(plan: Plan, declared: Mapping[str, Any], state: BenchState) -> bool:
    """Whether a record is one with a closed route. Left out, ``route`` means closed, as it does to the analysis."""
    if "route" in declared:
        return bool(declared["route"] != "open")
    analysed = plan.campaign.get("analysis") != "none" and "channel" in declared
    return bool(state.closed or analysed or declared.get("polarity") or declared.get("current_A"))


def _temperature(declared: Mapping[str, Any], state: BenchState) -> Iterator[str]:
    if "temperature_degC" in declared and state.target_degC is not None:
        yield from _differs("temperature", declared["temperature_degC"], state.target_degC, "degC", "the chamber is at")


def _route(declared: Mapping[str, Any], state: BenchState) -> Iterator[str]:
    if not state.closed:
        if state.switches:
            yield "its route is closed, but no route is (write 'route: open' if that is meant)"
        return
    route = next(iter(state.closed.values()))
    for key in ("channel", "polarity"):
        if key in declared and key in route:
            yield from _differs(key, declared[key], route[key], "", "the route has")


def _stimulus(declared: Mapping[str, Any], state: BenchState) -> Iterator[str]:
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


def _open(declared: Mapping[str, Any], state: BenchState) -> Iterator[str]:
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
    said, found = (f"{value:g} {unit}".strip() if isinstance(value, float) else value for value in (declared, actual))
    yield f"{name} {said}, but {verb} {'an unknown one' if actual is None else found}"
