"""Edges of a dithered ring laser from an imported log: the lock-in and its compensation, as of a recorded campaign.

A row is an edge of one comparator, with its time: the beat's, whose row has the level of the cosine as well, or that of
the dither pick-off. The other columns of a row are empty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bench.analysis import Analysis, Floats, Material
from bench.model.errors import FitError
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow
from bench.systems.lock_in.analysis import METHODS, analysis_of
from bench.systems.lock_in.records import Events, LaserRecord, Stretch, step_ticks
from bench.systems.lock_in.result import laser_result, requirement_of

_STAMP_Hz = 1_000_000_000  # times of rows are whole nanoseconds


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return every compensator over the log; ``method`` says whose alignment time is judged.

    Raises: FitError B-RLG-009 (rows that are no edges), B-RLG-007 (too few of them).
    """
    laser = material.campaign["laser"]
    requirement = requirement_of({"site": {"latitude_deg": laser["latitude_deg"]}})
    events, row = _events(material.series), RecordRow(RecordWindow(1, "", 0, 0, 0, 0), {}, 0, 0, 0, Quality.GOOD)
    record = LaserRecord(row, lambda: events, float(laser["path_length_m"]), None)
    return analysis_of("rlg_edge_log", material, [laser_result(record)], [], requirement, method)


def _events(series: Mapping[str, Floats]) -> Events:
    """Return the edges as one stretch; its clock is as fast as the steps that all time stamps are multiples of."""
    ticks = np.rint(series["t_s"] * _STAMP_Hz).astype(np.int64)
    beat, cosine, pickoff = (series[name] for name in ("beat", "cosine", "pickoff"))
    of_beat, of_pickoff = np.isfinite(beat), np.isfinite(pickoff)
    told = np.where(of_beat, np.isfinite(cosine) & ~of_pickoff, of_pickoff)
    level = np.isin(np.where(of_beat, beat, pickoff), (0.0, 1.0)) & (~of_beat | np.isin(cosine, (0.0, 1.0)))
    wrong = np.flatnonzero(~(told & level))
    if wrong.size:
        raise FitError(
            "B-RLG-009",
            f"{wrong.size} of {ticks.size} rows are no edges, row {int(wrong[0]) + 1} first: beat {beat[wrong[0]]:g}, "
            f"cosine {cosine[wrong[0]]:g}, pick-off {pickoff[wrong[0]]:g}",
            next_step="write 0 or 1 in beat and cosine, or in the pick-off alone (docs/importing.md)",
        )
    edges = Stretch(
        begin_tick=0,
        ticks=ticks[of_beat],
        rising=beat[of_beat] > 0.0,
        cosine=cosine[of_beat] > 0.0,
        pickoff_ticks=ticks[of_pickoff],
        pickoff_rising=pickoff[of_pickoff] > 0.0,
    )
    step = step_ticks((edges,))
    even = replace(edges, ticks=edges.ticks // step, pickoff_ticks=edges.pickoff_ticks // step)
    return Events(_STAMP_Hz / step, (even,), lost_blocks=0, lost_edges=0, torn=0)
