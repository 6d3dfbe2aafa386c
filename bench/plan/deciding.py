"""Unrolls decisions: the steps of every branch one behind another, and what the compiler knows behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.model.units import likely, read_quantity
from bench.plan.decision import CHOOSE, DONE, FAIL, GO_ON, HOLD, IF, WHILE, Branch, PlannedDecision
from bench.plan.expand import Expander, Node
from bench.plan.expected import unit_of_action
from bench.plan.findings import suggestion
from bench.plan.language.expect import Comparison
from bench.plan.language.steps import CallStep, ChooseStep, IfStep, WhileStep
from bench.plan.readings import is_read_by
from bench.plan.step_kinds import PlannedCall, PlannedPrompt
from bench.plan.values import Quantity, plain

THEN, ELSE, TURN = "then", "else", "turn"
Run = Callable[[Sequence[Any], Node], None]


@dataclass(frozen=True)
class Known:
    """What the compiler knows at a place of the plan: planned time, levels and ranges of the sources, the band."""

    at_s: float
    levels_A: Mapping[str, float | None]
    ranges_A: Mapping[str, float | None]
    settle_band_degC: float | None

    @classmethod
    def of(cls, plan: Expander) -> Known:
        return cls(plan.at_s, dict(plan.levels_A), dict(plan.ranges_A), plan.settle_band_degC)

    def again(self, plan: Expander) -> None:
        """Let the plan go on from here."""
        plan.at_s, plan.settle_band_degC = self.at_s, self.settle_band_degC
        plan.levels_A, plan.ranges_A = dict(self.levels_A), dict(self.ranges_A)


def join(plan: Expander, ways: Sequence[Known]) -> None:
    """Let the plan go on behind branches: at the latest of their times, with what all of them have left the same."""
    first = ways[0]
    same = {
        role
        for role, level_A in first.levels_A.items()
        if all((w.levels_A.get(role, math.nan), w.ranges_A.get(role)) == (level_A, first.ranges_A[role]) for w in ways)
    }
    bands = {way.settle_band_degC for way in ways}
    Known(
        max(way.at_s for way in ways),
        {role: first.levels_A[role] for role in same},
        {role: first.ranges_A[role] for role in same},
        first.settle_band_degC if len(bands) == 1 else None,
    ).again(plan)


def expand_if(node: Node, step: IfStep, run: Run) -> None:
    """Append a decision and both of its branches."""
    here = node.below("if")
    decision = _decision(here, IF, step.if_.reading)
    bodies = [(THEN, *_compared(here, decision, step.if_), step.then, node.below("then"))]
    _branches(node, decision, bodies, step.else_, run)


def expand_choose(node: Node, step: ChooseStep, run: Run) -> None:
    """Append a decision and the branch of each of its cases."""
    decision = _decision(node.below("choose"), CHOOSE, step.choose)
    bodies = []
    for index, case in enumerate(step.cases):
        here = node.below("cases", index)
        bodies.append((f"case {index + 1}", *_compared(here, decision, case), case.do, here.below("do")))
    _branches(node, decision, bodies, step.else_, run)


_Body = tuple[str, str, tuple[float, ...], Sequence[Any], Node]


def _branches(
    node: Node, decision: PlannedDecision, bodies: Iterable[_Body], otherwise: Sequence[Any] | None, run: Run
) -> None:
    plan, missing = node.plan, HOLD if otherwise is None else ELSE
    before, ways, branches = Known.of(plan), [], []
    for outcome, comparison, values, steps, here in (*bodies, (ELSE, "", (), otherwise or [], node.below("else"))):
        before.again(plan)
        first = len(plan.steps)
        run(steps, here)
        ways.append(Known.of(plan))
        branches.append(Branch(outcome, first, len(plan.steps), comparison, values))
    join(plan, ways)
    plan.steps[decision.number] = replace(decision, branches=tuple(branches), missing=missing)


def expand_while(node: Node, step: WhileStep, run: Run) -> None:
    """Append every turn with the decision before it, and the decision behind the last one."""
    here, plan = node.below("while"), node.plan
    decisions, ways = [], []
    for turn in range(1, step.at_most + 2):
        decisions.append(_decision(here, WHILE, step.while_.reading))
        ways.append(Known.of(plan))
        if turn <= step.at_most:
            run(step.do, node.below("do").inside({TURN: turn}, {TURN: turn}))
        if turn == 1:
            _reads_again(here, decisions[0])
    join(plan, ways)
    end, missing = len(plan.steps), {None: HOLD, GO_ON: DONE}.get(step.else_, step.else_ or HOLD)
    for decision in decisions:
        last = decision is decisions[-1]
        first, outcome = decision.number + 1, (step.else_ or FAIL) if last else TURN
        turn_on = Branch(outcome, first, end, *_compared(here, decision, step.while_))
        branches = (turn_on, Branch(DONE, end, end))
        plan.steps[decision.number] = replace(decision, branches=branches, missing=missing)


def _reads_again(node: Node, decision: PlannedDecision) -> None:
    """Note a loop that could never end because nothing in it takes its reading (B-PLAN-110)."""
    steps = node.plan.steps
    body = (steps[at] for at in range(decision.number + 1, len(steps)))
    if not any(is_read_by(decision, step) for step in body):
        message = f"the loop goes by {decision.reading}, and nothing in it reads that again"
        node.fail("B-PLAN-110", message, "read it in 'do', so that the condition can change")


def _decision(node: Node, word: str, reading: str | CallStep) -> PlannedDecision:
    """Append a decision whose branches are not known yet. Its reading must be taken before it (B-PLAN-110)."""
    role, name, given, plan = "", reading, {}, node.plan
    if isinstance(reading, CallStep):
        role, name, values = (node if word == CHOOSE else node.below("reading")).called(reading)
        given = {key: plain(value) for key, value in values.items()}
    number = len(plan.steps)
    more = {"word": word, "arguments": given, "unit": "", "branches": (), "missing": HOLD, "retry_step": number}
    plan.add(node, PlannedDecision, role, str(name), more)
    decision = plan.steps[number]
    assert isinstance(decision, PlannedDecision)
    before = (plan.steps[at] for at in range(number - 1, -1, -1))
    taken = next((step for step in before if is_read_by(decision, step)), None)
    if taken is None:
        known = suggestion(decision.reading, {name for step in plan.steps[:number] for name in _readings(plan, step)})
        message = f"nothing before this step reads {decision.reading}{known}"
        node.fail("B-PLAN-110", message, "put the reading before the decision")
        return decision
    same_phase = [taken.number] if taken.phase == plan.phase else []
    back = [number, *same_phase, *([] if plan.retry_step is None else [plan.retry_step])]
    unit = taken.unit if isinstance(taken, PlannedPrompt) else unit_of_action(plan, role, str(name))
    return replace(decision, unit=unit, retry_step=min(back))


def _readings(plan: Expander, step: Any) -> Iterable[str]:
    if isinstance(step, PlannedPrompt):
        yield from step.quantities
    for call in (step, *step.calls):
        if isinstance(call, PlannedCall) and unit_of_action(plan, call.role, call.name):
            yield f"{call.role}.{call.name}"


def _compared(node: Node, decision: PlannedDecision, comparison: Comparison) -> tuple[str, tuple[float, ...]]:
    """Return the comparison and its values in the unit of the reading; what cannot be compared is noted (B-PLAN-111).

    Nothing is said of a reading that nothing takes.
    """
    word = comparison.word
    written, here = getattr(comparison, word), node.below(word)
    values = (
        tuple(_value(here.below(index), decision, raw) for index, raw in enumerate(written))
        if word == "within"
        else (_value(here, decision, written),)
    )
    if len(values) == 2 and values[0] > values[1]:
        message = f"no reading is within {written[0]} and {written[1]}: the first is above the second"
        here.fail("B-PLAN-111", message, "exchange them")
    return word, values


def _value(node: Node, decision: PlannedDecision, raw: Any) -> float:
    value = node.resolve(raw)
    unit = decision.unit
    if value is None or not unit:
        return math.nan
    if isinstance(value, Quantity) and value.dimension == unit:
        return value.value
    if unit == "1" and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if read_quantity(f"1 {unit}") is None:
        message = f"{decision.reading} is read in {unit}, and no value of a sequence has this unit"
    else:
        shown = f"{value.value:g} {value.dimension}" if isinstance(value, Quantity) else repr(plain(value))
        message = f"{decision.reading} is read in {unit}; {shown} cannot be compared with it{likely(value, unit)}"
    origin = value.origin if isinstance(value, Quantity) else ""
    node.fail("B-PLAN-111", message, f"write a quantity in {unit}" if unit != "1" else "write a number", origin)
    return math.nan
