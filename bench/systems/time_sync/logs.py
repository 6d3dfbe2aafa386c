"""Time offset of two streams in one imported log, from the motion that both saw (docs/importing.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis import (
    Analysis,
    Document,
    Evidence,
    Figure,
    Material,
    Table,
    curve,
    estimate,
    value_and_uncertainty,
)
from bench.maths.arrays import Floats
from bench.maths.tests import t_both
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.model.units import with_prefix
from bench.systems.time_sync.estimators.common_motion import CommonMotion, common_motion
from bench.systems.time_sync.wording import say

METHODS = ("common_motion",)
_STREAMS = ("one", "other")
_RIVAL = 0.95  # of the correlation: another shift that fits nearly as well
_NEAR_s = 5.0  # clocks that are further apart are first brought near each other, in whole seconds


def analyse(material: Material, method: str = METHODS[0]) -> Analysis:
    """Return the offset of the clock of stream ``one`` against that of ``other``.

    Raises: FitError B-SYNC-012 if the streams show no common motion.
    """
    streams, coarse_s = _streams(material)
    found = common_motion(*streams["one"], *streams["other"])
    counted = {"n": found.samples, "dof": found.dof}
    place = {"method": method}
    entries = [
        estimate("time_offset", "s", coarse_s + found.offset_s, found.std_s, place, **counted),
        estimate("correlation", "1", found.correlation, 0.0, place, n=found.samples),
    ]
    return Analysis(
        "stream_offset",
        method,
        material.campaign["uut"],
        entries,
        evidence=_evidence(found),
        notes=[say("note.streams"), say("note.blocks")],
        tables=[_table(found, coarse_s)],
        figures=_figures(found, material),
    )


def _streams(material: Material) -> tuple[Mapping[str, tuple[Floats, Floats]], float]:
    """Return stamps and signals of each stream, and whole seconds taken out of the stamps of the first one."""
    columns = material.campaign.get("columns", ())
    row_s = material.series.get("t_s", np.empty(0))
    taken, apart_s = {}, []
    for stream in _STREAMS:
        of_it = [column for column in columns if column.get("stream") == stream]
        signals = _signals(material, stream)
        if not signals:
            raise FitError(
                "B-SYNC-012",
                f"the log holds no motion of the stream {stream!r}",
                next_step="map a column of the role motion of each stream (docs/importing.md)",
            )
        stamp = next((column["name"] for column in of_it if column["role"] == "stamp"), "t_s")
        values = np.column_stack([material.series[str(column["name"])] for column in signals])
        sent = np.isfinite(values).all(axis=1) & np.isfinite(material.series[stamp])
        stamps_s, first = np.unique(material.series[stamp][sent], return_index=True)
        taken[stream] = stamps_s, values[sent][first]
        apart_s.append(float(np.median((material.series[stamp] - row_s)[sent])) if sent.any() else 0.0)
    coarse_s = apart_s[0] - apart_s[1]
    coarse_s = float(round(coarse_s)) if abs(coarse_s) > _NEAR_s else 0.0
    return {"one": (taken["one"][0] - coarse_s, taken["one"][1]), "other": taken["other"]}, coarse_s


def _signals(material: Material, stream: str) -> list[Document]:
    """Return the columns with motions of a stream, in the order that both streams have them in."""
    motions = (column for column in material.campaign.get("columns", ()) if column["role"] == "motion")
    return sorted((column for column in motions if column["stream"] == stream), key=lambda column: column["of"])


def _evidence(found: CommonMotion) -> list[Evidence]:
    """Return what speaks against one offset: another shift that fits as well, halves that differ."""
    seen = []
    if found.rival > _RIVAL:
        text = say("evidence.repeats", shift=found.rival_s, share=100 * found.rival)
        seen.append(Evidence("motion_repeats", text, found.rival, 0.0))
    step_s = float(found.halves_s[1] - found.halves_s[0])
    std_s = math.hypot(*found.halves_std_s.tolist())
    score = abs(step_s) / max(std_s, np.finfo(float).tiny)
    probability = t_both(score, found.dof)
    move = 0.5 * abs(step_s) / max(coverage_factor(found.dof) * found.std_s, np.finfo(float).tiny)
    text = say("evidence.changes", step=1e3 * step_s, score=score)
    return [*seen, Evidence("offset_changes", text, score, probability, move, ("time_offset",))]


def _table(found: CommonMotion, coarse_s: float) -> Table:
    factor = coverage_factor(found.dof)
    parts = [(say("streams.whole"), found.offset_s, found.std_s)]
    parts += zip(
        (say("streams.first_half"), say("streams.second_half")),
        found.halves_s.tolist(),
        found.halves_std_s.tolist(),
        strict=True,
    )
    scale, unit = with_prefix(max(abs(coarse_s + found.offset_s), factor * found.std_s), "s")
    rows: list[list[Any]] = [
        [name, *value_and_uncertainty(scale * (coarse_s + value), scale * factor * std)] for name, value, std in parts
    ]
    headers = say.heads("streams", "part", "offset", "U", unit=unit)
    caption = say("streams.caption", correlation=found.correlation)
    return Table(say("result.title"), caption, headers, rows, lead=True)


def _figures(found: CommonMotion, material: Material) -> list[Figure]:
    since_s = found.t_s - found.t_s[0]
    parts = [
        curve(say("motion.other"), since_s, found.motion_other[:, 0]),
        curve(say("motion.one"), since_s, found.motion_one[:, 0]),
    ]
    left = [curve(say("motion.left"), since_s, found.left[:, 0])]
    axes = say("motion.x"), say("motion.y", unit=_signals(material, "other")[0]["unit"])
    return [
        Figure(say("motion.title"), say("motion.caption"), *axes, parts),
        Figure(say("motion.left_title"), "", *axes, left),
    ]
