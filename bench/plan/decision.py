"""The step that decides: it compares what was read last and leaves out the branches that are not taken.

Loops and branches are unrolled, so the steps of every branch stand in the plan one behind another, and a decision is
nothing but the ranges of steps that are left out. Branches of one decision begin at the same planned time; what follows
them begins when the longest would end, so planned times are the latest ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from bench.model.events import Decision, Event, UnitLeftOut
from bench.model.ports import Drivers
from bench.model.quantities import Values
from bench.model.units import plain_quantity
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

    def written(self, drivers: Drivers) -> dict[str, Any]:
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
