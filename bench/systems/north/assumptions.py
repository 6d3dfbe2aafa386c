"""What the data of a north finder cannot show: whatever turns the signal as another azimuth would.

The sizes are those of one standard uncertainty of noise where the noise decides, and said as such.
Source: FOG paper (digital north finding), equations (1) to (14): the phase of one sine is all that is known of north.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.systems import Assumption, assumed
from bench.systems.north.wording import say

EARTH_DEG_H = 15.041  # rate of the Earth's rotation
_AZIMUTHS = ("azimuth", "azimuth_error", "azimuth_rms_error")


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted, by its section "campaign"."""
    site = campaign.get("site") or {}
    latitude_deg = float(site.get("latitude_deg", 0.0))
    mark_deg = float(site.get("azimuth_std_deg", 0.0))
    return [
        assumed(
            say,
            "magnetic_effect",
            (*_AZIMUTHS, "index_placement", "scale"),
            rate=0.01 * _horizontal_deg_h(latitude_deg),
        ),
        *_poses(latitude_deg, mark_deg, float(site.get("tilt_std_deg", 0.0))),
        assumed(say, "zero_of_table", (*_AZIMUTHS, "index_placement")),
        assumed(say, "dividing_head", (*_AZIMUTHS, "index_placement", "scale")),
        assumed(say, "delay_of_lock_ins", _AZIMUTHS),
        assumed(say, "scale_factor", ("scale",), rate=_horizontal_deg_h(latitude_deg)),
    ]


def _horizontal_deg_h(latitude_deg: float) -> float:
    return EARTH_DEG_H * math.cos(math.radians(latitude_deg))


def _poses(latitude_deg: float, mark_deg: float, tilt_deg: float) -> list[Assumption]:
    tangent = abs(math.tan(math.radians(latitude_deg)))
    stated = say("stated.angle", angle=mark_deg) if mark_deg else say("stated.not")
    change_deg = math.degrees(1e-3 * math.radians(1.0)) * (1.0 + tangent**2)
    return [
        assumed(say, "azimuth_of_mark", (*_AZIMUTHS, "index_placement"), stated=stated),
        assumed(
            say,
            "latitude",
            _AZIMUTHS,
            latitude=latitude_deg,
            turn=math.degrees(1e-3 * tangent),
            change=change_deg,
        ),
        assumed(
            say,
            "axis_of_table",
            _AZIMUTHS,
            taken="taken" if tilt_deg else "taken_unstated",
            tilt=tilt_deg,
            turn=math.degrees(1e-4 * tangent),
        ),
    ]
