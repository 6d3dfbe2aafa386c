"""Limits of a north finder: the accuracy of the azimuth that is required of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.errors import FitError
from bench.model.units import parse_quantity

AZIMUTH_ERROR = "azimuth_error"
SPECIFIED: Mapping[str, tuple[str, float]] = {AZIMUTH_ERROR: ("deg", 0.5)}  # name -> (dimension, value in it)


def azimuth_error_limit_deg(campaign: Mapping[str, Any]) -> float:
    """Largest azimuth error allowed, degrees.

    Raises: FitError B-FOG-001 for a limit of the sequence that is not one of a north finder, or in a wrong unit.
    """
    limit_deg = SPECIFIED[AZIMUTH_ERROR][1]
    for name, stated in (campaign.get("limits") or {}).items():
        if name not in SPECIFIED:
            raise _unusable(name, "a north finder has no such limit")
        try:
            limit_deg = parse_quantity(f"{float(stated['value'])!r} {stated['unit']}", SPECIFIED[name][0])
        except (KeyError, TypeError, ValueError) as error:
            raise _unusable(name, str(error)) from error
    return limit_deg


def _unusable(name: str, why: str) -> FitError:
    return FitError(
        "B-FOG-001",
        f"limit {name!r}: {why}",
        where="manifest: campaign.limits",
        next_step=f"use one of: {', '.join(SPECIFIED)}, with a unit of its dimension",
    )
