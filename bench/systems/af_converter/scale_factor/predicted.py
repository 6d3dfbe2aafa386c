"""Estimates of a campaign before its first hour: those of the records that a unit without error and noise would give.

What their uncertainties rest on is planned or declared: times, levels, temperatures, noise, quantum, standards.
Source: AF-converter paper equations (1), (2), solved for the counts.
"""

from __future__ import annotations

import numpy as np

from bench.analysis import Material, Planned, Prediction
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import UNIT_TEMPERATURE, RecordRow
from bench.systems.af_converter.constants import Campaign, read_campaign
from bench.systems.af_converter.estimators.scale_factor import METHODS
from bench.systems.af_converter.group_fit import missing_groups
from bench.systems.af_converter.scale_factor.determined import determine


def predicted(planned: Planned) -> Prediction:
    """Return estimates with the uncertainties that a campaign will give; the values are those of a nominal unit.

    What only the temperature coefficients of the unit bring, the error of its temperature sensor above all, is missing:
    those of a nominal unit are zero.

    Raises:  FitError as ``analysis.analyse``, where no group at all is determined.
    """
    constants = read_campaign(planned.campaign)
    rows = [_row(window, constants) for window in planned.windows]
    known = determine(Material(rows, planned.campaign, planned.standards), METHODS[0])
    there = {visit.group.place for visit in known.fitted.groups}
    return Prediction(known.estimates, missing_groups(rows, there, known.fitted.refused, constants))


def _row(window: RecordWindow, constants: Campaign) -> RecordRow:
    """Return a record of a nominal unit at the planned temperature; no pulse comes where no current flows."""
    conditions = window.conditions
    gate_s = (window.t_end_ns - window.t_start_ns) / NS
    npp, ppp = (np.zeros(max(channel.number for channel in constants.channels), dtype=np.int64) for _ in range(2))
    if "channel" in conditions and conditions.get("route", "closed") != "open":
        channel = constants.channel(int(conditions["channel"]))
        current_A = abs(conditions.get("current_A") or 0.0) * conditions.get("polarity", 1)
        (npp if current_A > 0 else ppp)[channel.number - 1] = round(abs(current_A) * gate_s / channel.k0_C)
    clocks = {"af_clock": constants.af_clock_Hz, "master_count": constants.master_Hz, "fg_count": constants.fg_Hz}
    return RecordRow(
        window=window,
        sums={"npp": npp, "ppp": ppp, **{name: np.array(round(f_Hz * gate_s)) for name, f_Hz in clocks.items()}},
        frames=window.frames,
        lost=0,
        bad=0,
        quality=Quality.GOOD,
        context={UNIT_TEMPERATURE: float(conditions["temperature_degC"])} if "temperature_degC" in conditions else {},
    )
