"""Finds the shortest campaign that reaches its targets under the rules of its analysis, and the best one in a time."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Generic, TypeVar

from bench.design.problem import Problem
from bench.design.search import Rank, descended
from bench.design.targets import Target, misses, reached

C = TypeVar("C")
_HALVINGS = 8  # of the range of factors: 32^(1 / 256) = 1.014 is left of it
_LOOSEST, _TIGHTEST = 8.0, 0.25


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
