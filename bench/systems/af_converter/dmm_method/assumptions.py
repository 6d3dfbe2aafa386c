"""What no data of a campaign by the DMM method can show, with the size that passes unseen.

Sizes were seen with a meter of 20 ppm and a gyro and an accelerometer channel at one temperature.
Source: docs/decisions/0025-doubt.md; docs/decisions/0007-dmm-method.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption

_SCALE_FACTORS = ("dsf_n", "dsf_p", "dsf_mean")


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted, from the section "campaign" of its plan or manifest."""
    bound = min((float(channel.get("plausible_error", 0.05)) for channel in campaign.get("channels", ())), default=0.05)
    return [*_of_meter(bound), *_of_unit(bound)]


def _of_meter(bound: float) -> list[Assumption]:
    return [
        Assumption(
            "meter_gain",
            "The meter is within its specification.",
            f"A gain that all of its ranges share, up to {100.0 * bound:g} % (plausible error of a channel).",
            "It enters every scale-factor error one to one.",
            "The calibrator method on the same records, or a check standard in every campaign.",
            _SCALE_FACTORS,
        ),
        Assumption(
            "steady_meter",
            "The meter does not change between a channel and when it is taken again.",
            "1 ppm over the campaign; any size, if no channel is taken again.",
            "It enters dsf_n and dsf_p by as much of it as has passed.",
            "A channel that is taken again at the end, and one in the middle.",
            _SCALE_FACTORS,
        ),
    ]


def _of_unit(bound: float) -> list[Assumption]:
    return [
        Assumption(
            "all_current_through_the_unit",
            "All current that the meter reads goes through the unit.",
            f"A leakage in proportion to the current, up to {100.0 * bound:g} %.",
            "It enters every scale-factor error one to one.",
            "The meter behind the switch, in place of the unit, at one level of each polarity.",
            _SCALE_FACTORS,
        ),
        Assumption(
            "linear_at_full_scale",
            "The converter is linear up to its largest level.",
            "A loss of 200 ppm at full scale that grows with the fourth power; 10 ppm at the largest level alone.",
            "Less than a third of the expanded uncertainty of dsf_n and dsf_p.",
            "Further levels between the two largest ones.",
            (*_SCALE_FACTORS, "dsf_asymmetry"),
        ),
        Assumption(
            "clock_of_polarity",
            "The AF clock of a unit is the same while either polarity is measured.",
            "A change of 1 ppm with the polarity.",
            "It enters dsf_asymmetry one to one: 10 times its expanded uncertainty.",
            "The AF clock counted against the master clock in every record: changes beyond whole pulses.",
            ("dsf_asymmetry",),
        ),
    ]
