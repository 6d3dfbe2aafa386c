"""Values given on the command line with ``--set key=value``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.units import read_quantity
from bench.model.yamlio import Document
from bench.plan.findings import Findings, suggestion
from bench.plan.language.sequence import Sequence

WORLD = "world."


def split_overrides(
    document: Document[Sequence], overrides: Mapping[str, str], findings: Findings
) -> tuple[dict[str, str], dict[str, str]]:
    """Parameters of the sequence, and options of the simulated world.

    A key that the sequence has no parameter for is left out and noted (B-PLAN-003), naming the known ones.
    """
    known = document.model.parameters
    for key in overrides:
        if not key.startswith(WORLD) and key not in known:
            meant = suggestion(key, [*known, "world.<option>"])
            findings.add("B-PLAN-003", f"--set {key}", f"{document.name} has no parameter {key!r}{meant}")
    parameters = {key: value for key, value in overrides.items() if key in known}
    world = {key.removeprefix(WORLD): value for key, value in overrides.items() if key.startswith(WORLD)}
    return parameters, world


def apply_parameters(document: Document[Sequence], given: Mapping[str, str], findings: Findings) -> dict[str, Any]:
    """Parameters of the sequence with the given ones in place; each must be of the same sort as the one it replaces.

    A list is given with commas. One of another sort is noted (B-PLAN-005) and the shipped value stays.
    """
    parameters: dict[str, Any] = dict(document.model.parameters)
    for key, text in given.items():
        shipped = parameters[key]
        try:
            many = isinstance(shipped, list)
            parameters[key] = [_like(shipped[0], part) for part in text.split(",")] if many else _like(shipped, text)
        except (ValueError, IndexError) as error:
            findings.add("B-PLAN-005", f"--set {key}", f"{text!r} cannot replace {shipped!r}: {error}")
    return parameters


def _like(shipped: Any, text: str) -> Any:
    text = text.strip()
    if isinstance(shipped, bool):
        if text not in ("true", "false"):
            raise ValueError("true or false is due")
        return text == "true"
    if isinstance(shipped, (int, float)):
        return _number_like(shipped, text)
    old, new = read_quantity(str(shipped)), read_quantity(text)
    if (old and old[1]) != (new and new[1]):
        raise ValueError(f"a quantity in {old[1]} is due" if old else "a text without a unit is due")
    return text


def _number_like(shipped: float, text: str) -> float:
    due = "a whole number is due" if isinstance(shipped, int) else "a number is due"
    try:
        number = type(shipped)(text)
    except (ValueError, OverflowError):
        raise ValueError(due) from None
    if not math.isfinite(number):
        raise ValueError(due)
    return number
