"""What is required of an alignment with a ring laser gyro, and where it takes place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bench.analysis import stated_limits
from bench.model.errors import FitError
from bench.systems.lock_in.declaration import DECLARATION

NATO_MIL_DEG = 360.0 / 6400.0


@dataclass(frozen=True)
class Requirement:
    """``error_deg``: largest azimuth error of the alignment.   ``time_s``: that it may take, None if nobody says.

    ``latitude_deg``: of the site, which the time depends on.
    """

    error_deg: float
    time_s: float | None
    latitude_deg: float


def requirement_of(campaign: Mapping[str, Any]) -> Requirement:
    """Read ``limits`` and ``site`` of the campaign; without a limit the error is one NATO mil (360 deg / 6400).

    Raises: FitError B-RLG-004 (a limit that no ring laser has, or in a wrong unit), B-RLG-005 (no latitude).
    """
    (declared,) = DECLARATION.analyses
    stated = stated_limits(campaign, declared.limits, "B-RLG-004", "an alignment with a ring laser has no such limit")
    try:
        latitude_deg = float((campaign.get("site") or {})["latitude_deg"])
    except KeyError as error:
        raise FitError(
            "B-RLG-005",
            "the campaign does not state the latitude of the site, which the alignment time depends on",
            where="manifest: campaign.site",
            next_step="give 'latitude' in the section 'site' of the sequence",
        ) from error
    return Requirement(stated.get("alignment_error", NATO_MIL_DEG), stated.get("alignment_time"), latitude_deg)
