"""The time offset between an EGI and an inertial unit from an imported log of both, by the filter of a campaign.

A row is what one of them sent, with the time when the logger received it and the unit's own stamp; the columns of the
other unit are empty. Units that stamp evenly are counted by their stamps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bench.analysis import Analysis, Material
from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError
from bench.systems.time_sync.analysis import analysis_of
from bench.systems.time_sync.filtering import METHODS
from bench.systems.time_sync.records import EGI, NS, Recording, Stream, check_clock
from bench.systems.time_sync.wording import say

_FEWEST = 200  # rows of either unit
_NAVIGATING = 3.0
_IMU = ("delta_angle", "delta_velocity")


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return the offset of the EGI's clock by all filters; ``method`` says which one is judged.

    Raises: FitError B-SYNC-003, -004, -006 to -009, -011; B-SYNC-014 (too few rows).
    """
    analysis = analysis_of("egi_offset", _recording(material), material, method)
    convention = say(f"note.rates.{material.campaign.get('rates', 'increments')}")
    return replace(analysis, notes=[convention, *analysis.notes])


def _recording(material: Material) -> Recording:
    series, dimensions = material.series, {str(c["name"]): str(c["unit"]) for c in material.campaign["columns"]}
    imu = _stream(series, "imu_stamp", {name: _three(name, "xyz") for name in _IMU})
    vectors = {
        "velocity": _three("velocity", ("north", "east", "down")),
        "attitude": _three("attitude", ("roll", "pitch", "heading")),
    }
    single = {name: [name] for name in ("latitude", "longitude", "height", "position_sigma")}
    egi = _stream(series, "egi_stamp", vectors | single)
    step_s = float(np.median(np.diff(imu.tick_s)))
    for name, rate in (("delta_angle", "deg/s"), ("delta_velocity", "m/s2")):
        column = imu.columns[name]  # changed in place: nobody else has it yet
        if dimensions[f"{name}_x"] == rate:
            column *= step_s
            if material.campaign.get("rates") == "instant":
                column += 0.5 * (_before(imu.counter, column) - column)
    imu.columns["delta_angle"][:] = np.radians(imu.columns["delta_angle"])
    first_s = float(imu.tick_s[0])
    for stream in (imu, egi):
        stream.tick_s[:] -= first_s
    for name, stream in (("imu", imu), (EGI, egi)):
        check_clock(name, stream)
    return Recording(imu, egi, None, "")


def _before(counter: Integers, values: Floats) -> Floats:
    """Return what values (n, 3) were a sample earlier, between their neighbours where that one is lost.

    The mean over an interval is that of both ends, to second order.
    """
    return np.stack([np.interp(counter - 1, counter, column) for column in values.T], axis=1)


def _three(name: str, axes: Sequence[str]) -> list[str]:
    return [f"{name}_{axis}" for axis in axes]


def _stream(series: Mapping[str, Floats], stamp: str, columns: Mapping[str, Sequence[str]]) -> Stream:
    """Return whole rows of one unit, counted by its stamps."""
    names = [stamp, *(name for parts in columns.values() for name in parts)]
    sent = np.isfinite(np.column_stack([series[name] for name in names])).all(axis=1)
    if np.count_nonzero(sent) < _FEWEST:
        raise FitError(
            "B-SYNC-014",
            f"{int(np.count_nonzero(sent))} rows of the log hold {', '.join(names)}, {_FEWEST} are the least",
            next_step="write all columns of a unit into each of its rows (docs/importing.md)",
        )
    tick_s = series[stamp][sent].copy()
    steps = np.diff(tick_s)
    counted = np.maximum(np.rint(steps / np.median(steps)), 1.0) if np.median(steps) > 0.0 else np.ones(steps.size)
    counter = np.concatenate(([0], np.cumsum(counted.astype(np.int64))))
    held = {name: np.column_stack([series[part][sent] for part in parts]) for name, parts in columns.items()}
    held = {name: column if len(columns[name]) > 1 else column[:, 0] for name, column in held.items()}
    held |= {"status": np.zeros(tick_s.size), "mode": np.full(tick_s.size, _NAVIGATING)}
    return Stream(tick_s, counter, np.rint(series["t_s"][sent] / NS).astype(np.int64), held)
