"""The values that a plan names: what each is called, its unit, under which conditions, and where it must lie.

They and the fits of them go into the section "campaign" of the manifest, where the analysis finds them, in base units.

A record can be made of readings: calls that only measure, taken one after another, again after each period.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.frame import BENCH, Signal, signal_of
from bench.model.declaration import stated
from bench.model.errors import InputError
from bench.model.events import Event
from bench.model.ports import Action, Effect
from bench.model.quantities import QUANTITY, Values, conditions_of_value, key_of_value
from bench.model.systems import analysis_declaration
from bench.model.units import dimension_of, likely, read_quantity
from bench.plan.check.analysis import NONE
from bench.plan.decision import PlannedDecision, ways_not_taken
from bench.plan.expand import Expander, Node, check_whole
from bench.plan.language.expect import (
    LOG,
    NONLINEARITY,
    RECIPROCAL,
    Bounds,
    Expect,
    Fit,
    ReadingExpect,
    ReplyExpect,
    SignalExpect,
    variable_of,
)
from bench.plan.language.steps import PromptValue, ReadStep, Record
from bench.plan.plan import Step
from bench.plan.station import declared_action
from bench.plan.step_kinds import WIRING, PlannedCall, PlannedPrompt, PlannedRecord
from bench.plan.values import Quantity, as_reference, plain

_SHARES = ("%", "ppm", "ppb")
_MEASURE = "measure_"


def named_conditions(
    node: Node, called: tuple[str, str], expect: ReadingExpect | None, conditions: Values
) -> dict[str, Any]:
    """Return the conditions of a reading with its name, if it has one, and keep what is expected of it.

    Without ``expect`` it is named after instrument and action where the analysis is made of all values.
    Findings: B-PLAN-120, B-PLAN-121.
    """
    (role, action), plan = called, node.plan
    unit = unit_of_action(plan, role, action)
    if expect is None:
        if not unit or plan.phase != "campaign" or not takes_all(plan):
            return dict(conditions)
    elif not unit:
        message = f"{role}.{action} gives no number, so nothing can be expected of it"
        node.fail("B-PLAN-120", message, "expect something of an action that returns a value")
        return dict(conditions)
    entry: dict[str, Any] = {
        "quantity": _default_name(role, action, unit) if expect is None else expect.name,
        "unit": unit,
        "conditions": conditions_of_value(conditions),
    }
    if expect is not None:
        here = node.below("expect")
        entry |= _limits_and_span(here, expect, unit)
        entry |= _scatter(here.below("scatter"), expect, unit)
    keep(node, entry, f"{role}.{action}")
    return {**conditions, QUANTITY: entry["quantity"]}


def _scatter(node: Node, expect: ReadingExpect, unit: str) -> dict[str, float]:
    """Return the standard deviation of one reading, if it is declared; B-PLAN-120 unless it is above zero."""
    scatter = bound_in(node, expect.scatter, unit)
    if scatter is not None and not scatter > 0.0:
        node.fail("B-PLAN-120", f"a scatter of {expect.scatter} is not above zero", "state it above zero")
        return {}
    return {} if scatter is None else {"scatter": scatter}


def _default_name(role: str, action: str, unit: str) -> str:
    """Return a name by instrument and action; a certificate knows a temperature by the end of its name."""
    name = f"{role}_{action.removeprefix(_MEASURE)}"
    return f"{name}_temperature" if unit == "degC" and not name.endswith("temperature") else name


def keep_given(node: Node, value: PromptValue) -> None:
    """Keep a value that a person gives, where the analysis is made of all values (B-PLAN-120, B-PLAN-121)."""
    if value.quantity is None or not takes_all(node.plan):
        return
    bare = node.plan.node(*node.path)
    ends = {"low": value.low, "high": value.high, "uncertainty": value.uncertainty}
    read = {name: bound_in(bare.below(name), text, value.unit) for name, text in ends.items()}
    entry = {"quantity": value.quantity, "unit": value.unit, "conditions": conditions_of_value(node.scope.context)}
    keep(node, entry | stated(read), "a person")


def keep_signals(node: Node, expects: Sequence[SignalExpect], conditions: Values) -> list[tuple[str, str]]:
    """Keep what is expected of numbers that the unit streams during a record; return quantity and signal of each.

    Findings: B-PLAN-120 (no such number, a limit in another unit), B-PLAN-121.
    """
    kept, plan = [], node.plan
    for index, expect in enumerate(expects):
        here = node.below("expect", index)
        try:
            signal = signal_of(expect.signal, plan.frames)
        except InputError as error:
            if plan.frames.keys() >= plan.model.frame.keys():  # else the frame says what is wrong with it
                here.below("signal").fail("B-PLAN-120", error.message, error.next_step)
            continue
        if signal.link == BENCH or signal.minus:
            message = f"{expect.signal} is no number of a frame"
            here.below("signal").fail("B-PLAN-120", message, "name link.field, or link.field[element]")
            continue
        factor, unit = read_quantity(f"1 {signal.unit or 1}") or (1.0, signal.unit)
        entry: dict[str, Any] = {"quantity": expect.name, "unit": unit, "conditions": conditions_of_value(conditions)}
        entry |= {"signal": signal.name, "factor": factor, "resolution": factor * _resolution(plan, signal)}
        keep(here, entry | _limits_and_span(here, expect, unit), signal.name)
        kept.append((expect.name, signal.name))
    return kept


def _resolution(plan: Expander, signal: Signal) -> float:
    """Return the step of a number in the unit of its field, 0 of a float."""
    messages = plan.frames[signal.link].layout.messages
    field = next(message.by_name[signal.field] for message in messages if message.name == signal.message)
    return 0.0 if field.kind == "f" else abs(field.scale)


def reply_conditions(
    node: Node, expect: ReplyExpect | None, asked: tuple[str, str], conditions: Values
) -> dict[str, Any]:
    """Return the conditions of a step with the name of its reply, if it has one, and keep what is expected of it.

    ``asked``: a unit or an instrument, and the words of its question. Findings: B-PLAN-120, B-PLAN-121.
    """
    if expect is None:
        return dict(conditions)
    here = node.below("expect")
    entry: dict[str, Any] = {"quantity": expect.name, "conditions": conditions_of_value(conditions)}
    said = {"pattern": expect.pattern, "unit": expect.unit, "of_unit": asked[0] in node.plan.model.frame}
    if expect.unit is None:
        entry |= {"unit": "1", "low": 1.0, "high": 1.0, "reply": {**said, "equals": expect.equals}}
    else:
        unit = dimension_of(expect.unit)
        entry |= {"unit": unit, "reply": said, **_limits_and_span(here, expect, unit)}
        entry |= stated({"uncertainty": bound_in(here.below("uncertainty"), expect.uncertainty, unit)})
    keep(here, entry, f"{asked[0]} {asked[1]}")
    return {**conditions, QUANTITY: expect.name}


def keep(node: Node, entry: dict[str, Any], read_by: str) -> None:
    """Keep a value that is named; one name for two is noted (B-PLAN-121)."""
    if wrong := node.plan.expected.add(entry, read_by):
        node.fail("B-PLAN-121", wrong, "give each its own name, or its own conditions")


def takes_all(plan: Expander) -> bool:
    """Return whether the analysis of the sequence is made of all values."""
    declared = analysis_declaration(plan.model.analysis)
    return declared is not None and declared.made_of == "values"


def unit_of_action(plan: Expander, role: str, action: str) -> str:
    """Return the unit of what an action gives, "" if it gives no number or does not exist."""
    declared = declared_action(plan.station, role, action)
    return "" if declared is None else declared.returns


def _limits_and_span(node: Node, expect: Expect, unit: str) -> dict[str, float]:
    span = bound_in(node.below("stable"), expect.stable, unit)
    return limits_in(node, expect, unit) | stated({"span": span})


def limits_in(node: Node, bounds: Bounds, unit: str) -> dict[str, float]:
    """Return low and high of what is expected, in base units, those that are stated (B-PLAN-120)."""
    if bounds.equals is not None:
        value = bound_in(node.below("equals"), bounds.equals, unit)
        reach = None if value is None else _reach(node.below("tolerance"), bounds, value, unit)
        low, high = (None, None) if value is None or reach is None else (value - reach, value + reach)
    elif bounds.within is not None:
        low, high = (bound_in(node.below("within", k), end, unit) for k, end in enumerate(bounds.within))
    else:
        low, high = (bound_in(node.below(end), getattr(bounds, end), unit) for end in ("min", "max"))
    if low is not None and high is not None and low > high:
        message = f"no value is inside its limits: {low:g} {unit} is above {high:g} {unit}"
        node.fail("B-PLAN-120", message, "exchange them")
    return stated({"low": low, "high": high})


def _reach(node: Node, bounds: Bounds, value: float, unit: str) -> float | None:
    """Return a tolerance in its base unit. It may be a share of the value it belongs to, in another unit than that."""
    text, equals = str(bounds.tolerance), str(bounds.equals)
    read = _read(node, text)
    if read is None or read.dimension != "1":
        return None if read is None else bound_in(node, text, unit)
    if unit != "1":
        return read.value * abs(value)
    if as_reference(text) is not None or as_reference(equals) is not None:
        message = f"{text} may be a share of the value or in its unit: both are plain numbers"
        node.fail("B-PLAN-120", message, "write value and tolerance here, or 'within'", read.origin)
        return None
    return read.value * abs(value) if _symbol(text) in _SHARES and _symbol(text) != _symbol(equals) else read.value


def _symbol(text: str) -> str:
    return text.lstrip("+-0123456789.eE ")


def bound_in(node: Node, text: str | None, unit: str) -> float | None:
    """Return a bound in its base unit."""
    if text is None:
        return None
    value = _read(node, text)
    if value is None:
        return None
    if value.dimension == unit:
        return value.value
    message = f"{text} is in {value.dimension}; the value it is held against is in {unit}{likely(text, unit)}"
    node.fail("B-PLAN-120", message, "write it in that unit", value.origin)
    return None


def _read(node: Node, text: str) -> Quantity | None:
    """Return a bound as a quantity; the unit of a coefficient may be one of no quantity of the language."""
    if as_reference(text) is not None:
        value = node.resolve(text)
        if value is not None and not isinstance(value, Quantity):
            _no_bound(node, text)
        return value if isinstance(value, Quantity) else None
    known = read_quantity(text)
    if known is not None:
        return Quantity(*known)
    number, unit = text.split(maxsplit=1)
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        _no_bound(node, text)
        return None
    return Quantity(value, unit)


def _no_bound(node: Node, text: str) -> None:
    node.fail("B-PLAN-120", f"{text!r} is not a quantity with its unit", "write a number and its unit")


def check_judged(plan: Expander) -> None:
    """Note values that are named and fits in a sequence without an analysis: nothing judges them (B-PLAN-122)."""
    model = plan.model
    if model.analysis == NONE and plan.expected.entries:
        message = "the sequence names values, and no analysis, so nothing judges them"
        plan.fail("B-PLAN-122", ("analysis",), message, "write 'analysis: readings', or another one")
    elif model.fits and not takes_all(plan):
        message = f"the analysis {model.analysis!r} makes no fits of values"
        plan.fail("B-PLAN-122", ("fits",), message, "write 'analysis: readings', or leave 'fits' out")


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


TIME = "time"


def fits_of(outer: Node) -> list[dict[str, Any]]:
    """Return the fits for the manifest (B-PLAN-120, B-PLAN-121, B-PLAN-123)."""
    fits: list[dict[str, Any]] = []
    plan = outer.plan
    for index, fit in enumerate(plan.model.fits if takes_all(plan) else ()):
        node = outer.below("fits", index)
        of, function = variable_of(fit.of)
        unit = plan.expected.unit_of(of)
        if unit is None:
            _unknown(node.below("of"), of)
            continue
        y_unit, against = _unit_of(node.below("of"), fit.of, unit), _against(node, fit)
        per = [_per(node.below("per", place), name) for place, name in enumerate(fit.per)]
        if against is None or y_unit is None or None in per:
            continue
        x_unit = _unit_of(node.below("against"), fit.against, against["unit"])
        if x_unit is None:
            continue
        units = {**coefficient_units(y_unit, x_unit, fit.orders), NONLINEARITY: unit}
        expected = {
            result: limits_in(node.below("expect", result), bounds, units[result])
            for result, bounds in fit.expect.items()
        }
        places = [entry["conditions"] for entry in plan.expected.entries if entry["quantity"] == of]
        least = min(Counter(tuple(map(place.get, fit.per)) for place in places).values())  # points of one fit
        if least < len(fit.orders):
            message = f"{least} points do not determine the {len(fit.orders)} coefficients of {fit.name}"
            node.fail("B-PLAN-123", message, "lower the degree, or read at more levels")
        asked = {"name": fit.name, "of": of, "powers": list(fit.orders), "per": per, "units": units,
                 "against": against, "expected": expected}  # fmt: skip
        asked |= {"function": function} if function else {}
        read_back = _read_back(node, fit, unit, against["unit"])
        fits.append(asked | ({"read_back": read_back} if read_back else {}))
    return fits


def coefficient_units(of: str, against: str, orders: Iterable[int]) -> dict[str, str]:
    """Return the units of the coefficients c0, c1, ... that a polynomial has."""
    units = {}
    for order in orders:
        power = against if order == 1 else f"{against}{order}"
        units[f"c{order}"] = of if against == "1" or not order else f"1/{power}" if of == "1" else f"{of}/{power}"
        if of == against and order:
            units[f"c{order}"] = "1" if order == 1 else f"1/{against}{'' if order == 2 else order - 1}"
    return units


def _unit_of(node: Node, variable: str, unit: str) -> str | None:
    """Return the unit of a function of a quantity (B-PLAN-123 for a logarithm of degrees)."""
    _, function = variable_of(variable)
    if function == LOG:
        if unit == "degC":
            message = f"{variable}: a temperature in degC has no logarithm, because its zero is arbitrary"
            node.fail("B-PLAN-123", message, "fit the temperature itself, or 1/x of it, which is in kelvin")
            return None
        return "1"
    if function == RECIPROCAL and unit != "1":
        return "1/K" if unit == "degC" else f"1/{unit}"
    return unit


def _against(node: Node, fit: Fit) -> dict[str, Any] | None:
    if fit.against == TIME:
        return {"time": True, "unit": "s"}
    name, function = variable_of(fit.against)
    plan = node.plan
    unit, condition = plan.expected.unit_of(name), plan.expected.condition(name)
    more = {"function": function} if function else {}
    if unit is not None:
        return {"quantity": name, "unit": unit, **more}
    if condition is None:
        _unknown(node.below("against"), name)
        return None
    against: dict[str, Any] = {"condition": condition[0], "unit": condition[1], **more}
    value = bound_in(plan.node(*node.path, "against_uncertainty"), fit.against_uncertainty, condition[1])
    return against | stated({"uncertainty": value})


def _read_back(node: Node, fit: Fit, unit: str, against: str) -> list[dict[str, Any]]:
    """Return the values of the curve that have a name, in the units of the quantities themselves."""
    entries = []
    for index, asked in enumerate(fit.read_back):
        here = node.below("read_back", index)
        at = bound_in(here.below("at"), asked.at, against)
        if asked.name in node.plan.expected.names:
            message = f"{asked.name!r} is read, and cannot be the name of a value of a fit"
            here.below("name").fail("B-PLAN-121", message, "give it a name of its own")
        elif at is not None:
            limits = limits_in(here, asked, unit)
            entries.append({"quantity": asked.name, "at": at, "unit": unit, **limits})
    return entries


def _per(node: Node, name: str) -> str | None:
    condition = node.plan.expected.condition(name)
    if condition is None:
        _unknown(node, name)
    return None if condition is None else condition[0]


def _unknown(node: Node, name: str) -> None:
    known = ", ".join(node.plan.expected.names) or "nothing"
    message = f"no value and no condition of one is called {name!r}"
    node.fail("B-PLAN-123", message, f"what is read: {known}; write 'expect: {{name: ...}}' beside a reading")
