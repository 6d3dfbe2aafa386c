"""One quantity over many units: its values, how they are distributed, and which is nearest to its limit."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

FAILED = ("fail", "conditional_fail")


class Unit(NamedTuple):
    """A unit under test."""

    model: str
    serial: str


class Member(NamedTuple):
    """One estimate of one unit; ``conditions`` without those that differ from unit to unit."""

    unit: Unit
    session: str
    value: float
    expanded: float
    limit: float | None
    verdict: str
    probability: float | None

    @property
    def failed(self) -> bool:
        """Refused, conditionally too."""
        return self.verdict in FAILED

    @property
    def nearness(self) -> tuple[float, float]:
        """Sorts members by how near to their limit they are, or how far beyond it: the worst first."""
        if self.limit is None:
            return (2.0, 0.0)
        beyond = math.inf if self.value else 0.0  # of a limit of nothing at all
        use = abs(self.value) / self.limit if self.limit else beyond
        return (1.0 if self.probability is None else self.probability, -use)


class Quantity(NamedTuple):
    """What is compared from unit to unit: a quantity of a campaign under its conditions (canonical JSON)."""

    campaign: str
    name: str
    unit: str
    conditions: str

    @property
    def where(self) -> dict[str, Any]:
        """The conditions."""
        found: dict[str, Any] = json.loads(self.conditions)
        return found


@dataclass(frozen=True)
class Spread:
    """How a quantity is distributed over its members; ``std`` is None for one of them, ``limit`` if they differ."""

    quantity: Quantity
    members: Sequence[Member]

    @property
    def mean(self) -> float:
        """Mean value."""
        return statistics.fmean(one.value for one in self.members)

    @property
    def std(self) -> float | None:
        """Standard deviation (n - 1)."""
        return statistics.stdev(one.value for one in self.members) if len(self.members) > 1 else None

    @property
    def least(self) -> Member:
        """The smallest value."""
        return min(self.members, key=lambda one: one.value)

    @property
    def greatest(self) -> Member:
        """The greatest value."""
        return max(self.members, key=lambda one: one.value)

    @property
    def worst(self) -> Member | None:
        """The value that most likely is outside its limit; None if nothing is judged."""
        judged = [one for one in self.members if one.limit is not None]
        return min(judged, key=lambda one: one.nearness) if judged else None

    @property
    def limit(self) -> float | None:
        """The limit, if all have the same."""
        found = {one.limit for one in self.members}
        return found.pop() if len(found) == 1 else None

    @property
    def failed(self) -> int:
        """How many failed."""
        return sum(one.failed for one in self.members)
