"""Looks up the driver class a station names, by plain name, so that a YAML cannot run code of its choosing."""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache

from bench.model.errors import InputError
from bench.model.ports import Action, actions_of

_PLAIN = re.compile(r"[a-z0-9_]{1,40}")


@lru_cache(maxsize=64)
def driver_class(name: str) -> type:
    """The driver class of ``instruments/<name>.py``.

    Raises: InputError B-PLAN-010 if the name is not plain, B-PLAN-011 if there is no such driver.
    """
    if not _PLAIN.fullmatch(name) or name.startswith("_"):
        raise InputError("B-PLAN-010", f"{name!r} is not a plain driver name (a-z, 0-9 and _)", where=name)
    module_name = f"instruments.{name}"
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name not in (module_name, "instruments"):
            raise
        raise InputError("B-PLAN-011", f"there is no driver {name!r} in instruments/", where=name) from error
    found = getattr(module, "DRIVER", None)
    if not isinstance(found, type):
        raise InputError("B-PLAN-011", f"instruments/{name}.py holds no driver", where=name)
    return found


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
