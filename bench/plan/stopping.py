"""Points that may end early: by declared noise, which fixes their length at once, or by the scatter of a first stage.

A first stage is several records without a gap and a decision behind them; its branches are one further record each, of
several lengths. So whatever holds for decisions holds here: position, proof, resumption, and the longest branch counts.
Decision: docs/decisions/0047-stop-rules.md.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from bench.maths.stein import LEAST_FIRST
from bench.model.errors import FitError
from bench.model.installed import named
from bench.model.quantities import Values
from bench.model.stopping import FIRST, SECOND, STAGE, STAGE_INDEX, UNTIL, Point
from bench.model.systems import declared_by
from bench.model.units import format_quantity, hours
from bench.plan.deciding import Known, join
from bench.plan.decision import Branch, PlannedDecision, decisions_of
from bench.plan.expand import Expander, Node
from bench.plan.language.steps import Record, Until
from bench.plan.plan import Plan, Step
from bench.plan.step_kinds import MEASUREMENT, PlannedRecord
from bench.plan.values import Quantity

NEEDED = "records"  # what the decision goes by: how many more, each as long as one of the first stage
_SCATTER = "scatter"
_ALONE = ("windows", "follows", "readings", "every", "expect", "pulse_timing", "samples")  # not beside 'until'
_LENGTHS = sorted({*(2**power for power in range(10)), *(3 * 2**power for power in range(9))})

Take = Callable[[Quantity, Values, Values], None]  # length, more arguments, more conditions


def expand_until(node: Node, record: Record, seconds: Quantity, conditions: Values, take: Take) -> None:
    """Append the records of a point that may end early; one that may not lasts as long as it could.

    Args:      seconds: length of one record.   take: appends a record.
    Findings:  B-PLAN-160 (no rule for such a record), B-PLAN-161 (a target that no length reaches).
    """
    until, here, plan = record.until, node.below(UNTIL), node.plan
    assert until is not None
    longest = _times(seconds, until.most)
    asked = declared_by(plan.campaign)
    if refusal := _refusal(plan, record, until, "" if asked is None else asked.point):
        here.fail("B-PLAN-160", *refusal)
        return take(longest, {}, {})
    point: Point = named(asked.point)  # type: ignore[union-attr]
    if not point.may_end(conditions):
        return take(longest, {}, {})
    try:
        rule = _rule(here, point, until, seconds.value, conditions)
    except FitError as error:
        here.fail("B-PLAN-160", error.message, "state the unit's constants and the conditions of the record")
        rule = None
    if rule is None:
        return take(longest, {}, {})
    if until.by == _SCATTER:
        return _stages(node, rule, seconds, take)
    return take(_times(seconds, rule.least), {"longest": longest.value}, {})


@dataclass(frozen=True)
class _Rule:
    """When a point ends: not before ``least`` records, of which the ``first`` are the first stage, nor after ``most``.

    ``target``: standard uncertainty of the mean, in the unit of the point.
    """

    target: float
    first: int
    least: int
    most: int


def _refusal(plan: Expander, record: Record, until: Until, point: str) -> tuple[str, str] | None:
    """Return why there is no such rule for a record, and what to do; None if there may be one."""
    beside = [word for word in _ALONE if getattr(record, word) not in (None, False, [])]
    least = _first_of(until)
    if not point:
        return "the analysis does not know how well the mean of a point is known", "take 'until' out"
    if beside or record.purpose != MEASUREMENT:
        what = f"'{beside[0]}'" if beside else f"the purpose {record.purpose}"
        return f"a record with {what} cannot end early", "take one of the two out"
    if until.by == _SCATTER and plan.units:
        return "several units are measured, and each has a scatter of its own", "write 'by: noise'"
    if until.by == _SCATTER and not LEAST_FIRST <= least < until.most:
        message = f"by scatter a first stage has {LEAST_FIRST} records or more, and fewer than 'most': {least}"
        return message, f"write 'least: {LEAST_FIRST}' or more, and a greater 'most'"
    if least > until.most:
        return f"at least {least} records and at most {until.most}", "exchange them"
    return None


def _first_of(until: Until) -> int:
    return until.least or (LEAST_FIRST if until.by == _SCATTER else 1)


def _rule(node: Node, point: Point, until: Until, seconds: float, conditions: Values) -> _Rule | None:
    """Return the rule of a point, None after noting a mistake. Raises: FitError of the point."""
    here, campaign = node.below("random"), node.plan.campaign
    given = here.resolve(until.random)
    if given is None:
        return None
    if not isinstance(given, Quantity) or given.dimension not in ("1", point.UNIT) or given.value <= 0:
        message = f"{until.random} is no ratio and no quantity in {point.UNIT} above zero"
        here.fail("B-PLAN-031", message, "write for example '2 ppm'")
        return None
    level = point.level(conditions)
    target = given.value * (level if given.dimension == "1" else 1.0)
    first, of_scatter = _first_of(until), until.by == _SCATTER

    def known(records: int) -> float:
        """Return what is known of the standard uncertainty after so many records: of scatter only that of quanta."""
        cuts = 1 + (of_scatter and records > first)
        quantised, declared = point.random(campaign, conditions, records * seconds, cuts)
        return quantised if of_scatter else declared

    least = first
    if known(first) > target:
        more = range(first + 1, until.most + 1)
        least += 1 + bisect_left(more, True, key=lambda records: known(records) <= target)
    if least <= until.most:
        return _Rule(target, first, least, until.most)
    bound, what = known(until.most), "declared noise and quantisation leave"
    what = "quantisation alone leaves" if of_scatter else what
    message = (
        f"a mean with a random component of {format_quantity(target, point.UNIT, 3)} is asked for; after "
        f"{until.most * seconds:g} s {what} {format_quantity(bound, point.UNIT, 3)} ({1e6 * bound / level:.3g} ppm)"
    )
    here.fail("B-PLAN-161", message, "ask for no less than that, or allow more records")
    return None


def _stages(node: Node, rule: _Rule, seconds: Quantity, take: Take) -> None:
    """Append the records of the first stage, the decision, and a branch for each length of a second one."""
    plan = node.plan
    begin = len(plan.steps)
    for index in range(rule.first):
        take(seconds, {"follows": True} if index else {}, {STAGE: FIRST, STAGE_INDEX: index})
    number, most = len(plan.steps), rule.most - rule.first
    lengths = [*(length for length in _LENGTHS if length < most), most]  # few, so that a plan stays short
    asked = {"first": list(range(begin, number)), "target": rule.target, "least": rule.least}
    retry_step = begin if plan.retry_step is None else plan.retry_step
    more = {"word": UNTIL, "arguments": asked, "unit": "1", "branches": (), "missing": _outcome(lengths[-1])}
    plan.add(node, "decide", "", NEEDED, {**more, "retry_step": retry_step})
    before, branches = Known.of(plan), [Branch(_outcome(0), number + 1, number + 1, "within", (0.0, 0.0))]
    ways = [before]
    for length in lengths:
        before.again(plan)
        first = len(plan.steps)
        take(_times(seconds, length), {}, {STAGE: SECOND, STAGE_INDEX: 0})
        ways.append(Known.of(plan))
        branches.append(Branch(_outcome(length), first, len(plan.steps), "within", (0.0, float(length))))
    join(plan, ways)
    branches[-1] = replace(branches[-1], comparison="", values=())  # more than that are not taken
    decision = plan.steps[number]
    assert isinstance(decision, PlannedDecision)
    plan.steps[number] = replace(decision, branches=tuple(branches))


def _times(seconds: Quantity, records: int) -> Quantity:
    return replace(seconds, value=round(records * seconds.value, 9))


def _outcome(records: int) -> str:
    return f"{records} more"


def is_other_length(step: Step, before: Step | None) -> bool:
    """Return whether a step is a second stage of another length than the step ``before`` it: one of both is taken."""
    return all(other is not None and other.conditions.get(STAGE) == SECOND for other in (step, before))


def stop_lines(plan: Plan) -> Iterator[str]:
    """Yield what stop rules make of a plan, a sentence for each kind of rule."""
    fixed = [step for step in plan.steps if isinstance(step, PlannedRecord) and step.longest_s]
    if fixed:
        shortest, longest = (end(step.seconds for step in fixed) for end in (min, max))
        saved_s = sum(step.longest_s - step.seconds for step in fixed)
        yield (
            f"{len(fixed)} points last {shortest:g} s to {longest:g} s by declared noise, {hours(saved_s)} less than "
            "at most; their lengths are fixed by now"
        )
    deciding = [decision for decision in decisions_of(plan.steps) if decision.word == UNTIL]
    if deciding:
        count = len(deciding)
        yield f"{count} points end by the scatter of their first stage; times and records are those of the longest"
