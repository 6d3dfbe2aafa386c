"""Unrolls a sequence into its flat list of steps: loops and procedures, down to the steps that do something."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from bench.plan import leaves
from bench.plan.channels import channel_numbers
from bench.plan.deciding import expand_choose, expand_if, expand_while
from bench.plan.expand import MAX_STEPS, Expander, Path
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
from bench.plan.slots import UNITS, in_slot
from bench.plan.values import UNIT, Channel, Quantity, Scope, UnitInSlot, named, plain, traced

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

    def run(self, steps: Sequence[Any], path: Path, scope: Scope) -> None:
        """Expand a list of steps."""
        for index, step in enumerate(steps):
            here = (*path, index)
            if isinstance(step, ForStep):
                self._loop(step, here, scope)
            elif isinstance(step, ProcedureStep):
                self._procedure(step, here, scope)
            elif self._plan.units and isinstance(step, IfStep | WhileStep | ChooseStep):
                message = "a decision goes by what one unit or the bench says, and several units are measured"
                self._plan.fail("B-PLAN-141", here, message, "take it out, or measure one unit")
            elif isinstance(step, IfStep):
                expand_if(self._plan, step, here, scope, self.run)
            elif isinstance(step, WhileStep):
                expand_while(self._plan, step, here, scope, self.run)
            elif isinstance(step, ChooseStep):
                expand_choose(self._plan, step, here, scope, self.run)
            else:
                leaves.expand(self._plan, step, here, scope)

    def timeline(self, entries: Sequence[TimelineEntry], path: Path, scope: Scope) -> None:
        """Expand the flat form; the time between two entries becomes a settle step."""
        for index, entry in enumerate(entries):
            here = (*path, index)
            wait_s = round(entry.at - self._plan.at_s, 9)
            if wait_s < 0:
                message = f"at {entry.at:g} s: what stands before ends only at {self._plan.at_s:g} s"
                self._plan.fail("B-PLAN-035", (*here, "at"), message, "give it a later time")
            elif wait_s > 0:
                self._plan.add("settle", "", "", {"bus_s": 0.0}, scope, here, Quantity(wait_s, "s"))
            self._plan.retry_step = len(self._plan.steps)
            leaves.expand_entry(self._plan, entry, here, scope)

    def _loop(self, step: ForStep, path: Path, scope: Scope) -> None:
        values = self._values(step.in_, (*path, "in"), scope)
        self._left_out |= not values
        for index, value in enumerate(values):
            self._turns += 1
            if self._turns > MAX_STEPS:
                self._plan.too_many(path)
            if value is None:
                continue
            unit = isinstance(value, UnitInSlot)
            context = {UNIT if unit else named(step.for_, value): plain(value)}
            inner = scope.extended({step.for_: value, f"{step.for_}_index": index}, context)
            self._enter(value, path)
            self.run(step.do, (*path, "do"), inner)
            self._plan.unit = None if unit else self._plan.unit

    def _enter(self, value: Any, path: Path) -> None:
        """Begin a turn of a loop: one over the units says whose links and instruments are meant."""
        if isinstance(value, UnitInSlot):
            if self._plan.unit is not None:
                self._plan.fail("B-PLAN-141", path, "a loop over the units stands inside another one", "take one out")
            self._plan.unit = next(unit for unit in self._plan.units if unit.slot == value.slot)

    def _values(self, raw: Any, path: Path, scope: Scope) -> Sequence[Any]:
        if isinstance(raw, ChannelPick):
            return self._pick(raw, (*path, "channels"))
        if isinstance(raw, list):
            return [self._item(item, (*path, index), scope) for index, item in enumerate(raw)]
        if raw == UNITS and self._document.model.units is not None:
            return [in_slot(unit) for unit in self._plan.units]
        if raw == "channels":
            return [self._plan.channels[number] for number in sorted(self._plan.channels)]
        return self._named(raw, path, scope)

    def _named(self, raw: Any, path: Path, scope: Scope) -> Sequence[Any]:
        """Return a table, or the list that a reference stands for."""
        if raw in self._document.model.tables:
            table = self._document.model.tables[raw]
            return [self._entry(raw, index, item, scope) for index, item in enumerate(table)]
        value = self._plan.resolve(raw, scope, path)
        if isinstance(value, tuple):
            return value
        if value is not None:
            known = suggestion(raw, ["channels", *self._document.model.tables])
            self._plan.fail("B-PLAN-032", path, f"{raw!r} is not a list to loop over{known}")
        return ()

    def _item(self, raw: Any, path: Path, scope: Scope) -> Any:
        return traced(self._plan.resolve(raw, scope, path), f"the list, {self._plan.line(path)}")

    def _entry(self, table: str, index: int, raw: Any, scope: Scope) -> Any:
        path = ("tables", table, index)
        return traced(self._plan.resolve(raw, scope, path), f"{table}[{index}], {self._plan.line(path)}")

    def _pick(self, pick: ChannelPick, path: Path) -> list[Channel]:
        try:
            numbers = channel_numbers(pick.channels)
        except ValueError as error:
            self._plan.fail("B-PLAN-020", path, str(error))
            return []
        for number in numbers:
            if number not in self._plan.channels:
                self._plan.fail("B-PLAN-020", path, f"channel {number} is not declared under 'channels'")
        return [self._plan.channels[number] for number in numbers if number in self._plan.channels]

    def _procedure(self, step: ProcedureStep, path: Path, scope: Scope) -> None:
        name, arguments = next(iter(step.root.items()))
        procedure = self._document.model.procedures.get(name)
        if procedure is None:
            known = suggestion(name, [*self._document.model.procedures, *VERBS])
            self._plan.fail("B-PLAN-033", path, f"there is no procedure or step {name!r}{known}")
            return
        if name in self._calls or len(self._calls) >= MAX_CALLS:
            self._plan.fail("B-PLAN-034", path, f"procedure {name!r} calls itself: {' > '.join([*self._calls, name])}")
            return
        values = self._arguments(procedure, name, arguments or {}, (*path, name), scope)
        self._unused.discard(name)
        outer, self._plan.retry_step = self._plan.retry_step, len(self._plan.steps)
        self._calls.append(name)
        self.run(procedure.do, ("procedures", name, "do"), scope.extended(values))
        self._calls.pop()
        self._plan.retry_step = outer

    def _arguments(
        self, procedure: language.Procedure, name: str, given: Mapping[str, Any], path: Path, scope: Scope
    ) -> dict[str, Any]:
        for key in given:
            if key not in procedure.arguments:
                known = suggestion(key, procedure.arguments)
                self._plan.fail("B-PLAN-033", (*path, key), f"procedure {name!r} has no argument {key!r}{known}")
        values: dict[str, Any] = {}
        for key, default in procedure.arguments.items():
            if key not in given and default == REQUIRED:
                self._plan.fail("B-PLAN-033", path, f"procedure {name!r} needs the argument {key!r}")
                values[key] = None
            elif key in given:
                values[key] = self._argument(key, given[key], (*path, key), scope)
            else:
                values[key] = self._argument(key, default, ("procedures", name, "arguments", key), scope)
        return values

    def _argument(self, key: str, raw: Any, path: Path, scope: Scope) -> Any:
        return traced(self._plan.resolve(raw, scope, path), f"argument {key}, {self._plan.line(path)}")
