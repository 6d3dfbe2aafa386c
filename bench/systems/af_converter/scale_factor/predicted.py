"""Estimates of a campaign before its first hour: those of the records that a unit without error and noise would give.

What their uncertainties rest on is planned or declared: times, levels, temperatures, noise, quantum, standards.
"""

from __future__ import annotations

from collections.abc import Iterator

from bench.analysis import Estimate, Material, Planned, Prediction
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.scale_factor import METHODS
from bench.systems.af_converter.group_fit import Fitted, UNKNOWN_SLOPE_ppm_degC, missing_groups
from bench.systems.af_converter.groups import place_name
from bench.systems.af_converter.nominal import stimulated_row
from bench.systems.af_converter.scale_factor.estimates import determine
from bench.systems.af_converter.wording import say

_STEP_ppm = 0.01 * UNKNOWN_SLOPE_ppm_degC  # what 0.01 degC counts without coefficients


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a campaign will give; the values are those of a nominal unit.

    What only the temperature coefficients of the unit bring, the error of its temperature sensor above all, is missing:
    those of a nominal unit are zero. Where a plan does not determine them, the change between visits of a channel is
    named as missing: its uncertainty is that of coefficients by what the unit is warmer in one of both. All others then
    hold for a unit that is steady while a channel is measured.

    Raises:  FitError as ``analysis.analyse``, where no group at all is determined.
    """
    constants = read_campaign(planned.campaign)
    rows = [stimulated_row(window, constants) for window in planned.windows]
    known = determine(Material(rows, planned.campaign, planned.standards), METHODS[0])
    there = {visit.group.place for visit in known.fitted.groups}
    missing = missing_groups(rows, there, known.fitted.refused, constants)
    entries = [entry for entry in known.estimates if not _is_untold(entry, known.fitted)]
    return Prediction(entries, [*missing, *_untold(known.fitted)], _assumed(known.fitted))


def _is_untold(entry: Estimate, fitted: Fitted) -> bool:
    """Return whether an estimate is a change between visits that warming could be."""
    channel = entry.conditions.get("channel")  # a check by the meter has none
    return entry.quantity.endswith("_drift") and channel is not None and not fitted.knows_slopes(channel)


def _assumed(fitted: Fitted) -> list[str]:
    """Return a sentence on the unit, where no coefficients refer the rows of a visit to one temperature."""
    guessed = any(fitted.guesses_slopes(visit.group.channel) for visit in fitted.groups)
    return [say("predicted.steady", step=_STEP_ppm)] if guessed else []


def _untold(fitted: Fitted) -> Iterator[str]:
    for group in (visit.group for visit in fitted.groups):
        if group.repeat and not fitted.knows_slopes(group.channel):
            yield say("predicted.untold", place=place_name(group.place), step=_STEP_ppm)
