"""Walks a plan on every way that its decisions allow, with the states that the bench may be in.

A decision doubles the ways; two of them become one again where nothing differs any more, neither the state nor the
steps still to be left out. So a loop of a hundred turns is walked with two or three states, and what follows a branch
is met by every state that the branches may leave. A plan without decisions has one way.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Generic, Self, TypeVar

from bench.plan.decision import PlannedDecision, decisions_of
from bench.plan.findings import Findings
from bench.plan.plan import Step

MOST_WAYS = 64


class Followed:
    """What is followed on a way."""

    def copy(self) -> Self:
        """Return one that goes on by itself: what can be changed in place is copied by the class that has it."""
        return copy(self)

    def key(self) -> Hashable:
        """Return what tells it from others; it is equal for two that need not be told apart."""
        raise NotImplementedError

    def join(self, other: Self) -> None:
        """Take over what another one of the same key has, if anything differs."""


S = TypeVar("S", bound=Followed)


@dataclass
class _Way(Generic[S]):
    """A state, the steps ahead that it leaves out, and what was decided on the way, by place of the decision."""

    state: S
    left_out: tuple[range, ...] = ()
    decided: Mapping[str, str] = field(default_factory=dict)

    def passes(self, number: int) -> bool:
        return any(number in stretch for stretch in self.left_out)

    def ahead(self, number: int) -> tuple[range, ...]:
        return tuple(range(max(s.start, number), s.stop) for s in self.left_out if s.stop > number)

    def taken(self, decision: PlannedDecision, outcome: str) -> _Way[S]:
        left_out = (*self.ahead(decision.number + 1), *decision.left_out(outcome))
        return _Way(self.state.copy(), left_out, {**self.decided, _place(decision): outcome})


def _place(decision: PlannedDecision) -> str:
    return f"'{decision.word}' in line {decision.where.split(':')[-2]}"


def walk(steps: Iterable[Step], state: S, take: Callable[[S, Step], None], findings: Findings) -> list[S]:
    """Take every step on every way, and return the states at the end.

    Args: take: applies one step to a state; what it notes in ``findings`` gets the decisions that led there.
    Findings: B-PLAN-112 if more than ``MOST_WAYS`` states are possible at a step.
    """
    steps = tuple(steps)
    joins = {branch.stop for decision in decisions_of(steps) for branch in decision.branches}
    ways = [_Way(state)]
    for step in steps:
        if step.number in joins:
            ways = _merged(ways, step.number)
        for way in ways:
            if not way.passes(step.number):
                findings.way = ", ".join(f"{place} takes '{outcome}'" for place, outcome in way.decided.items())
                take(way.state, step)
        if isinstance(step, PlannedDecision):
            ways = _merged([next_way for way in ways for next_way in _after(way, step)], step.number + 1)
        if len(ways) > MOST_WAYS:
            findings.way = ""
            message = f"more than {MOST_WAYS} states of the bench are possible behind this decision"
            advice = "let the branches leave the bench in the same state, for example by the same calls at their end"
            findings.add("B-PLAN-112", step.where, message, advice)
            break
    findings.way = ""
    return [way.state for way in ways]


def _after(way: _Way[S], decision: PlannedDecision) -> list[_Way[S]]:
    if way.passes(decision.number):
        return [way]
    return [way.taken(decision, outcome) for outcome in decision.outcomes()]


def _merged(ways: list[_Way[S]], number: int) -> list[_Way[S]]:
    """Return the ways that differ, from a step on; of two that are one now only what both decided alike led there."""
    if len(ways) == 1:
        return ways
    merged: dict[Any, _Way[S]] = {}
    for way in ways:
        key = way.ahead(number), way.state.key()
        same = merged.get(key)
        if same is None:
            merged[key] = way
        else:
            same.state.join(way.state)
            same.decided = {place: said for place, said in same.decided.items() if way.decided.get(place) == said}
    return list(merged.values())
