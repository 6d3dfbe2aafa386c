"""Records of a nominal unit at planned times, and what its pulses are in a window: material of a prediction.

Source: AF-converter paper equations (1), (2), solved for the counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.maths.arrays import Integers
from bench.model.clock import NS
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import UNIT_TEMPERATURE, RecordRow
from bench.systems.af_converter.constants import Campaign

Columns = Mapping[str, Integers]

_MANY = 100  # pulses in a frame; of more it is their number that counts, not the instant of each


@dataclass(frozen=True)
class Counted:
    """Pulses of a record by polarity "npp", "ppp", (channels,) each, and when they came, as ``RecordRow.timing``."""

    sums: Columns
    timing: Columns = field(default_factory=dict)


def nominal_row(window: RecordWindow, counted: Counted, unit_degC: float | None, constants: Campaign) -> RecordRow:
    """Return a record of a nominal unit.

    Args:    window: as planned.   counted: what it counts.   unit_degC: temperature of the unit, None: not known.
    """
    gate_s = window_s(window)
    clocks = {"af_clock": constants.af_clock_Hz, "master_count": constants.master_Hz, "fg_count": constants.fg_Hz}
    sums = {**counted.sums, **{name: np.array(round(f_Hz * gate_s)) for name, f_Hz in clocks.items()}}
    return RecordRow(
        window=window,
        sums=sums,
        frames=window.frames,
        lost=0,
        bad=0,
        quality=Quality.GOOD,
        context={} if unit_degC is None else {UNIT_TEMPERATURE: unit_degC},
        timing=counted.timing,
        first_half={name: total // 2 for name, total in sums.items()},
    )


def stimulated_row(window: RecordWindow, constants: Campaign) -> RecordRow:
    """Return a record of a channel with a planned current; no pulse comes where no current flows.

    Raises:  FitError B-FIT-008 for a channel the campaign does not declare.
    """
    conditions = window.conditions
    npp, ppp = (np.zeros(columns(constants), dtype=np.int64) for _ in range(2))
    if "channel" in conditions and conditions.get("route", "closed") != "open":
        channel = constants.channel(int(conditions["channel"]))
        current_A = abs(conditions.get("current_A") or 0.0) * conditions.get("polarity", 1)
        (npp if current_A > 0 else ppp)[channel.number - 1] = round(abs(current_A) * window_s(window) / channel.k0_C)
    degC = conditions.get("temperature_degC")
    counted = Counted({"npp": npp, "ppp": ppp})
    return nominal_row(window, counted, None if degC is None else float(degC), constants)


def columns(constants: Campaign) -> int:
    """Return how many channels a record must have columns for."""
    return max(channel.number for channel in constants.channels)


def window_s(window: RecordWindow) -> float:
    """Return the planned length of a record, second."""
    return (window.t_end_ns - window.t_start_ns) / NS


def pulses_in(phase: float, grown: float, window: RecordWindow) -> dict[str, int]:
    """Return count and timing of the pulses of one polarity in a window, its current steady.

    Args:    phase: charge before the window, in pulses.   grown: charge of the window, in pulses, not negative.
    Returns: "count" and the keys of a record's timing; the frames of pulses count from 1 in the moments.
    Source:  a pulse comes whenever the charge has grown by another one.
    """
    if grown > _MANY * window.frames:
        each = np.diff(np.floor(phase + grown * np.arange(window.frames + 1) / window.frames))
        frames = np.flatnonzero(each) + 1
        counts = each[frames - 1]
    else:
        numbers = np.arange(np.floor(phase) + 1.0, np.floor(phase + grown) + 1.0)
        places = np.minimum(np.floor((numbers - phase) / (grown or 1.0) * window.frames), window.frames - 1.0) + 1.0
        frames, counts = np.unique(places, return_counts=True)
    found: dict[str, Any] = {
        "count": counts.sum(), "moment1": (counts * frames).sum(), "moment2": (counts * frames**2).sum()
    }  # fmt: skip
    for key, end in {"first": 0, "last": -1}.items():
        found[key] = window.first_counter + frames[end] - 1 if frames.size else -1
        found[f"at_{key}"] = counts[end] if frames.size else 0
    return {key: int(value) for key, value in found.items()}
