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
from bench.systems.af_converter.wording import say

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
        sentence = say("evidence.swapped", place=where, share=100 * against)
        yield _refusal("swapped_leads", sentence, against, group)
    elif beside > 0.0:
        sentence = say("evidence.not_followed", place=where, share=100 * beside)
        yield _refusal("stimulus_not_followed", sentence, beside, group)
    elif (spread := clock_spread(group, campaign)) > CLOCK_STEADY:
        sentence = say("evidence.clocks", place=where, spread=_PPM * spread)
        yield Evidence(
            "clock_unsteady", sentence, _PPM * spread, 0.0, math.inf, (*SCALE_FACTORS, "dsf_mean"), about(group)
        )
    else:
        bound_ppm = _PPM * campaign.channel(group.channel).plausible_error
        worst_ppm = float(np.abs(dsf_ppm).max())
        if worst_ppm > bound_ppm:
            sentence = say("evidence.implausible", place=where, worst=worst_ppm, bound=bound_ppm)
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
