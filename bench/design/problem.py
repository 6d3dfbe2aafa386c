"""What an analysis says of its campaigns so that the shortest one can be found: what is free, and what must stay."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from bench.analysis import Estimates
from bench.design.targets import Key
from bench.plan import Plan

C = TypeVar("C")
LEAST_POWER = 0.9  # against a rival that costs 1 U; below it a plan counts as blind to it


@dataclass(frozen=True)
class Given:
    """The campaign that a shorter one is made of; ``lag_s``: of the unit behind the set-point of the chamber."""

    plan: Plan
    text: str
    lag_s: float | None


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

    today: tuple[C, float]
    starts: Sequence[C]
    wanted: Sequence[tuple[str, str]]

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
