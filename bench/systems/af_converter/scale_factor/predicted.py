"""Estimates of a campaign before its first hour: those of the records that a unit without error and noise would give.

What their uncertainties rest on is planned or declared: times, levels, temperatures, noise, quantum, standards.
"""

from __future__ import annotations

from bench.analysis import Material, Planned, Prediction
from bench.systems.af_converter.constants import read_campaign
from bench.systems.af_converter.estimators.scale_factor import METHODS
from bench.systems.af_converter.group_fit import missing_groups
from bench.systems.af_converter.nominal import stimulated_row
from bench.systems.af_converter.scale_factor.determined import determine


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a campaign will give; the values are those of a nominal unit.

    What only the temperature coefficients of the unit bring, the error of its temperature sensor above all, is missing:
    those of a nominal unit are zero.

    Raises:  FitError as ``analysis.analyse``, where no group at all is determined.
    """
    constants = read_campaign(planned.campaign)
    rows = [stimulated_row(window, constants) for window in planned.windows]
    known = determine(Material(rows, planned.campaign, planned.standards), METHODS[0])
    there = {visit.group.place for visit in known.fitted.groups}
    return Prediction(known.estimates, missing_groups(rows, there, known.fitted.refused, constants))
