"""What no data of a campaign by the DMM method can show, with the size that passes unseen.

Sizes were seen with a meter of 20 ppm and a gyro and an accelerometer channel at one temperature.
Source: docs/decisions/0025-doubt.md; docs/decisions/0007-dmm-method.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption, assumed
from bench.systems.af_converter.wording import say

_SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_mean")


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted, from the section "campaign" of its plan or manifest."""
    bound = min((float(channel.get("plausible_error", 0.05)) for channel in campaign.get("channels", ())), default=0.05)
    leakage = "all_current_through_the_unit"
    return [
        assumed(say, "meter_gain", _SCALE_FACTORS, unseen=say("assumption.meter_gain.unseen", percent=100.0 * bound)),
        assumed(say, "steady_meter", _SCALE_FACTORS),
        assumed(say, leakage, _SCALE_FACTORS, unseen=say(f"assumption.{leakage}.unseen", percent=100.0 * bound)),
        assumed(say, "linear_at_full_scale", (*_SCALE_FACTORS, "dsf_asymmetry")),
        assumed(say, "clock_of_polarity", ("dsf_asymmetry",)),
    ]
