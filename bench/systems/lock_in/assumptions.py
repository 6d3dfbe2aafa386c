"""What no record of a ring laser can show, by name.

Source: docs/method-uncertainty.md; equations (2), (6) and (10) of docs/method-ring-laser.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.systems import Assumption, assumed
from bench.systems.lock_in.wording import say

_OUTPUTS = ("angle_random_walk", "quantisation_noise", "alignment_time")


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted; ``campaign``: that section of a plan or manifest."""
    return [
        assumed(say, "path_length", ("lock_in_rate", *_OUTPUTS)),
        assumed(say, "tagger_clock", ("lock_in_rate", *_OUTPUTS)),
        _latitude(campaign),
        assumed(
            say, "still_base", ("angle_random_walk", "alignment_time", "random_walk_ratio", "alignment_time_ratio")
        ),
        assumed(say, "longer_than_the_record", ("alignment_time",)),
        assumed(say, "phase_of_the_beat", ("backscatter_phase",)),
    ]


def _latitude(campaign: Mapping[str, Any]) -> Assumption:
    latitude_deg = (campaign.get("site") or {}).get("latitude_deg")
    if latitude_deg is None:
        return assumed(say, "latitude", ("alignment_time",))
    share = 2.0 * math.radians(1.0) * abs(math.tan(math.radians(float(latitude_deg))))
    return assumed(
        say, "latitude", ("alignment_time",),
        effect="effect_stated", latitude=float(latitude_deg), share=100.0 * share,
    )  # fmt: skip
