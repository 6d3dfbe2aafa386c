"""Unrolls a sequence into its flat list of steps: loops and procedures, down to the steps that do something."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.plan import leaves
from bench.plan.channels import UNITS, channel_numbers, in_slot
from bench.plan.deciding import expand_choose, expand_if, expand_while
from bench.plan.expand import MAX_STEPS, Expander, Node
from bench.plan.findings import suggestion
from bench.plan.language import sequence as language
from bench.plan.language.steps import (
    VERBS,
    ChannelPick,
    ChooseStep,
    ForStep,
    IfStep,
    ProcedureStep,
    TimelineEntry,
    WhileStep,
)
from bench.plan.step_kinds import PlannedSettle
from bench.plan.values import UNIT, Channel, Quantity, UnitInSlot, named, plain, traced

MAX_CALLS = 20
REQUIRED = "required"


class Unroller:
    """Unrolls the phases of a sequence into one plan."""

    def __init__(self, plan: Expander) -> None:
        self._plan = plan
        self._document = plan.document
        self._calls: list[str] = []
        self._turns = 0
        self._unused = set(plan.document.model.procedures)
        self._left_out = False  # a loop over an empty list

    def report_unused(self) -> None:
        """A procedure that nothing calls is a mistake: nothing in it was checked (B-PLAN-038)."""
        for name in sorted(self._unused):
            if (self._plan.findings or self._left_out) and len(re.findall(rf"\b{name}\b", self._document.text)) > 1:
                continue  # what would have used it may be what is wrong, or what is left out
            self._plan.fail(
                "B-PLAN-038", ("procedures", name), f"procedure {name!r} is never used", "use it or remove it"
            )

    def run(self, steps: Sequence[Any], node: Node) -> None:
        """Expand a list of steps."""
        for index, step in enumerate(steps):
            here = node.below(index)
            if isinstance(step, ForStep):
                self._loop(here, step)
            elif isinstance(step, ProcedureStep):
                self._procedure(here, step)
            elif self._plan.units and isinstance(step, IfStep | WhileStep | ChooseStep):
                message = "a decision goes by what one unit or the bench says, and several units are measured"
                here.fail("B-PLAN-141", message, "take it out, or measure one unit")
            elif isinstance(step, IfStep):
                expand_if(here, step, self.run)
            elif isinstance(step, WhileStep):
                expand_while(here, step, self.run)
            elif isinstance(step, ChooseStep):
                expand_choose(here, step, self.run)
            else:
                leaves.expand(here, step)

    def timeline(self, entries: Sequence[TimelineEntry], node: Node) -> None:
        """Expand the flat form; the time between two entries becomes a settle step."""
        plan = self._plan
        for index, entry in enumerate(entries):
            here = node.below(index)
            wait_s = round(entry.at - plan.known.at_s, 9)
            if wait_s < 0:
                message = f"at {entry.at:g} s: what stands before ends only at {plan.known.at_s:g} s"
                here.below("at").fail("B-PLAN-035", message, "give it a later time")
            elif wait_s > 0:
                plan.add(here, PlannedSettle, "", "", {"bus_s": 0.0}, Quantity(wait_s, "s"))
            plan.retry_step = len(plan.steps)
            leaves.expand_entry(here, entry)

    def _loop(self, node: Node, step: ForStep) -> None:
        values = self._values(node.below("in"), step.in_)
        self._left_out |= not values
        for index, value in enumerate(values):
            self._turns += 1
            if self._turns > MAX_STEPS:
                self._plan.too_many(node)
            if value is None:
                continue
            unit = isinstance(value, UnitInSlot)
            context = {UNIT if unit else named(step.for_, value): plain(value)}
            inner = node.below("do").inside({step.for_: value, f"{step.for_}_index": index}, context)
            self._enter(node, value)
            self.run(step.do, inner)
            self._plan.unit = None if unit else self._plan.unit

    def _enter(self, node: Node, value: Any) -> None:
        """Begin a turn of a loop: one over the units says whose links and instruments are meant."""
        if isinstance(value, UnitInSlot):
            if self._plan.unit is not None:
                node.fail("B-PLAN-141", "a loop over the units stands inside another one", "take one out")
            self._plan.unit = next(unit for unit in self._plan.units if unit.slot == value.slot)

    def _values(self, node: Node, raw: Any) -> Sequence[Any]:
        if isinstance(raw, ChannelPick):
            return self._pick(node.below("channels"), raw)
        if isinstance(raw, list):
            return [_traced(node.below(index), item, "the list") for index, item in enumerate(raw)]
        if raw == UNITS and self._plan.model.units is not None:
            return [in_slot(unit) for unit in self._plan.units]
        if raw == "channels":
            return [self._plan.channels[number] for number in sorted(self._plan.channels)]
        return self._named(node, raw)

    def _named(self, node: Node, raw: Any) -> Sequence[Any]:
        """Return a table, or the list that a reference stands for."""
        tables = self._plan.model.tables
        if raw in tables:
            return [
                _traced(replace(node, path=("tables", raw, index)), item, f"{raw}[{index}]")
                for index, item in enumerate(tables[raw])
            ]
        value = node.resolve(raw)
        if isinstance(value, tuple):
            return value
        if value is not None:
            known = suggestion(raw, ["channels", *tables])
            node.fail("B-PLAN-032", f"{raw!r} is not a list to loop over{known}")
        return ()

    def _pick(self, node: Node, pick: ChannelPick) -> list[Channel]:
        try:
            numbers = channel_numbers(pick.channels)
        except ValueError as error:
            node.fail("B-PLAN-020", str(error))
            return []
        for number in numbers:
            if number not in self._plan.channels:
                node.fail("B-PLAN-020", f"channel {number} is not declared under 'channels'")
        return [self._plan.channels[number] for number in numbers if number in self._plan.channels]

    def _procedure(self, node: Node, step: ProcedureStep) -> None:
        name, arguments = next(iter(step.root.items()))
        procedure, plan = self._plan.model.procedures.get(name), self._plan
        if procedure is None:
            known = suggestion(name, [*plan.model.procedures, *VERBS])
            node.fail("B-PLAN-033", f"there is no procedure or step {name!r}{known}")
            return
        if name in self._calls or len(self._calls) >= MAX_CALLS:
            node.fail("B-PLAN-034", f"procedure {name!r} calls itself: {' > '.join([*self._calls, name])}")
            return
        body = replace(node, path=("procedures", name))
        values = _arguments(node.below(name), body, procedure, arguments or {})
        self._unused.discard(name)
        outer, plan.retry_step = plan.retry_step, len(plan.steps)
        self._calls.append(name)
        self.run(procedure.do, body.below("do").inside(values))
        self._calls.pop()
        plan.retry_step = outer


def _arguments(node: Node, body: Node, procedure: language.Procedure, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a call at ``node`` of a procedure at ``body``."""
    name = node.path[-1]
    for key in given:
        if key not in procedure.arguments:
            known = suggestion(key, procedure.arguments)
            node.below(key).fail("B-PLAN-033", f"procedure {name!r} has no argument {key!r}{known}")
    values: dict[str, Any] = {}
    for key, default in procedure.arguments.items():
        if key not in given and default == REQUIRED:
            node.fail("B-PLAN-033", f"procedure {name!r} needs the argument {key!r}")
            values[key] = None
        else:
            place = node.below(key) if key in given else body.below("arguments", key)
            values[key] = _traced(place, given.get(key, default), f"argument {key}")
    return values


def _traced(node: Node, raw: Any, what: str) -> Any:
    """Return the value of what stands at a place; a quantity remembers it."""
    return traced(node.resolve(raw), f"{what}, line {node.plan.line(node.path)}")
