"""Limits that a sequence states for what its analysis estimates, read in one way for every system."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

from bench.model.declaration import Limit
from bench.model.errors import FitError
from bench.model.units import parse_quantity


def stated_limits(
    campaign: Mapping[str, Any], declared: Mapping[str, Limit], code: str, unknown: str
) -> dict[str, float]:
    """Return the limits that a campaign states, by name, in the base unit of their dimension.

    Args:    declared: every limit the system knows.   code, unknown: of the refusal, and what it says of others.
    Raises:  FitError with the given code for an unknown limit, a wrong unit or one that is not above zero and must be.
    """
    limits = {}
    for name, stated in (campaign.get("limits") or {}).items():
        if name not in declared:
            raise _unusable(code, name, unknown, declared)
        dimension = declared[name].dimension
        try:
            limits[name] = parse_quantity(f"{float(stated['value'])!r} {stated['unit']}", dimension)
        except (KeyError, TypeError, ValueError) as error:
            raise _unusable(code, name, str(error), declared) from error
        if declared[name].above_zero and not limits[name] > 0.0:
            raise _unusable(code, name, f"{limits[name]:g} {dimension} is not above zero", declared)
    return limits


def _unusable(code: str, name: str, why: str, declared: Mapping[str, Limit]) -> FitError:
    close = [] if name in declared else difflib.get_close_matches(name, declared, n=1)
    known = f"use one of: {', '.join(declared)}, with a unit of its dimension"
    return FitError(
        code,
        f"limit {name!r}: {why}",
        where="manifest: campaign.limits",
        next_step=f"did you mean {close[0]!r}?" if close else known,
    )
