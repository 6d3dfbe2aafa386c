"""Many sessions of many units as one: who passed, how the values are distributed, which are nearest to a limit.

Sessions are added one by one; of each nothing stays but its estimates.
"""

from __future__ import annotations

import json
import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

from bench.analysis import Estimate, estimates_of, is_sound, limits_of, use_of
from bench.maths.verdict import INDETERMINATE, clopper_pearson, is_refused, worst

_OF_ONE_UNIT = ("unit", "unit_temperature_degC")  # conditions that differ from unit to unit
WORST = 20


class Outcome(StrEnum):
    """Outcomes for a unit; of several outcomes of one unit the first of these counts."""

    FAIL = "fail"
    CONDITIONAL_FAIL = "conditional_fail"
    NO_RESULT = "no_result"
    CONDITIONAL_PASS = "conditional_pass"
    PASS = "pass"
    NOT_JUDGED = "not_judged"


@dataclass(frozen=True)
class Part:
    """The outcome of one session for one unit: how many of its estimates are judged, and how many of them failed."""

    unit: Unit
    session: str
    campaign: str
    judged: int
    failed: int
    outcome: Outcome
    unsound: int = 0  # estimates that are doubtful or refused


@dataclass(frozen=True)
class LeftOut:
    """A session that is not, or not wholly, in the batch: the code of the error and why."""

    session: str
    code: str
    text: str


@dataclass(frozen=True)
class Yield:
    """Counts of units that passed, failed, gave no verdict; the share of those judged that passed, 95 % interval."""

    passed: int
    failed: int
    without: int

    @property
    def share(self) -> float | None:
        """Passed of judged; None without any."""
        judged = self.passed + self.failed
        return self.passed / judged if judged else None

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson, 95 %."""
        return clopper_pearson(self.passed, self.passed + self.failed)


@dataclass
class Batch:
    """Sessions added so far. ``simulated``: names of those that are; ``damaged``: of those that are not whole."""

    parts: list[Part] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    simulated: list[str] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)
    hashes: dict[str, str] = field(default_factory=dict)
    values: dict[Quantity, list[Member]] = field(default_factory=dict)

    def add(self, results: Mapping[str, Any], session: str, missing: Sequence[str] = ()) -> None:
        """Add the results of a session (results.json); ``session`` is the name it has in the batch.

        ``missing``: what it promised without a result, a sentence each. A unit of which something is missing does not
        pass; a sentence that begins with "unit SERIAL:" is about that unit alone.
        """
        whole = Unit(str(results["uut"]["model"]), str(results["uut"]["serial"]))
        counts: dict[Unit, Counter[str]] = {}
        unsound: Counter[Unit] = Counter()
        for estimate in estimates_of(results):
            unit = Unit(whole.model, str(estimate.conditions.get("unit", whole.serial)))
            counts.setdefault(unit, Counter())[estimate.verdict] += 1
            unsound[unit] += not is_sound(estimate)
            self._keep(results["campaign"], unit, session, estimate)
        incomplete = bool(results.get("incomplete"))
        for unit, verdicts in (counts or {whole: Counter()}).items():
            judged = sum(verdicts.values()) - verdicts["none"]
            failed = sum(count for name, count in verdicts.items() if is_refused(name))
            doubted = verdicts[INDETERMINATE] or any(_concerns(sentence, unit) for sentence in missing)
            lacking = incomplete or not counts or (not failed and doubted)
            outcome = Outcome.NO_RESULT if lacking else _outcome(verdicts)
            self.parts.append(Part(unit, session, results["campaign"], judged, failed, outcome, unsound[unit]))
        self.hashes[session] = str(results["provenance"]["session_sha256"])
        if results["provenance"]["simulated"]:
            self.simulated.append(session)

    def _keep(self, campaign: str, unit: Unit, session: str, estimate: Estimate) -> None:
        where = {name: value for name, value in estimate.conditions.items() if name not in _OF_ONE_UNIT}
        quantity = Quantity(campaign, estimate.quantity, estimate.unit, json.dumps(where, sort_keys=True))
        if not is_sound(estimate):
            return
        chance, expanded = estimate.conformance_probability, estimate.expanded_uncertainty
        member = Member(unit, session, estimate.value, expanded, limits_of(estimate), estimate.verdict, chance)
        self.values.setdefault(quantity, []).append(member)

    @property
    def doubted(self) -> list[Unit]:
        """Return the units of which an estimate is doubtful or refused."""
        return list(dict.fromkeys(part.unit for part in self.parts if part.unsound))

    def without_result(self, manifest: Mapping[str, Any], session: str) -> None:
        """A session that can be read and determines nothing: its unit has no result."""
        campaign = manifest.get("campaign", {})
        uut = campaign.get("uut", {})
        unit = Unit(str(uut.get("model", "")), str(uut.get("serial", "")))
        self.parts.append(Part(unit, session, str(campaign.get("analysis", "")), 0, 0, Outcome.NO_RESULT))
        if manifest.get("simulated"):
            self.simulated.append(session)

    # --- what they say together ------------------------------------------------------------------------------------

    @property
    def outcomes(self) -> dict[Unit, Outcome]:
        """Of each unit over all its sessions: it passes if no session fails it or gives no result."""
        return _outcomes(self.parts)

    @property
    def campaigns(self) -> list[str]:
        """Names of the campaigns, in order."""
        return sorted({part.campaign for part in self.parts})

    def yield_of(self, campaign: str | None = None) -> Yield:
        """Of all units, or of those of one campaign by its sessions alone."""
        counts = Counter(_outcomes(part for part in self.parts if campaign in (None, part.campaign)).values())
        without = counts[Outcome.NO_RESULT] + counts[Outcome.NOT_JUDGED]
        failed = sum(count for outcome, count in counts.items() if is_refused(outcome))
        return Yield(sum(counts.values()) - failed - without, failed, without)

    @property
    def spreads(self) -> list[Spread]:
        """Every quantity, by campaign; those of one name together, in the order in which they came."""
        came = {name: place for place, name in enumerate(dict.fromkeys(quantity.name for quantity in self.values))}
        return [
            Spread(*entry)
            for entry in sorted(self.values.items(), key=lambda entry: (entry[0].campaign, came[entry[0].name]))
        ]

    @property
    def worst(self) -> list[tuple[Quantity, Member]]:
        """The values that most likely are outside their limits, the worst first."""
        judged = [
            (quantity, member)
            for quantity, members in self.values.items()
            for member in members
            if member.limits is not None
        ]
        return sorted(judged, key=lambda pair: pair[1].nearness)[:WORST]


def _concerns(missing: str, unit: Unit) -> bool:
    return not missing.startswith("unit ") or missing.startswith(f"unit {unit.serial}: ")


def _outcome(verdicts: Counter[str]) -> Outcome:
    """Return the worst verdict; one that is indeterminate beside a refusal says nothing more."""
    verdict = worst(name for name, count in verdicts.items() if count and name != INDETERMINATE)
    return Outcome.NOT_JUDGED if verdict == "none" else Outcome(verdict)


def _outcomes(parts: Iterable[Part]) -> dict[Unit, Outcome]:
    outcomes: dict[Unit, set[Outcome]] = {}
    for part in parts:
        outcomes.setdefault(part.unit, set()).add(part.outcome)
    return {unit: next(outcome for outcome in Outcome if outcome in said) for unit, said in sorted(outcomes.items())}


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
    limits: tuple[float, float] | None
    verdict: str
    probability: float | None

    @property
    def failed(self) -> bool:
        """Refused, conditionally too."""
        return is_refused(self.verdict)

    @property
    def nearness(self) -> tuple[float, float]:
        """Sorts members by how near to their limit they are, or how far beyond it: the worst first."""
        if self.limits is None:
            return (2.0, 0.0)
        return (1.0 if self.probability is None else self.probability, -use_of(self.value, self.limits))


class Quantity(NamedTuple):
    """A quantity that units are compared by: of a campaign, under its conditions (canonical JSON)."""

    campaign: str
    name: str
    unit: str
    conditions: str

    @property
    def where(self) -> dict[str, Any]:
        """The conditions."""
        conditions: dict[str, Any] = json.loads(self.conditions)
        return conditions


@dataclass(frozen=True)
class Spread:
    """The spread of a quantity over its members; ``std`` is None for one of them, ``limits`` if they differ."""

    quantity: Quantity
    members: Sequence[Member]

    @property
    def mean(self) -> float:
        """Mean value."""
        return statistics.fmean(member.value for member in self.members)

    @property
    def std(self) -> float | None:
        """Standard deviation (n - 1)."""
        return statistics.stdev(member.value for member in self.members) if len(self.members) > 1 else None

    @property
    def least(self) -> Member:
        """The smallest value."""
        return min(self.members, key=lambda member: member.value)

    @property
    def greatest(self) -> Member:
        """The greatest value."""
        return max(self.members, key=lambda member: member.value)

    @property
    def worst(self) -> Member | None:
        """The value that most likely is outside its limit; None if nothing is judged."""
        judged = [member for member in self.members if member.limits is not None]
        return min(judged, key=lambda member: member.nearness) if judged else None

    @property
    def limits(self) -> tuple[float, float] | None:
        """The limits, if all have the same."""
        limits = {member.limits for member in self.members}
        return limits.pop() if len(limits) == 1 else None

    @property
    def failed(self) -> int:
        """Number of members that failed."""
        return sum(member.failed for member in self.members)
