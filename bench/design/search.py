"""Searches the best of finitely many candidates by exchanges, each of which must make it better.

Source: Fedorov, Theory of Optimal Experiments (1972), chapter 3: exchange algorithms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar

C = TypeVar("C")
C_contra = TypeVar("C_contra", contravariant=True)
Rank = tuple[float, ...]


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
