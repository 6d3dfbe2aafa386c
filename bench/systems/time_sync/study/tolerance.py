"""Estimates of the study in the form of results.json, held against a tolerance with one or two ends.

A tolerance from 0.2 to 0.45 does not fit a limit on the size of a value: its ends stand in the conditions as
``at_least`` and ``at_most``, and ``limit`` repeats the upper one, or the lower where there is no upper one. The value
itself is judged; its uncertainty is that of a finite number of runs and stands beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.analysis import estimate


def measured(
    quantity: str,
    unit: str,
    value: float,
    std: float,
    conditions: Mapping[str, Any],
    *,
    n: int,
    at_least: float | None = None,
    at_most: float | None = None,
) -> dict[str, Any]:
    """Return an estimate; judged if a tolerance is given.

    Args:    std: standard uncertainty from the number of runs, 0 for what has none; all in ``unit``.
    Returns: an entry of the flat list of results.json.
    """
    ends = {"at_least": at_least, "at_most": at_most}
    given = {name: float(end) for name, end in ends.items() if end is not None}
    entry = estimate(quantity, unit, value, std, {**conditions, **given}, n=n)
    if given:
        inside = math.isfinite(value) and given.get("at_least", -math.inf) <= value <= given.get("at_most", math.inf)
        entry["limit"] = given.get("at_most", given.get("at_least"))
        entry["verdict"] = "pass" if inside else "fail"
    return entry


def rms_std(rms: float, runs: int) -> float:
    """Return standard uncertainty of the RMS of so many independent normal errors of mean zero."""
    return rms / math.sqrt(2.0 * runs)


def unjudged(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same without a verdict: the tolerance was stated for more runs than there are."""
    return {**entry, "limit": None, "verdict": "none"}
