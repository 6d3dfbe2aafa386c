"""The step that decides: it compares what was read last and leaves out the branches that are not taken.

Loops and branches are unrolled, so the steps of every branch stand in the plan one behind another, and a decision is
nothing but the ranges of steps that are left out. Branches of one decision begin at the same planned time; what follows
them begins when the longest would end, so planned times are the latest ones.

A plan is walked on every way that its decisions allow. A decision doubles the ways; two of them become one again where
nothing differs any more, neither the state nor the steps still to be left out. So a loop of a hundred turns is walked
with two or three states, and what follows a branch is met by every state that the branches may leave.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, Self

from bench.model.events import Decision, Event, UnitLeftOut
from bench.model.ports import Drivers
from bench.model.quantities import Values
from bench.model.units import plain_quantity
from bench.plan.findings import Findings
from bench.plan.plan import Step, Steps, an_event, cannot_be_taken_again, no_effect, not_again
from bench.plan.values import UNIT

IF, WHILE, CHOOSE = "if", "while", "choose"
HOLD, FAIL, GO_ON = "hold", "fail", "go_on"
DONE = "done"  # outcome of a loop that ends because its condition holds no more
_ALIKE = 1e-9  # of two numbers that went through different roundings


@dataclass(frozen=True, slots=True)
class Branch:
    """Steps ``first`` up to ``stop``, done if the reading compares with ``values`` so.

    The last branch has no comparison: it is taken if no other one fits. ``outcome`` is its name; with "hold" and "fail"
    no step is done, the run stands still or ends.
    """

    outcome: str
    first: int
    stop: int
    comparison: str = ""
    values: tuple[float, ...] = ()

    def fits(self, value: float) -> bool:
        """Return whether a reading compares so."""
        match self.comparison:
            case "above":
                return value > self.values[0]
            case "below":
                return value < self.values[0]
            case "within":
                return self.values[0] <= value <= self.values[1]
            case "equals":
                return math.isclose(value, self.values[0], rel_tol=_ALIKE)
        return True


@dataclass(frozen=True, slots=True)
class PlannedDecision(Step):
    """Decide by a reading of the action ``role.name`` with these ``arguments``, or without a role by the quantity
    ``name`` of a prompt.

    ``word``: if, while or choose; ``unit``: of the reading, in which the values of the ``branches`` are; ``missing``:
    outcome if there is no reading. A run that holds for one goes on from step ``retry_step``, which leads to the
    reading.
    """

    kind: ClassVar[str] = "decide"
    on_the_bus: ClassVar[bool] = False
    proof: ClassVar[type[Event] | None] = Decision

    word: str
    arguments: Values
    unit: str
    branches: tuple[Branch, ...]
    missing: str
    retry_step: int

    effects = no_effect  # it reads an instrument
    again = not_again  # it stands as it was made
    leaves = an_event

    def written(self, drivers: Drivers) -> Values:
        """Refuse: what is behind it depends on what was read before."""
        why = "the sequence decides by what it reads, so its records cannot be taken again one by one"
        raise cannot_be_taken_again(self, why, "run")

    @classmethod
    def taken(cls, arguments: Values) -> Values:
        """Return the arguments of a plan file as the step holds them."""
        branches = tuple(Branch(**{**branch, "values": tuple(branch["values"])}) for branch in arguments["branches"])
        return {**arguments, "branches": branches}

    def told(self) -> dict[str, Any]:
        """Return the arguments as they stand in a plan file."""
        branches = [{**asdict(branch), "values": list(branch.values)} for branch in self.branches]
        return {**Step.told(self), "arguments": dict(self.arguments), "branches": branches}

    @property
    def reading(self) -> str:
        """Return what it decides by, in words."""
        given = ", ".join(f"{name} {value}" for name, value in self.arguments.items())
        called = f"{self.role}.{self.name}" if self.role else self.name
        return f"{called} ({given})" if given else called

    def still(self, value: float) -> dict[str, str]:
        """Return the words of a loop that has had its last turn: what was read, and how it still compares with what."""
        newest, *values = (_shown(number, self.unit) for number in (value, *self.branches[0].values))
        comparison = self.branches[0].comparison
        return {"reading": self.reading, "newest": newest, "comparison": comparison, "limits": " and ".join(values)}

    def outcome(self, value: float | None) -> str:
        """Return what is done with a reading, None for a missing one."""
        return self.missing if value is None else next(b.outcome for b in self.branches if b.fits(value))

    def outcomes(self) -> tuple[str, ...]:
        """Return every outcome with which the run goes on, in order."""
        named = dict.fromkeys([*(branch.outcome for branch in self.branches), self.missing])
        return tuple(outcome for outcome in named if outcome not in (HOLD, FAIL))

    def left_out(self, outcome: str) -> tuple[range, ...]:
        """Return the steps that are left out with an outcome."""
        others = (branch for branch in self.branches if branch.outcome != outcome and branch.first < branch.stop)
        return tuple(range(branch.first, branch.stop) for branch in others)


def _shown(value: float, unit: str) -> str:
    return f"{value:g}" if unit == "1" else plain_quantity(value, unit)


def decisions_of(steps: Iterable[Step]) -> list[PlannedDecision]:
    """Return the decisions among some steps."""
    return [step for step in steps if isinstance(step, PlannedDecision)]


def _made(steps: Steps, events: Iterable[Event]) -> Iterator[tuple[PlannedDecision, Decision]]:
    """Yield the decisions among the events of a session, each with its step."""
    for event in events:
        step = steps[event.step] if isinstance(event, Decision) and 0 <= event.step < len(steps) else None
        if isinstance(event, Decision) and isinstance(step, PlannedDecision):
            yield step, event


def ways_not_taken(steps: Steps, events: Iterable[Event]) -> set[int]:
    """Return the numbers of the steps that the decisions among the events have left out, whatever else was skipped."""
    return {n for step, event in _made(steps, events) for stretch in step.left_out(event.outcome) for n in stretch}


def unmet_loops(steps: Steps, events: Iterable[Event]) -> list[tuple[PlannedDecision, float | None]]:
    """Return the ends of loops that went on without what they wait for, each with its last reading, None if missing."""
    unmet: dict[int, tuple[PlannedDecision, float | None]] = {}
    for step, event in _made(steps, events):
        value = event.readings[0].get("value") if event.readings else None
        if step.word == WHILE and (event.outcome == GO_ON or (event.outcome == DONE and value is None)):
            unmet[step.number] = step, value
    return list(unmet.values())


def left_out_by(steps: Steps, events: Iterable[Event]) -> list[range]:
    """Return the steps that the decisions among the events of a session leave out; ``steps``: those of its plan.

    Of a unit that was left out these are all of its steps: those that were done are not done again either.
    """
    stretches: list[range] = []
    for event in events:
        if isinstance(event, UnitLeftOut):
            own = [step.number for step in steps if step.conditions.get(UNIT) == event.uut]
            stretches += [range(number, number + 1) for number in own]
        for step, decision in _made(steps, [event]):
            stretches += step.left_out(decision.outcome)
    return stretches


MOST_WAYS = 64


class Followed:
    """What is followed on a way."""

    def take(self, step: Step) -> None:
        """Apply one step; what it notes among the findings of the walk gets the decisions that led there."""
        raise NotImplementedError

    def meet(self) -> None:
        """Note that the branches of a decision end here."""

    def copy(self) -> Self:
        """Return one that goes on by itself: what can be changed in place is copied by the class that has it."""
        return copy(self)

    def key(self) -> Hashable:
        """Return what tells it from others; it is equal for two that need not be told apart."""
        raise NotImplementedError

    def join(self, other: Self) -> None:
        """Take over what another one of the same key has, if anything differs."""


@dataclass
class _Way:
    """A state, the steps ahead that it leaves out, and what was decided on the way, by place of the decision."""

    state: Followed
    left_out: tuple[range, ...] = ()
    decided: Mapping[str, str] = field(default_factory=dict)

    def passes(self, number: int) -> bool:
        return any(number in stretch for stretch in self.left_out)

    def ahead(self, number: int) -> tuple[range, ...]:
        return tuple(range(max(s.start, number), s.stop) for s in self.left_out if s.stop > number)

    def taken(self, decision: PlannedDecision, outcome: str) -> _Way:
        left_out = (*self.ahead(decision.number + 1), *decision.left_out(outcome))
        return _Way(self.state.copy(), left_out, {**self.decided, _place(decision): outcome})


def _place(decision: PlannedDecision) -> str:
    return f"'{decision.word}' in line {decision.where.split(':')[-2]}"


def walk(steps: Iterable[Step], findings: Findings, *states: Followed) -> list[list[Followed]]:
    """Take every step on every way; each of ``states`` is followed by itself. Returns those at the end, of each.

    Findings: B-PLAN-112 if more than ``MOST_WAYS`` states are possible at a step; that one is followed no further.
    """
    steps = tuple(steps)
    joins = {branch.stop for decision in decisions_of(steps) for branch in decision.branches}
    followed = [[_Way(state)] for state in states]
    for step in steps:
        for at, ways in enumerate(followed):
            if len(ways) > MOST_WAYS:
                continue
            joined = _merged(ways, step.number) if step.number in joins else ways
            for way in joined:
                if way.left_out and way.passes(step.number):
                    continue
                findings.way = way.decided
                if step.number in joins:
                    way.state.meet()
                way.state.take(step)
            findings.way = {}
            followed[at] = _behind(joined, step, findings) if isinstance(step, PlannedDecision) else joined
    return [[way.state for way in ways] for ways in followed]


def _behind(ways: list[_Way], decision: PlannedDecision, findings: Findings) -> list[_Way]:
    """Return the ways behind a decision."""
    ways = _merged([next_way for way in ways for next_way in _after(way, decision)], decision.number + 1)
    if len(ways) > MOST_WAYS:
        message = f"more than {MOST_WAYS} states of the bench are possible behind this decision"
        advice = "let the branches leave the bench in the same state, for example by the same calls at their end"
        findings.add("B-PLAN-112", decision.where, message, advice)
    return ways


def _after(way: _Way, decision: PlannedDecision) -> list[_Way]:
    if way.passes(decision.number):
        return [way]
    return [way.taken(decision, outcome) for outcome in decision.outcomes()]


def _merged(ways: list[_Way], number: int) -> list[_Way]:
    """Return the ways that differ, from a step on; of two that are one now only what both decided alike led there."""
    if len(ways) == 1:
        return ways
    merged: dict[Any, _Way] = {}
    for way in ways:
        key = way.ahead(number), way.state.key()
        same = merged.get(key)
        if same is None:
            merged[key] = way
        else:
            same.state.join(way.state)
            same.decided = {place: said for place, said in same.decided.items() if way.decided.get(place) == said}
    return list(merged.values())
