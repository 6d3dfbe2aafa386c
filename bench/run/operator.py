"""Questions to the person at the bench, and their answers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from bench.model.errors import RunError
from bench.model.events import Prompt
from bench.model.units import plain_quantity, plain_unit
from bench.plan import PlannedPrompt, Step

BENCH, AFAR = "bench", "afar"
"""Places that an answer or a command comes from: who is at the bench sees what is switched on, all others do not."""


@dataclass(frozen=True)
class Question:
    """An operator prompt. ``low``/``high`` bound the value asked for; no ``unit`` means a plain confirmation.

    ``quantity``: what of the unit under test the value is. Such a value is taken as it is and judged by the analysis.
    ``presence``: where it may be answered, "bench" or "anywhere".
    ``arms``: the answer lets the bench be energised again after a hold. ``limit_s``: longest wait for the answer.
    """

    text: str
    confirm: str = "operator"
    unit: str = ""
    low: float | None = None
    high: float | None = None
    quantity: str = ""
    presence: str = BENCH
    arms: bool = False
    limit_s: float = math.inf

    @property
    def shown(self) -> dict[str, Any]:
        """Return what whoever answers is shown, by name."""
        return {name: getattr(self, name) for name in ("text", "confirm", "unit", "low", "high")}


@dataclass(frozen=True)
class Answer:
    """An answer, and by whom it was given ("simulation" when nobody was asked)."""

    by: str
    value: float | None = None


class Operator(Protocol):
    """Whoever answers prompts."""

    def ask(self, question: Question) -> Answer:
        """Block until answered; raise OperatorStop on refusal."""


class SimulatedOperator:
    """Confirms every prompt and answers with the (geometric) middle of the limits; on a simulated bench only."""

    def ask(self, question: Question) -> Answer:
        if not question.unit:
            return Answer("simulation")
        limits = [limit for limit in (question.low, question.high) if limit is not None]
        if not limits:
            return Answer("simulation")
        if min(limits) > 0:
            return Answer("simulation", math.prod(limits) ** (1 / len(limits)))
        return Answer("simulation", sum(limits) / len(limits))


def judge(question: Question, answer: Answer, where: str) -> None:
    """Raise RunError when a value is missing, or outside the limits of a prompt that asks for no measurement."""
    if not question.unit:
        return
    if answer.value is None:
        raise RunError("B-RUN-040", f"no value was given for '{question.text}'", where=where)
    if question.quantity:
        return
    if not within(question, answer.value):
        given = plain_quantity(answer.value, question.unit)
        raise RunError(
            "B-RUN-041",
            f"{given} is outside the limits ({limits_of(question)}) for '{question.text}'",
            where=where,
            next_step="correct the set-up, then start again",
        )


def within(question: Question, value: float | None) -> bool:
    """Return whether there is a value and it is inside the limits."""
    low = -math.inf if question.low is None else question.low
    high = math.inf if question.high is None else question.high
    return value is not None and low <= value <= high


def limits_of(question: Question) -> str:
    """Return what value is due, for a person, such as "at most 0.5 ohm"; "" for a plain confirmation."""
    low, high = (
        None if limit is None else plain_quantity(limit, question.unit) for limit in (question.low, question.high)
    )
    if high is None:
        return plain_unit(question.unit) if low is None or not question.unit else f"at least {low}"
    return f"at most {high}" if low is None else f"{low} to {high}"


def changes_of(steps: Iterable[Step]) -> dict[str, Any]:
    """Return what the prompts among some steps have changed on the bench, by name; of two changes the later counts."""
    changes: dict[str, Any] = {}
    for step in steps:
        if isinstance(step, PlannedPrompt):
            changes |= step.sets
    return changes


def answered(question: Question, answer: Answer, step: Step, changes: Mapping[str, Any]) -> Prompt:
    """Return the prompt of a step as an event; ``changes``: what the person did to the bench."""
    about: dict[str, Any] = {}
    if question.quantity:
        about = {"quantity": question.quantity, "conditions": dict(step.conditions)}
    return Prompt(step=step.number, by=answer.by, value=answer.value, sets=changes or None, **question.shown, **about)
