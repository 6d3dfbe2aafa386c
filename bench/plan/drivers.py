"""What the drivers a station names declare about themselves: actions and current ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

from bench.model.drivers import driver_class
from bench.model.ports import Action, actions_of


@lru_cache(maxsize=64)
def driver_actions(name: str) -> Mapping[str, Action]:
    """Declared actions of a driver, by name."""
    return actions_of(driver_class(name))


def driver_ladder_A(name: str) -> tuple[float, ...]:
    """Current ranges of a source as its driver declares them (``ranges_A``), ampere, lowest first; () if it has none.

    Raises: InputError B-PLAN-010, B-PLAN-011.
    """
    return tuple(sorted(getattr(driver_class(name), "ranges_A", ())))


def range_after(ladder_A: Sequence[float], level_A: float, locked: bool, before_A: float | None) -> float | None:
    """Range of a source after a level was set: the lowest that holds it, or the range before if that is locked.

    None if no range holds the level, or if the locked range is not known.
    """
    if locked:
        return before_A if before_A is not None and abs(level_A) <= before_A else None
    return next((limit_A for limit_A in sorted(ladder_A) if abs(level_A) <= limit_A), None)
