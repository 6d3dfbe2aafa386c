"""Records that are made of readings: calls that only measure, taken one after another, again after each period."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.model.events import Event
from bench.model.ports import Action, Effect
from bench.model.quantities import QUANTITY, Values, conditions_of_value, key_of_value
from bench.plan.decision import PlannedDecision, ways_not_taken
from bench.plan.expand import Node, check_whole
from bench.plan.expected import named_conditions
from bench.plan.language.steps import ReadStep, Record
from bench.plan.plan import Step
from bench.plan.step_kinds import WIRING, PlannedCall, PlannedPrompt, PlannedRecord
from bench.plan.values import Quantity, plain

READINGS, EVERY = "readings", "every"


def roles_of(steps: Iterable[Step]) -> set[str]:
    """Return the roles and links that steps use, those that records read among them."""
    return {call.role for step in steps for call in (step, *step.calls)}


def values_not_due(steps: Sequence[Step], events: Iterable[Event]) -> frozenset[str]:
    """Return the keys of the values whose every step the decisions among the events have left out."""
    gone = ways_not_taken(steps, events)
    if not gone:
        return frozenset()
    due = {key for step in steps if step.number not in gone for key in _keys_of(step)}
    return frozenset(key for number in gone for key in _keys_of(steps[number])) - due


def _keys_of(step: Step) -> list[str]:
    conditions = conditions_of_value(step.conditions)
    return [key_of_value(quantity, conditions) for quantity in step.quantities]


def is_read_by(decision: PlannedDecision, step: Step) -> bool:
    """Return whether a step takes the reading that a decision asks for."""
    if isinstance(step, PlannedPrompt):
        return not decision.role and step.quantity == decision.name
    return any(
        (call.role, call.name) == (decision.role, decision.name) and is_answered(decision, call.arguments)
        for call in (step, *step.calls)
        if isinstance(call, PlannedCall)
    )


def is_answered(decision: PlannedDecision, arguments: Values) -> bool:
    """Return whether a reading of its action with these arguments is the one it asks for: as far as it names them."""
    return all(name in arguments and arguments[name] == value for name, value in decision.arguments.items())


def reading_place(index: int, argument: str) -> str:
    """Return the name under which a record's step keeps the dimension of an argument of one of its readings."""
    return f"{READINGS}.{index}.{argument}"


def round_count(record: PlannedRecord) -> int:
    """Return how many times a record takes its readings."""
    return round(record.seconds / record.every_s)


def is_reading(action: Action) -> bool:
    """Return whether an action measures something and changes nothing."""
    return action.effect is Effect.NONE and bool(action.returns)


def expand_readings(
    node: Node, record: Record, seconds: Quantity | None, conditions: Values
) -> tuple[dict[str, Any], dict[str, Quantity]]:
    """Return the arguments of a record that say what is read, and the quantities in them by ``reading_place``.

    Findings: B-PLAN-096 (a record of neither frames nor readings, or of both), B-PLAN-042 (part of a round).
    """
    link, code = node.plan.link, "B-PLAN-096"
    if not record.readings:
        if not link:
            advice = "write 'readings: [role.action]' and 'every', or name the link under 'frame'"
            node.fail(code, "the record has neither frames nor readings: the sequence names no link", advice)
        elif record.every is not None:
            node.below(EVERY).fail(code, "'every' says when readings are taken, and the record has none")
        return {}, {}
    if link:
        node.below(READINGS).fail(code, f"the record counts frames of {link}, so it cannot be made of readings")
    elif record.purpose == WIRING:
        node.fail(code, "a wiring check counts frames; it cannot be made of readings")
    every = seconds if record.every is None else node.quantity(record.every, "s", EVERY)
    if seconds is not None and every is not None:
        rounds = seconds.value / every.value if every.value > 0 else 0.0
        check_whole(node, seconds, rounds, f"rounds of readings, one each {every.value:g} s")
    calls: list[dict[str, Any]] = []
    quantities: dict[str, Quantity] = {}
    for index, reading in enumerate(record.readings):
        call, expect = (reading.call, reading.expect) if isinstance(reading, ReadStep) else (reading, None)
        place = node.below(READINGS, index)
        role, name, values = place.called(call)
        quantity = named_conditions(place, (role, name), expect, conditions).get(QUANTITY, "")
        arguments = {key: plain(value) for key, value in values.items()}
        calls.append({"role": role, "name": name, "arguments": arguments, QUANTITY: quantity})
        quantities |= {reading_place(index, key): v for key, v in values.items() if isinstance(v, Quantity)}
    return {READINGS: calls, EVERY: every}, quantities


def argument_dimensions(dimensions: Mapping[str, str], index: int) -> dict[str, str]:
    """Return the dimensions of the arguments of one reading of a record, by name."""
    before = reading_place(index, "")
    return {name.removeprefix(before): unit for name, unit in dimensions.items() if name.startswith(before)}
