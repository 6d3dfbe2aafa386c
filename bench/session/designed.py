"""A shorter plan of a campaign beside the given one: hours, uncertainties, what each change buys, what is seen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.design import (
    LEAST_POWER,
    Design,
    Given,
    Key,
    Problem,
    Target,
    best_within,
    default_targets,
    designed,
    reached,
    read_target,
    refuse_below_floor,
)
from bench.model.errors import InputError
from bench.model.installed import named
from bench.model.systems import analysis_declaration
from bench.model.texts import quantity_title
from bench.plan import Plan, PlannedSoak, decisions_of
from bench.session.predicted import predicted

_HOUR_s = 3600.0
_ALIKE = 1e-3  # uncertainties: one channel stands for all that are alike, at the time of its own records
Curve = list[tuple[float, float]]


@dataclass(frozen=True)
class Asked:
    """What ``bench plan`` is asked for; ``targets`` as words, ``within_s`` for the best plan in a time."""

    targets: Sequence[str]
    within_s: float | None
    lag_s: float | None


@dataclass(frozen=True)
class Proposal:
    """A plan that was found. ``known``, ``found``: U by quantity, part and kind, today and proposed."""

    plan: Plan
    problem: Problem[Any]
    targets: Sequence[Target]
    design: Design[Any]
    known: Mapping[Key, float]
    found: Mapping[Key, float]

    @property
    def way(self) -> tuple[Any, float]:
        """Return what was chosen and the length of its records, second, as ``problem.today`` is of the given plan."""
        return self.design.candidate, self.design.length_s

    @property
    def today_s(self) -> float:
        """Hours of the given campaign, in second."""
        return self.plan.duration_s

    def text(self, name: str) -> str:
        """Return the proposal as a sequence of this name; why it is as it is stands in its comments."""
        heading = [
            f"Made by 'bench plan' from {self.plan.name}: {_h(self.design.duration_s)} h, not {_h(self.today_s)} h.",
            "Targets, as expanded uncertainty (95 %):",
            *(f"  {line}" for line in self.target_lines()),
            "What each change buys:",
            *(f"  {line}" for line in self.change_lines()),
            "Comments below are those of the given sequence, but for those on levels, records, repeats and slots.",
        ]
        return self.problem.written(*self.way, name, heading)

    def require_same(self, written: Plan) -> None:
        """Refuse a compiled sequence of another duration or other uncertainties than were found.

        Raises: InputError B-DES-007.
        """
        known = reached(predicted(written).estimates)
        stated = [
            ("duration, s", self.design.duration_s, written.duration_s, 1e-9),
            *((each.key.name, each.reached(self.found), each.reached(known), _ALIKE) for each in self.targets),
        ]
        for name, due, there, within in stated:
            if not math.isclose(due, there, rel_tol=within):
                raise InputError(
                    "B-DES-007",
                    f"{name}: {there:.6g} by the sequence as written, {due:.6g} by the plan that was found",
                    where=self.plan.name,
                    next_step="write the given sequence as the shipped one of its kind is written",
                )

    def target_lines(self) -> Iterator[str]:
        """Yield a line for each target: asked, times the factor that a time leaves, reached, today."""
        for target in self.targets:
            times = "" if self.design.factor == 1.0 else f" times {self.design.factor:.2f}"
            now, before = _two(target.reached(self.found)), _two(target.reached(self.known))
            yield f"{target.key.name}: {_two(target.U)} asked{times}, {now} by this plan, {before} by the given one"

    def change_lines(self) -> Iterator[str]:
        """Yield a line for each change on the way from the given campaign: hours before and after it."""
        before_s = self.today_s
        for name, after_s in self.changes():
            yield f"{name}: {_h(before_s)} -> {_h(after_s)} h ({_h(after_s - before_s, '+')} h)"
            before_s = after_s

    def changes(self) -> Iterator[tuple[str, float]]:
        """Yield name of each change and the duration after it, second."""
        for name, candidate, length_s in self.problem.changes(*self.way):
            yield name, self.problem.duration_s(candidate, length_s)

    def evidence(self) -> Iterator[tuple[str, str, float | None, float | None]]:
        """Yield rival, quantity and the chance that it is seen at 1 U, today and proposed, where one of them alone is
        beyond 0.9; None where a campaign has no such rival.
        """
        before, after = (
            {(power.rival, power.quantity): power.power for power in self.problem.powers(candidate, length_s)}
            for candidate, length_s in (self.problem.today, self.way)
        )
        for place in dict.fromkeys((*before, *after)):
            powers = before.get(place), after.get(place)
            if len({(power or 0.0) < LEAST_POWER for power in powers}) == 2:
                yield *place, *powers

    def lines(self) -> Iterator[str]:
        """Yield the table for people."""
        yield f"hours        {_h(self.today_s)} today, {_h(self.design.duration_s)} as proposed"
        today = self.problem.told(*self.problem.today)
        for name, value in self.problem.told(*self.way).items():
            yield f"{name:<12} {today[name]}"
            yield f"{'':<12} -> {value}"
        yield from (f"target       {line}" for line in self.target_lines())
        yield from (f"buys         {line}" for line in self.change_lines())
        for rival, quantity, before, after in self.evidence():
            title = quantity_title(str(self.plan.campaign["analysis"]), quantity)
            chances = f"{_chance(before)} today, {_chance(after)} as proposed"
            yield f"evidence     {rival}, seen if it costs 1 U of {title}: {chances}"

    def document(self) -> dict[str, Any]:
        """Return the table for JSON; durations in second."""
        names = "rival", "quantity", "today", "proposed"
        return {
            "sequence": self.plan.name,
            "today_s": self.today_s,
            "proposed_s": self.design.duration_s,
            "campaign": {
                "today": self.problem.told(*self.problem.today),
                "proposed": self.problem.told(*self.way),
            },
            "factor": self.design.factor,
            "targets": [
                {
                    **target.key._asdict(),
                    "U": target.U,
                    "today": target.reached(self.known),
                    "proposed": target.reached(self.found),
                }
                for target in self.targets
            ],
            "changes": [{"change": name, "duration_s": after_s} for name, after_s in self.changes()],
            "evidence": [dict(zip(names, entry, strict=True)) for entry in self.evidence()],
        }


def proposed(plan: Plan, asked: Asked) -> Proposal:
    """Return the shortest plan for the targets, or the best one in a time.

    Raises: InputError B-DES-001 to B-DES-006.
    """
    problem = problem_of(plan, asked.lag_s)
    estimates = problem.estimates(*problem.today)
    known = reached(estimates)
    targets = [read_target(words, estimates) for words in asked.targets] or default_targets(problem.wanted, known)
    refuse_below_floor(targets, estimates)
    within_s = asked.within_s
    design = designed(problem, targets) if within_s is None else best_within(problem, targets, within_s)
    if design is None:
        when = "" if asked.within_s is None else f" within {_h(asked.within_s)} h"
        raise InputError(
            "B-DES-006",
            f"no plan in place of {plan.name} reaches the targets under the rules{when}",
            where="--target" if asked.within_s is None else "--within",
            next_step=_room(plan, asked),
        )
    return Proposal(
        plan, problem, targets, design, known, reached(problem.estimates(design.candidate, design.length_s))
    )


def _room(plan: Plan, asked: Asked) -> str:
    """Return what would leave the search more room; only soaks of a campaign become shorter by a stated lag."""
    soaks = any(isinstance(step, PlannedSoak) for step in plan.phase("campaign"))
    hours = [] if asked.within_s is None else ["allow more hours"]
    lag = ["state --lag"] if soaks and asked.lag_s is None else []
    return ", ".join([*hours, "ask for more uncertainty", *lag]) + ", or give the sequence more to choose from"


def problem_of(plan: Plan, lag_s: float | None) -> Problem[Any]:
    """Return what is free in a campaign, by its analysis. Raises: InputError B-DES-003 if it does not say."""
    analysis = str(plan.campaign.get("analysis"))
    declared = analysis_declaration(analysis)
    if declared is None or not declared.design or plan.units or decisions_of(plan.steps):
        why = "several units, or decisions" if declared is not None and declared.design else f"the analysis {analysis}"
        message = f"{plan.name} cannot be planned for targets: not for {why}"
        raise InputError("B-DES-003", message, where=plan.name, next_step="'bench check' says what it will give")
    problem: Problem[Any] = named(declared.design)(Given(plan, plan.texts[f"sequences/{plan.name}.yaml"], lag_s))
    return problem


def curve(proposal: Proposal, factors: Sequence[float]) -> Curve:
    """Return hours of the shortest plan for each factor on the targets, where there is one."""
    designs = [designed(proposal.problem, proposal.targets, factor) for factor in factors]
    return [(design.factor, design.duration_s / _HOUR_s) for design in designs if design is not None]


def _h(seconds: float, sign: str = "-") -> str:
    """Return hours; of a campaign of some minutes a tenth of an hour would say nothing."""
    return f"{seconds / _HOUR_s:{sign}.2f}"


def _two(value: float) -> str:
    return f"{value:.2g}"


def _chance(power: float | None) -> str:
    return "no such rival" if power is None else f"{power:.2f}"
