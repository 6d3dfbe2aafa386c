"""What no recording of two units can show, by name, with the size that passes unseen.

Sizes are those that the checks of a recording see in half of all cases, for a turn of 90 deg in 8 s at 100 m/s and
units as the sequences state them (docs/method-time-sync.md); larger stated errors hide as much more.
Source: docs/method-uncertainty.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.systems import Assumption, assumed
from bench.systems.time_sync.wording import say

_QUANTILE = 5.0  # standard deviations at which a check of a recording speaks
_MS = 1e3
_OFFSETS = ("time_offset", "time_offset_uncertainty")
_STAMPS = ("time_offset_from_stamps", "time_offset_drift", "clock_rate")
_STEP_s, _DRIFT = 0.5e-3, 140e-6  # of an offset, and s/s, that are seen in half of all cases
_VELOCITY_m_s = 0.017  # error of the EGI with which these were seen


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a recording takes for granted, from the section "campaign" of its plan or manifest."""
    stated = campaign.get("egi") or {}
    worse = float(stated.get("velocity_m_s", _VELOCITY_m_s)) / _VELOCITY_m_s
    drift_ppm = 1e6 * _DRIFT * worse
    return [
        _latency(campaign.get("latency")),
        assumed(say, "one_offset", _OFFSETS, step=_MS * _STEP_s * worse, drift=drift_ppm),
        assumed(say, "steady_delay", (*_STAMPS, *_OFFSETS), drift=drift_ppm),
        assumed(say, "errors_as_stated", _OFFSETS),
    ]


def _latency(stated: Mapping[str, Any] | None) -> Assumption:
    quantities = (*_OFFSETS, "time_offset_from_stamps")
    if stated is None:
        return assumed(say, "latency_as_stated", quantities, unseen="unseen_unstated")
    seen_ms = _MS * _QUANTILE * math.sqrt(2.0) * float(stated["std_s"])
    return assumed(say, "latency_as_stated", quantities, seen=seen_ms)
