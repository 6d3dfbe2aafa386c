"""Acceptances: who released the value of a doubtful estimate, and why; for that value and those doubts alone.

An acceptance never gives an uncertainty or a verdict back, and holds no longer once the value or the reasons of the
doubt are others than those that were looked at.

Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from bench.analysis.doubt import DOUBTFUL, REFUSED, base_quantity
from bench.analysis.estimates import Acceptance, Estimate, Estimates
from bench.analysis.form import Closed
from bench.model.errors import InputError

_SAME_VALUE = 1e-9  # relative; another machine may round the last digits otherwise
_Said = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]


class Accepted(Closed):
    """One estimate that was accepted: which it is, the value and the doubts that were looked at, and who said what."""

    quantity: str
    conditions: dict[str, str | bool | int | float | None]
    method: str
    value: float
    reasons: Annotated[list[str], Field(min_length=1, description="codes of the doubts that were known")]
    by: _Said
    reason: _Said
    utc: str

    def is_for(self, entry: Estimate, method: str) -> bool:
        """Return whether an estimate by a method is the one that was accepted."""
        named = self.quantity == entry.quantity and self.method == method
        conditions = entry.conditions
        same = self.conditions.keys() == conditions.keys()
        return named and same and all(_alike(value, conditions[name]) for name, value in self.conditions.items())

    def holds_for(self, entry: Estimate) -> bool:
        """Return whether the estimate still is what was accepted: doubtful, the same value, no other doubt."""
        return (
            entry.quality == DOUBTFUL
            and _alike(self.value, entry.value)
            and {reason.code for reason in entry.reasons} <= set(self.reasons)
        )


class Acceptances(Closed):
    """The document acceptances.json beside a recording."""

    schema_version: Literal[1] = Field(1, alias="schema")
    session_sha256: str
    acceptances: list[Accepted]


def _alike(first: object, second: object) -> bool:
    numbers = isinstance(first, float | int) and isinstance(second, float | int)
    return math.isclose(first, second, rel_tol=_SAME_VALUE) if numbers else first == second  # type: ignore[arg-type]


def with_acceptances(entries: Estimates, accepted: Sequence[Accepted], method: str) -> tuple[Estimates, list[str]]:
    """Return estimates, marked where an acceptance holds, and sentences about those that do not."""
    marked: Estimates = []
    held: set[int] = set()
    for entry in entries:
        for number, acceptance in enumerate(accepted):
            if acceptance.is_for(entry, method) and acceptance.holds_for(entry):
                released = Acceptance.model_construct(by=acceptance.by, reason=acceptance.reason)
                entry = entry.model_copy(update={"acceptance": released})
                held.add(number)
        marked.append(entry)
    lost = [
        f"The acceptance of {acceptance.quantity} by {acceptance.by} holds no longer: its value or doubts are others."
        for number, acceptance in enumerate(accepted)
        if acceptance.method == method and number not in held
    ]
    return marked, list(dict.fromkeys(lost))


def acceptable(entries: Estimates, named: str) -> Estimates:
    """Return the doubtful estimates that a person names: "dsf_n", or "dsf_n channel=2" for those of one condition.

    A temperature coefficient, residual or change belongs to its quantity.
    Raises: InputError B-ACC-001 if none is doubtful, B-ACC-002 if one is refused.
    """
    quantity, *narrowed = named.replace(",", " ").split() or [""]
    wanted = [part.partition("=") for part in narrowed]
    of_it = [
        entry
        for entry in entries
        if quantity in (entry.quantity, base_quantity(entry.quantity))
        and all(_condition_is(entry.conditions.get(name), value) for name, _, value in wanted)
    ]
    refused = next((entry for entry in of_it if entry.quality == REFUSED), None)
    if refused is not None:
        raise InputError(
            "B-ACC-002",
            f"{refused.quantity} is refused and has no value to accept: {refused.reasons[0].sentence}",
            where=_place(refused),
            next_step="measure again; what is only doubtful is accepted by its conditions, such as 'dsf_n channel=2'",
        )
    doubtful = [entry for entry in of_it if entry.quality == DOUBTFUL]
    if not doubtful:
        others = sorted({base_quantity(entry.quantity) for entry in entries if entry.quality == DOUBTFUL})
        state = "is sound, there is nothing to accept" if of_it else "is no estimate of this session"
        next_step = f"doubtful here: {', '.join(others)}" if others else "no estimate of this session is doubtful"
        raise InputError("B-ACC-001", f"{named!r} {state}", next_step=next_step)
    return doubtful


def _condition_is(condition: object, text: str) -> bool:
    if isinstance(condition, float):
        try:
            return math.isclose(condition, float(text), rel_tol=_SAME_VALUE)
        except ValueError:
            return False
    return str(condition) == text


def _place(entry: Estimate) -> str:
    return ", ".join(f"{name} {value}" for name, value in entry.conditions.items())
