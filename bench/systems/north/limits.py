"""Limits of a north finder: the accuracy of the azimuth that is required of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.analysis import stated_limits
from bench.systems.north.declaration import DECLARATION

AZIMUTH_ERROR, SPECIFIED_deg = "azimuth_error", 0.5


def azimuth_error_limit_deg(campaign: Mapping[str, Any]) -> float:
    """Return the largest azimuth error allowed, degrees.

    Raises: FitError B-FOG-001 for a limit of the sequence that is not one of a north finder, in a wrong unit or not
            above zero.
    """
    (declared,) = DECLARATION.analyses
    stated = stated_limits(campaign, declared.limits, "B-FOG-001", "a north finder has no such limit")
    return stated.get(AZIMUTH_ERROR, SPECIFIED_deg)
