"""What no converter channel can be: driven by the wrong polarity or none, on a clock that jumps, off by a tenth.

Each counter must be moved by the stimulus of its own polarity, both clocks of a unit keep their ratio, and a
scale-factor error must be one that a converter can have. Holds for every method that has levels of both polarities.
Source: docs/decisions/0025-doubt.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Evidence
from bench.systems.af_converter.assumptions import CLOCK_STEADY
from bench.systems.af_converter.constants import Campaign
from bench.systems.af_converter.estimators.readings import pulse_currents_A
from bench.systems.af_converter.group_fit import SCALE_FACTORS, clock_spread
from bench.systems.af_converter.groups import Group, place_name

Array = NDArray[np.float64]
_FOLLOWS = 0.5  # of the level: a counter that moves less does not follow the stimulus
_NEARLY_ALL = 0.9
_PPM = 1e6


def about(group: Group) -> dict[str, float]:
    """Return conditions of the estimates that a group gives."""
    return {"channel": group.channel, "temperature_degC": group.temperature_degC}


def plausible(group: Group, dsf_ppm: Array, campaign: Campaign) -> Iterator[Evidence]:
    """Yield what cannot be: a counter that follows the other polarity or none, an error beyond the declared bound.

    ``dsf_ppm``: scale-factor errors that the group gave, of either counter or their mean.
    """
    where = place_name(group.place)
    follows = _followed(group, campaign)
    against, beside = float(np.mean(follows < -_FOLLOWS)), float(np.mean(follows <= _FOLLOWS))
    if against > _NEARLY_ALL:
        sentence = (
            f"The leads of {where} are swapped: {100 * against:.0f} % of the levels drive the counter of the other "
            "polarity. Check the wiring of the channel and take it again."
        )
        yield _refusal("swapped_leads", sentence, against, group)
    elif beside > 0.0:
        sentence = (
            f"The counters of {where} do not follow the stimulus at {100 * beside:.0f} % of the levels. Check the "
            "route and the counters of the channel and take it again."
        )
        yield _refusal("stimulus_not_followed", sentence, beside, group)
    elif (spread := clock_spread(group, campaign)) > CLOCK_STEADY:
        sentence = (
            f"The clocks of {where} change by {_PPM * spread:.3g} ppm against each other between records, as no clock "
            "does. Check the AF clock and the master clock of the unit and take the channel again."
        )
        yield Evidence(
            "clock_unsteady", sentence, _PPM * spread, 0.0, math.inf, (*SCALE_FACTORS, "dsf_mean"), about(group)
        )
    else:
        bound_ppm = _PPM * campaign.channel(group.channel).plausible_error
        worst_ppm = float(np.abs(dsf_ppm).max())
        if worst_ppm > bound_ppm:
            sentence = (
                f"A scale-factor error of {worst_ppm:,.0f} ppm at {where} is beyond what is plausible "
                f"({bound_ppm:,.0f} ppm). Check charge per pulse, full scale and route of the channel."
            )
            yield _refusal("implausible_scale_factor", sentence, worst_ppm, group)


def _followed(group: Group, campaign: Campaign) -> Array:
    """Return what each level drives beyond the zeros, (l,), relative to it: 1 for its own counter, -1 for the other.

    A level that is no larger than the bias of the converter drives no less than the others, once the bias is off.
    """
    rows = group.closed
    n_A, p_A = pulse_currents_A(rows, campaign.converter(group.channel))
    levels, driven_A = rows.level_A > 0, n_A - p_A
    bias_A = float(driven_A[~levels].mean()) if not levels.all() else 0.0
    return np.asarray((rows.polarity * (driven_A - bias_A))[levels] / rows.level_A[levels])


def _refusal(code: str, sentence: str, figure: float, group: Group) -> Evidence:
    return Evidence(
        code,
        sentence,
        figure,
        0.0,
        quantities=(*SCALE_FACTORS, "dsf_mean", "bias"),
        conditions=about(group),
        refuses=True,
    )
