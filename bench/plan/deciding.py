"""Unrolls decisions: the steps of every branch one behind another, and what the compiler knows behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.model.units import likely, read_quantity
from bench.plan.decision import CHOOSE, DONE, FAIL, GO_ON, HOLD, IF, WHILE, Branch, PlannedDecision
from bench.plan.drivers import declared_action
from bench.plan.expand import Expander, Path
from bench.plan.findings import suggestion
from bench.plan.language.comparison import Comparison
from bench.plan.language.steps import CallStep, ChooseStep, IfStep, WhileStep
from bench.plan.readings import is_read_by, reading_calls
from bench.plan.step_kinds import PlannedCall, PlannedPrompt
from bench.plan.values import Quantity, Scope, plain

THEN, ELSE, TURN = "then", "else", "turn"
Run = Callable[[Sequence[Any], Path, Scope], None]


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


def expand_if(plan: Expander, step: IfStep, path: Path, scope: Scope, run: Run) -> None:
    """Append a decision and both of its branches."""
    decision = _decision(plan, IF, step.if_.reading, (*path, "if"), scope)
    comparison, values = _compared(plan, decision, step.if_, (*path, "if"), scope)
    bodies = [(THEN, comparison, values, step.then, (*path, "then")), (ELSE, "", (), step.else_ or [], (*path, "else"))]
    _branches(plan, decision, bodies, ELSE if step.else_ is not None else HOLD, scope, run)


def expand_choose(plan: Expander, step: ChooseStep, path: Path, scope: Scope, run: Run) -> None:
    """Append a decision and the branch of each of its cases."""
    decision = _decision(plan, CHOOSE, step.choose, (*path, "choose"), scope)
    bodies = []
    for index, case in enumerate(step.cases):
        here = (*path, "cases", index)
        bodies.append((f"case {index + 1}", *_compared(plan, decision, case, here, scope), case.do, (*here, "do")))
    bodies.append((ELSE, "", (), step.else_ or [], (*path, "else")))
    _branches(plan, decision, bodies, ELSE if step.else_ is not None else HOLD, scope, run)


_Body = tuple[str, str, tuple[float, ...], Sequence[Any], Path]


def _branches(
    plan: Expander, decision: PlannedDecision, bodies: Iterable[_Body], missing: str, scope: Scope, run: Run
) -> None:
    before, ways, branches = Known.of(plan), [], []
    for outcome, comparison, values, steps, path in bodies:
        before.again(plan)
        first = len(plan.steps)
        run(steps, path, scope)
        ways.append(Known.of(plan))
        branches.append(Branch(outcome, first, len(plan.steps), comparison, values))
    join(plan, ways)
    plan.steps[decision.number] = replace(decision, branches=tuple(branches), missing=missing)


def expand_while(plan: Expander, step: WhileStep, path: Path, scope: Scope, run: Run) -> None:
    """Append every turn with the decision before it, and the decision behind the last one."""
    here, decisions, ways = (*path, "while"), [], []
    for turn in range(1, step.at_most + 1):
        decisions.append(_decision(plan, WHILE, step.while_.reading, here, scope))
        ways.append(Known.of(plan))
        run(step.do, (*path, "do"), scope.extended({TURN: turn}, {TURN: turn}))
        if turn == 1:
            _reads_again(plan, decisions[0], here)
    decisions.append(_decision(plan, WHILE, step.while_.reading, here, scope))
    ways.append(Known.of(plan))
    join(plan, ways)
    end, missing = len(plan.steps), {None: HOLD, GO_ON: DONE}.get(step.else_, step.else_ or HOLD)
    for decision in decisions:
        last = decision is decisions[-1]
        first, outcome = decision.number + 1, (step.else_ or FAIL) if last else TURN
        turn_on = Branch(outcome, first, end, *_compared(plan, decision, step.while_, here, scope))
        branches = (turn_on, Branch(DONE, end, end))
        plan.steps[decision.number] = replace(decision, branches=branches, missing=missing)


def _reads_again(plan: Expander, decision: PlannedDecision, path: Path) -> None:
    """Note a loop that could never end because nothing in it takes its reading (B-PLAN-110)."""
    body = (plan.steps[at] for at in range(decision.number + 1, len(plan.steps)))
    if not any(is_read_by(decision, step) for step in body):
        message = f"the loop goes by {decision.reading}, and nothing in it reads that again"
        plan.fail("B-PLAN-110", path, message, "read it in 'do', so that the condition can change")


def _decision(plan: Expander, word: str, reading: str | CallStep, path: Path, scope: Scope) -> PlannedDecision:
    """Append a decision whose branches are not known yet. Its reading must be taken before it (B-PLAN-110)."""
    role, name, given = "", reading, {}
    if isinstance(reading, CallStep):
        called, arguments = next(iter(reading.root.items()))
        role, name = called.split(".")
        at = (*path, called) if path[-1] == CHOOSE else (*path, "reading", called)
        given = {key: plain(plan.resolve(raw, scope, (*at, key))) for key, raw in (arguments or {}).items()}
    number = len(plan.steps)
    more = {"word": word, "arguments": given, "unit": "", "branches": (), "missing": HOLD, "retry_step": number}
    plan.add("decide", role, str(name), more, scope, path)
    decision = plan.steps[number]
    assert isinstance(decision, PlannedDecision)
    before = (plan.steps[at] for at in range(number - 1, -1, -1))
    taken = next((step for step in before if is_read_by(decision, step)), None)
    if taken is None:
        known = suggestion(decision.reading, {name for step in plan.steps[:number] for name in _readings(plan, step)})
        message = f"nothing before this step reads {decision.reading}{known}"
        plan.fail("B-PLAN-110", path, message, "put the reading before the decision")
        return decision
    same_phase = [taken.number] if taken.phase == plan.phase else []
    back = [number, *same_phase, *([] if plan.retry_step is None else [plan.retry_step])]
    unit = taken.unit if isinstance(taken, PlannedPrompt) else _unit(plan, role, str(name))
    return replace(decision, unit=unit, retry_step=min(back))


def _readings(plan: Expander, step: Any) -> Iterable[str]:
    if isinstance(step, PlannedPrompt) and step.quantity:
        yield step.quantity
    for call in (step, *reading_calls(step)):
        if isinstance(call, PlannedCall) and _unit(plan, call.role, call.name):
            yield f"{call.role}.{call.name}"


def _unit(plan: Expander, role: str, name: str) -> str:
    declared = declared_action(plan.station, role, name)
    return "" if declared is None else declared.returns


def _compared(
    plan: Expander, decision: PlannedDecision, comparison: Comparison, path: Path, scope: Scope
) -> tuple[str, tuple[float, ...]]:
    """Return the comparison and its values in the unit of the reading; what cannot be compared is noted (B-PLAN-111).

    Nothing is said of a reading that nothing takes.
    """
    word = comparison.word
    written = getattr(comparison, word)
    values = tuple(
        _value(plan, decision, raw, (*path, word, index) if word == "within" else (*path, word), scope)
        for index, raw in enumerate(written if word == "within" else [written])
    )
    if len(values) == 2 and values[0] > values[1]:
        message = f"no reading is within {written[0]} and {written[1]}: the first is above the second"
        plan.fail("B-PLAN-111", (*path, word), message, "exchange them")
    return word, values


def _value(plan: Expander, decision: PlannedDecision, raw: Any, path: Path, scope: Scope) -> float:
    value = plan.resolve(raw, scope, path)
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
    plan.fail("B-PLAN-111", path, message, f"write a quantity in {unit}" if unit != "1" else "write a number", origin)
    return math.nan
