"""Finds the shortest campaign that reaches its targets under the rules of its analysis, and the best one in a time.

What an analysis says of its campaigns so that the shortest one can be found: what is free, and what must stay.

Targets of a plan: which uncertainty of which quantity, and the floor that the standards set.

The random part is what no other result shares: the uncertainty without the errors of standards and campaign.

Searches the best of finitely many candidates by exchanges, each of which must make it better.

The length of a soak by the thermal lag of the unit, in place of one slot for all steps of temperature.

Source: Fedorov, Theory of Optimal Experiments (1972), chapter 3: exchange algorithms.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Generic, NamedTuple, Protocol, TypeVar

from bench.analysis import Estimate, Estimates
from bench.design.edits import SequenceText
from bench.maths.verdict import coverage_factor
from bench.model.errors import InputError
from bench.model.units import read_quantity
from bench.plan import Plan

RANDOM = "random"
_TARGET = re.compile(r"\s*(\w+)(\.random)?\s*=\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*")
_SLACK = 1.0 + 1e-9
_ALIKE = 1.001  # of an uncertainty that is no larger, to the digits that anybody states
C = TypeVar("C")
LEAST_POWER = 0.9  # against a rival that costs 1 U; below it a plan counts as blind to it
C_contra = TypeVar("C_contra", contravariant=True)
Rank = tuple[float, ...]
_HALVINGS = 8  # of the range of factors: 32^(1 / 256) = 1.014 is left of it
_LOOSEST, _TIGHTEST = 8.0, 0.25
WHOLE_s = 60.0  # a slot of a soak is a whole number of minutes


class Key(NamedTuple):
    """A quantity, the part of its uncertainty ("" all of it), and a kind of channels ("" all kinds)."""

    quantity: str
    part: str
    kind: str

    @property
    def name(self) -> str:
        """Return the key as a person writes it."""
        return f"{self.quantity}{'.' + self.part if self.part else ''}{f' ({self.kind})' if self.kind else ''}"


@dataclass(frozen=True)
class Target:
    """An expanded uncertainty (95 %) that a plan must reach, in the unit of its quantity."""

    key: Key
    U: float

    def takes_in(self, key: Key) -> bool:
        """Return whether the target is for what a key names."""
        return key[:2] == self.key[:2] and self.key.kind in ("", key.kind)

    def holds(self, known: Mapping[Key, float]) -> bool:
        """Return whether the largest uncertainty of the quantity does not exceed the target."""
        return self.reached(known) <= self.U * _SLACK

    def reached(self, known: Mapping[Key, float]) -> float:
        """Return the largest uncertainty of what the target takes in; infinite if there is nothing of it."""
        return max((U for key, U in known.items() if self.takes_in(key)), default=math.inf)


def reached(estimates: Estimates) -> dict[Key, float]:
    """Return the largest expanded uncertainty of each quantity and kind, all of it and its random part."""
    known: dict[Key, float] = {}
    for entry in _first_visits(estimates):
        kind = str(entry.conditions.get("kind", ""))
        for part, U in (("", entry.expanded_uncertainty), (RANDOM, random_U(entry))):
            key = Key(entry.quantity, part, kind)
            known[key] = max(known.get(key, 0.0), U)
    return known


def _first_visits(estimates: Estimates) -> list[Estimate]:
    """Return the estimates without those of repeats, of which no target is."""
    return [entry for entry in estimates if "repeat" not in entry.conditions]


def random_U(entry: Estimate) -> float:
    """Return the expanded uncertainty (95 %) of an estimate without what it shares with others, by its own factor."""
    common = entry.common
    parts = [] if common is None else [*common.standards.values(), *common.campaign.values()]
    own = entry.std_uncertainty**2 - math.fsum(part**2 for part in parts)
    return entry.coverage_factor * math.sqrt(max(own, 0.0))


def read_target(text: str, estimates: Estimates) -> Target:
    """Read ``dsf_n=22ppm`` or ``dsf_n.random=0.6ppm``. Raises: InputError B-DES-001."""
    match = _TARGET.fullmatch(text)
    units = {entry.quantity: entry.unit for entry in _first_visits(estimates)}
    quantity, part, number, unit = match.groups() if match else ("", "", "0", "")
    if quantity not in units:
        message = f"{text!r} is no target of this campaign" if match else f"{text!r} is not QUANTITY=U"
        known = ", ".join(units)
        raise InputError("B-DES-001", message, where="--target", next_step=f"write QUANTITY=U of: {known}")
    U = _in_unit(number, unit, units[quantity])
    if not 0.0 < U < math.inf:
        message = f"{text!r} states no uncertainty above zero with a unit"
        step = f"write a number with the unit {units[quantity]}, or another of its kind"
        raise InputError("B-DES-001", message, where="--target", next_step=step)
    return Target(Key(quantity, RANDOM if part else "", ""), U)


def _in_unit(number: str, unit: str, due: str) -> float:
    """Return a number with a unit in the unit that is due, NaN without one or with one of another dimension."""
    if unit == due:
        return float(number)
    stated, one = read_quantity(f"{number} {unit}"), read_quantity(f"1 {due}")
    return stated[0] / one[0] if stated and one and stated[1] == one[1] else math.nan


def default_targets(wanted: Iterable[tuple[str, str]], known: Mapping[Key, float]) -> list[Target]:
    """Return as targets what a campaign reaches in the quantities that are wanted, of each kind, to a thousandth."""
    return [Target(key, _ALIKE * known[key]) for part in wanted for key in known if key[:2] == part]


def refuse_below_floor(targets: Iterable[Target], estimates: Estimates) -> None:
    """Refuse targets that no plan with these standards reaches. Raises: InputError B-DES-002 with the floor.

    The floor is what the errors of the standards alone leave; ``estimates``: of all given levels.
    """
    for target in targets:
        entries = [entry for entry in estimates if entry.quantity == target.key.quantity]
        for entry in [] if target.key.part else entries:
            common = entry.common
            parts = common.standards if common is not None else {}
            floor = coverage_factor() * math.sqrt(math.fsum(part**2 for part in parts.values()))
            if floor > target.U:
                raise _below(target, floor, parts, entry.unit)


def _below(target: Target, floor: float, parts: Mapping[str, float], unit: str) -> InputError:
    k, label = coverage_factor(), max(parts, key=lambda name: abs(parts[name]))
    others = k * math.sqrt(math.fsum(part**2 for name, part in parts.items() if name != label))
    message = (
        f"{target.key.name}={target.U:.6g} {unit} is below {floor:.3g} {unit}, which the standards alone leave; "
        f"{k * abs(parts[label]):.3g} {unit} of it is {label!r}"
    )
    if others < target.U:
        better = f"know {label!r} to {math.sqrt(target.U**2 - others**2):.3g} {unit}, or ask for {floor:.3g} {unit}"
    else:
        better = f"without it {others:.3g} {unit} would be left; ask for {floor:.3g} {unit}"
    return InputError("B-DES-002", message, where="--target", next_step=better)


def misses(targets: Sequence[Target], known: Mapping[Key, float]) -> list[str]:
    """Return the targets that are not reached, a sentence each."""
    return [
        f"{target.key.name} is {target.reached(known):.3g}, not {target.U:.3g}"
        for target in targets
        if not target.holds(known)
    ]


@dataclass(frozen=True)
class Given:
    """The campaign that a shorter one is made of; ``lag_s``: of the unit behind the set-point of the chamber."""

    plan: Plan
    text: str
    lag_s: float | None

    def renamed(self, name: str, **heads: str) -> SequenceText:
        """Return its sequence under another name, with other values of the heads (title, duration) that it has.

        Raises: InputError B-DES-005.
        """
        text = SequenceText(self.text, self.plan.files[f"sequences/{self.plan.name}.yaml"])
        for key, value in {"sequence": name, **heads}.items():
            if key in text.tree:
                text.set_value((key,), value, "")
        return text


@dataclass(frozen=True)
class Power:
    """How surely a rival of the model would be seen, were it large enough to cost an estimate 1 U.

    ``rival``: what else could be true; ``quantity``: whose U; ``power``: probability that the checks tell it.
    """

    rival: str
    quantity: str
    power: float


class Problem(Protocol[C]):
    """The campaigns that may stand in the place of a given one.

    A candidate is hashable and leaves out the length of records, which is one for all. The search halves the lengths as
    if a longer one knew every target better. That is so of most candidates, not of all: a record of other length weighs
    the noises of the levels differently. There it may overlook a shorter plan; what it returns is fitted itself.

    ``today``: the candidate and the length that were given.   ``starts``: where the search begins.
    ``wanted``: quantities with the part of their uncertainty ("" all, "random") that a plan must reach as the given one
    does, where nobody says otherwise.
    """

    @property
    def today(self) -> tuple[C, float]:
        """Return the campaign that was given."""

    @property
    def starts(self) -> Iterable[C]:
        """Yield where the search begins."""

    @property
    def wanted(self) -> Sequence[tuple[str, str]]:
        """Return what a plan must reach."""

    def moves(self, candidate: C) -> Iterable[C]:
        """Return what one change makes of a candidate."""

    def lengths_s(self, candidate: C) -> Sequence[float]:
        """Return the lengths of records that a candidate may have, ascending."""

    def duration_s(self, candidate: C, length_s: float) -> float:
        """Return how long the campaign takes."""

    def estimates(self, candidate: C, length_s: float) -> Estimates:
        """Return what the campaign will give, by the fit itself; one channel stands for all that are alike."""

    def at_least(self, candidate: C, length_s: float) -> Mapping[Key, float]:
        """Return bounds of uncertainties that cost little: what misses a target by them need not be fitted.

        They must hold for candidates under the rules; another, which is refused anyway, may know a little more.
        """

    def broken(self, candidate: C, length_s: float) -> list[str]:
        """Return the rules that the campaign breaks, a sentence each: hours are not bought with blindness."""

    def powers(self, candidate: C, length_s: float) -> list[Power]:
        """Return how surely each listed rival would be seen."""

    def told(self, candidate: C, length_s: float) -> dict[str, str]:
        """Return what the campaign does, by the name of each thing that is free."""

    def changes(self, candidate: C, length_s: float) -> Iterable[tuple[str, C, float]]:
        """Yield the way from the given campaign to a candidate, one named change after the other."""

    def written(self, candidate: C, length_s: float, name: str, heading: Sequence[str]) -> str:
        """Return the campaign as a sequence of this name, under a heading of comments. Raises: InputError B-DES-005."""


def weakest(seen: Iterable[tuple[str, str, float]]) -> list[Power]:
    """Return the least power for each rival and quantity."""
    least: dict[tuple[str, str], float] = {}
    for rival, quantity, power in seen:
        least[rival, quantity] = min(power, least.get((rival, quantity), 1.0))
    return [Power(*place, power) for place, power in least.items()]


def blind(problem: Problem[C], candidate: C, length_s: float, always: str = "") -> list[str]:
    """Return the rivals that the given campaign shows and a candidate does not, a sentence each.

    ``always``: begin of the names of rivals that every candidate must show.
    """
    today = {(power.rival, power.quantity): power.power for power in problem.powers(*problem.today)}
    return [
        f"{power.rival} that costs 1 U of {power.quantity} is seen with probability {power.power:.2f}"
        for power in problem.powers(candidate, length_s)
        if power.power < LEAST_POWER
        and (
            today.get((power.rival, power.quantity), 0.0) >= LEAST_POWER or (always and power.rival.startswith(always))
        )
    ]


class Ranking(Protocol[C_contra]):
    """Rank candidates: less is better, None stands for one that is not better than ``least``."""

    def __call__(self, candidate: C_contra, least: Rank | None) -> Rank | None:
        """Return the rank of a candidate."""


def descended(starts: Iterable[C], moves: Callable[[C], Iterable[C]], rank: Ranking[C]) -> tuple[C, Rank] | None:
    """Return the best candidate that steepest descent finds, with its rank.

    Args:    starts: one that is no better than what was found already is not followed.
             moves: the candidates that one exchange makes of a candidate.   rank: is asked for a rank below the best
             so far, so that most candidates need not be evaluated in full.
    Returns: None if no start has a rank.
    """
    best: tuple[C, Rank] | None = None
    for start in starts:
        here = _better([start], rank, best)
        while here is not None:
            best = here
            here = _better(moves(best[0]), rank, best)
    return best


def _better(candidates: Iterable[C], rank: Ranking[C], best: tuple[C, Rank] | None) -> tuple[C, Rank] | None:
    least = None if best is None else best[1]
    found = None
    for candidate in candidates:
        ranked = rank(candidate, least)
        if ranked is not None and (least is None or ranked < least):
            found, least = (candidate, ranked), ranked
    return found


@dataclass(frozen=True)
class Design(Generic[C]):
    """A campaign that was found. ``factor``: of the targets that it was made for."""

    candidate: C
    length_s: float
    duration_s: float
    factor: float = 1.0


def designed(problem: Problem[C], targets: Sequence[Target], factor: float = 1.0) -> Design[C] | None:
    """Return the shortest campaign that reaches ``factor`` times the targets, None if no one does."""
    loosened = [replace(target, U=factor * target.U) for target in targets]

    @cache
    def fulfils(candidate: C, length_s: float) -> bool:
        bounds = problem.at_least(candidate, length_s)
        if any(target.takes_in(key) and U > target.U for target in loosened for key, U in bounds.items()):
            return False
        known = reached(problem.estimates(candidate, length_s))
        return not misses(loosened, known) and not problem.broken(candidate, length_s)

    def rank(candidate: C, least: Rank | None) -> Rank | None:
        lengths = problem.lengths_s(candidate)
        if least is not None:
            lengths = lengths[: bisect_left(lengths, least[0], key=lambda each: problem.duration_s(candidate, each))]
        if not lengths or not fulfils(candidate, lengths[-1]):
            return None
        low, high = -1, len(lengths) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if fulfils(candidate, lengths[middle]) else (middle, high)
        return problem.duration_s(candidate, lengths[high]), lengths[high]

    best = descended(problem.starts, problem.moves, rank)
    if best is None:
        return None
    candidate, (duration_s, length_s) = best
    return Design(candidate, length_s, duration_s, factor)


def best_within(problem: Problem[C], targets: Sequence[Target], most_s: float) -> Design[C] | None:
    """Return the campaign that lasts at most ``most_s`` and reaches the smallest factor of the targets, to 1.4 %.

    None if even targets eight times as wide take longer; nothing below a quarter of them is tried.
    """
    high, low = _LOOSEST, _TIGHTEST
    best = designed(problem, targets, high)
    if best is None or best.duration_s > most_s:
        return None
    for _ in range(_HALVINGS):
        middle = (low * high) ** 0.5
        found = designed(problem, targets, middle)
        if found is not None and found.duration_s <= most_s:
            best, high = found, middle
        else:
            low = middle
    return best


def slot_s(step_degC: float, ramp_degC_min: float, within_degC: float, for_s: float, lag_s: float) -> float:
    """Return the slot after which a unit has been inside the band for as long as it must, second.

    Args:    step_degC: from the temperature before to the target.   ramp_degC_min: of the set-point.   within_degC,
             for_s: half-width of the band, and how long the unit must be in it.   lag_s: of the unit behind the
             set-point.
    Source:  first-order lag behind a ramp: it trails by rate times lag, and what is left decays with the lag.
    """
    ramp_s = 60.0 * abs(step_degC) / ramp_degC_min
    behind_degC = ramp_degC_min / 60.0 * lag_s * -math.expm1(-ramp_s / lag_s)
    settled_s = lag_s * math.log(max(behind_degC / within_degC, 1.0))
    return WHOLE_s * math.ceil((ramp_s + settled_s + for_s) / WHOLE_s)
