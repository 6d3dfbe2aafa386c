"""Limits that a sequence states for what its analysis estimates, read in one way for every system."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any

from bench.model.errors import FitError
from bench.model.units import parse_quantity


def stated_limits(
    campaign: Mapping[str, Any], dimensions: Mapping[str, str], code: str, unknown: str, *, two_sided: bool = False
) -> dict[str, float]:
    """Return the limits that a campaign states, by name, in the base unit of their dimension.

    Args:    dimensions: of every limit the system knows.   code, unknown: of the refusal, and what it says of others.
             two_sided: limits may be ends of a range, of either sign; otherwise each is a largest error, above zero.
    Raises:  FitError with the given code for an unknown limit, a wrong unit or an error that is not above zero.
    """
    limits = {}
    for name, stated in (campaign.get("limits") or {}).items():
        if name not in dimensions:
            raise _unusable(code, name, unknown, dimensions)
        try:
            limits[name] = parse_quantity(f"{float(stated['value'])!r} {stated['unit']}", dimensions[name])
        except (KeyError, TypeError, ValueError) as error:
            raise _unusable(code, name, str(error), dimensions) from error
        if not (two_sided or limits[name] > 0.0):
            raise _unusable(code, name, f"{limits[name]:g} {dimensions[name]} is not above zero", dimensions)
    return limits


def _unusable(code: str, name: str, why: str, dimensions: Mapping[str, str]) -> FitError:
    close = [] if name in dimensions else difflib.get_close_matches(name, dimensions, n=1)
    known = f"use one of: {', '.join(dimensions)}, with a unit of its dimension"
    return FitError(
        code,
        f"limit {name!r}: {why}",
        where="manifest: campaign.limits",
        next_step=f"did you mean {close[0]!r}?" if close else known,
    )
