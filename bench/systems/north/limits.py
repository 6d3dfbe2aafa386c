"""Limits of a north finder: the accuracy of the azimuth that is required of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.analysis import stated_limits

AZIMUTH_ERROR = "azimuth_error"
SPECIFIED: Mapping[str, tuple[str, float]] = {AZIMUTH_ERROR: ("deg", 0.5)}  # name -> (dimension, value in it)
DIMENSIONS: Mapping[str, str] = {name: dimension for name, (dimension, _) in SPECIFIED.items()}


def azimuth_error_limit_deg(campaign: Mapping[str, Any]) -> float:
    """Return the largest azimuth error allowed, degrees.

    Raises: FitError B-FOG-001 for a limit of the sequence that is not one of a north finder, in a wrong unit or not
            above zero.
    """
    stated = stated_limits(campaign, DIMENSIONS, "B-FOG-001", "a north finder has no such limit")
    return stated.get(AZIMUTH_ERROR, SPECIFIED[AZIMUTH_ERROR][1])
