"""The shortest sequence that makes up for records which are missing or invalid, with points that overlap.

Everything comes from the session: its plan says what each point does, its sequence what the unit and the analysis are.
The overlap is one good point of each channel at each temperature, taken again: what changed between the sessions
shows there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from bench.model.errors import InputError
from bench.model.ports import DE_ENERGISING, Drivers
from bench.model.quantities import QUANTITY
from bench.plan import (
    Plan,
    PlannedCall,
    PlannedPrompt,
    PlannedRecord,
    PlannedSoak,
    PlannedVerify,
    Step,
    Steps,
    expected_reading,
    station_drivers,
)
from bench.run.setpoints import stimulus_again
from bench.session.record_states import VALID, RecordState

_DROPPED = ("sequence", "title", "duration", "records", "prepare", "steps", "timeline", "finally", "procedures")
_SECTION = re.compile(r"^([a-z_]+):", re.MULTILINE)
Written = Callable[[Step], str]  # a step of the plan, as a sequence has it
_BETWEEN = (PlannedRecord, PlannedVerify, PlannedSoak, PlannedPrompt)  # they end the point before


def make_up_sequence(plan: Plan, states: Sequence[RecordState]) -> tuple[str, int, int]:
    """Return YAML text of the make-up sequence, the number of points it makes up, and of those that overlap.

    Raises: InputError B-RES-007 if nothing is missing, B-RES-008 for records that follow each other without a gap.
    """
    again = [state for state in states if state.state != VALID]
    if not again:
        raise InputError("B-RES-007", "every record is valid, there is nothing to make up", next_step="'bench fit'")
    drivers = station_drivers(plan.station)
    written = partial(_written, plan, drivers)
    others = (step for step in plan.steps if not isinstance(step, PlannedRecord))
    for step in (*(state.step for state in again), *others):
        step.written(drivers)
    overlap = _overlap(plan, states, again)
    chosen = sorted([*again, *overlap], key=lambda state: (state.state != VALID, state.step.number))
    name = f"{plan.name}_make_up"
    lines = [
        f"# Make-up of {plan.name}: {len(again)} points that are missing or invalid, {len(overlap)} that overlap.",
        f"sequence: {name}",
        f"title: {json.dumps(f'{plan.title}: make-up'[:200], ensure_ascii=False)}",
        *_head(plan),
        "",
        *_section("prepare", written, plan.phase("prepare")),
        "steps:",
        *_steps(plan, written, chosen),
        "",
    ]
    lines += _section("finally", written, plan.phase("finally"))
    lines += ["procedures:", *_procedures(plan, drivers, written, chosen)]
    return "\n".join(lines) + "\n", len(again), len(overlap)


def _section(name: str, written: Written, steps: Steps) -> list[str]:
    return [f"{name}:", *(f"  - {written(step)}" for step in steps), ""] if steps else []


def _overlap(plan: Plan, states: Sequence[RecordState], again: Sequence[RecordState]) -> list[RecordState]:
    """Return the good point with the largest current of each channel and temperature that is visited again."""
    visited = {_visit(plan, state.step) for state in again}
    best: dict[Any, RecordState] = {}
    for state in states:
        visit = _visit(plan, state.step)
        if state.state == VALID and visit in visited:
            known = best.get(visit)
            if known is None or _current_A(state) > _current_A(known):
                best[visit] = state
    return list(best.values())


def _visit(plan: Plan, step: Step) -> tuple[Any, ...]:
    return _soak_key(_soak_before(plan, step)), step.conditions.get("channel")


def _current_A(state: RecordState) -> float:
    return abs(float(state.step.conditions.get("current_A", 0.0)))


def _soak_before(plan: Plan, step: Step) -> PlannedSoak | None:
    return next((before for before in reversed(plan.steps[: step.number]) if isinstance(before, PlannedSoak)), None)


def _soak_key(soak: PlannedSoak | None) -> str:
    return "" if soak is None else json.dumps([soak.role, soak.told()], sort_keys=True)


def _steps(plan: Plan, written: Written, chosen: Sequence[RecordState]) -> Iterator[str]:
    """Yield each temperature once, in the order of the plan; the overlap first, then what is made up."""
    visits: dict[str, tuple[PlannedSoak | None, list[RecordState]]] = {}
    for state in sorted(chosen, key=lambda state: state.step.number):
        soak = _soak_before(plan, state.step)
        visits.setdefault(_soak_key(soak), (soak, []))[1].append(state)
    for soak, points in visits.values():
        if soak is not None:
            yield f"  - {written(soak)}"
        for state in sorted(points, key=lambda state: (state.state != VALID, state.step.number)):
            why = f"overlap, was record {state.number}" if state.state == VALID else state.why
            yield f"  - {_name(state)}  # {' '.join(why.split())}"


def _name(state: RecordState) -> str:
    return f"{'overlap' if state.state == VALID else 'point'}_{state.step.number}"


def _procedures(plan: Plan, drivers: Drivers, written: Written, chosen: Sequence[RecordState]) -> Iterator[str]:
    for state in chosen:
        yield f"  {_name(state)}:"
        yield "    do:"
        for step in _point(plan, drivers, state.step):
            yield f"      - {written(step)}"


def _point(plan: Plan, drivers: Drivers, record: PlannedRecord) -> Steps:
    """Return steps of a point, from where it would be taken again to its last verification.

    In the flat form a record stands alone: everything since the record before it belongs to the point. A stimulus that
    was on before is switched off as ``finally`` does it, set and switched on first.
    """
    first = record.retry_step
    if first == record.number:
        while (
            first > 0 and (before := plan.steps[first - 1]).phase == record.phase and not isinstance(before, _BETWEEN)
        ):
            first -= 1
    stop = record.number + 1
    while stop < len(plan.steps) and isinstance(plan.steps[stop], PlannedVerify):
        stop += 1
    again = stimulus_again(plan.steps, first, drivers)
    roles = {step.role for step in again}
    ends = [step for step in plan.phase("finally") if step.role in roles]
    off = [step for step in ends if not DE_ENERGISING.isdisjoint(step.effects(drivers[step.role]))]
    return [*off, *again, *plan.steps[first:stop]]


def _head(plan: Plan) -> list[str]:
    """Return the sections of the session's sequence that say what the unit, the bench and the analysis are."""
    text = plan.texts[f"sequences/{plan.name}.yaml"]
    starts = [*_SECTION.finditer(text)]
    stops = [match.start() for match in starts[1:]] + [len(text)]
    kept = []
    for match, stop in zip(starts, stops, strict=True):
        if match[1] not in _DROPPED:
            section = _without_tail(text[match.start() : stop])
            kept.append(_with_settings(section, plan.settings) if match[1] == "parameters" else section)
    return "\n".join(kept).splitlines()


def _without_tail(section: str) -> str:
    """Return a section without the comments and blank lines in front of the next one."""
    lines = section.splitlines()
    while lines and (not lines[-1].strip() or lines[-1].startswith("#")):
        lines.pop()
    return "\n".join(lines)


def _with_settings(section: str, settings: Mapping[str, str]) -> str:
    """Return the parameters with the values the run was given with ``--set``."""
    lines = section.splitlines()
    for at, line in enumerate(lines):
        key = line.strip().partition(":")[0]
        if key in settings:
            value = settings[key]
            many = line.partition(":")[2].strip().startswith("[")
            lines[at] = f"  {key}: {f'[{value}]' if many else _scalar(value)}"
    return "\n".join(lines)


def _scalar(text: str) -> str:
    """Return a value as it was given: a number or word of YAML stays one, anything else is a text."""
    return text if re.fullmatch(r"-?\d+(\.\d+)?|true|false", text) else json.dumps(text)


def _written(plan: Plan, drivers: Drivers, step: Step) -> str:
    """Return a step of the plan as a step of the structured form, in one line; JSON is YAML."""
    if isinstance(step, PlannedCall):
        call = expected_reading(step, drivers)
        return call if isinstance(call, str) else json.dumps(call, ensure_ascii=False)
    words = step.written(drivers)
    if QUANTITY in step.conditions:
        return json.dumps({**words, "expect": _reply(plan, step)}, ensure_ascii=False)
    ((key, value),) = words.items()
    return f"{key}: {json.dumps(value, ensure_ascii=False)}"


def _reply(plan: Plan, step: Step) -> dict[str, Any]:
    """Return what a reply is called and how it is read; the limits stand in the session that is made up for."""
    name = step.conditions[QUANTITY]
    read = next(entry["reply"] for entry in plan.campaign["expected"] if entry["quantity"] == name)
    return {"name": name} | {key: read[key] for key in ("pattern", "unit", "equals") if read.get(key) is not None}
