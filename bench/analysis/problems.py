"""Why a record may not enter any estimate, and whether the links of a run are well: what was noted, lost or damaged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis.wording import say
from bench.model.quantities import Quality

if TYPE_CHECKING:
    from bench.record import RecordRow

_LINK_FLAGS = Quality.LOST | Quality.BAD_FRAMES | Quality.DUPLICATE
_NO_PROBLEM = int(_LINK_FLAGS | Quality.STALE)
_MOST_LOST = 1e-3  # of the frames of a record; a few lost frames take their share of counts and of the gate with them
_NEEDED_CLOCKS = ("af_clock", "master_count")
_COUNTS = {"npp", "ppp"}


def flag_problem(row: RecordRow) -> str:
    """Return what is wrong with a record whatever it holds, "" if nothing is."""
    if not row.quality & ~_NO_PROBLEM:
        return ""
    flags = Quality(row.quality) & ~_LINK_FLAGS & ~Quality.STALE
    return ", ".join(str(flag.name).lower().replace("_", " ") for flag in flags)


def count_problem(row: RecordRow) -> str:
    """Return why the counts of a record may not enter an estimate, "" if they may.

    Rates are taken over the frames that did arrive, so a loss of up to 0.1 % costs resolution, not truth.
    """
    if problem := flag_problem(row):
        return problem
    if row.lost > _MOST_LOST * row.window.frames:
        return say("problem.frames_lost")
    complete = all(_counted(row.sums.get(name, 0)) for name in _NEEDED_CLOCKS) and row.sums.keys() >= _COUNTS
    return "" if complete else say("problem.no_clock_counts")


def _counted(value: Any) -> bool:
    """Return whether any count is not zero; a clock is one number as a rule."""
    return bool(value.any() if isinstance(value, np.ndarray) else value)


@dataclass(frozen=True)
class Check:
    """One verdict: ``ok`` None if there is too little to judge yet."""

    name: str
    ok: bool | None
    value: float | None
    limit: float
    text: str


def link_checks(counts: Mapping[str, int], max_lost: float, max_bad: float) -> list[Check]:
    """Return share of the frames of all links that are missing, and that are damaged.

    Where a counter jumped by more than it can tell, nobody knows whether few enough are missing.
    """
    jumps = counts.get("jumps", 0)
    due = counts["frames"] + counts["frames_lost"]
    shares = (("frames lost", "frames_lost", max_lost, due), ("frames damaged", "frames_bad", max_bad, due))
    checks = []
    for name, key, limit, of in shares:
        share = counts[key] / of if of else None
        text, ok = f"{counts[key]} of {of} frames", None if share is None else share <= limit
        if jumps and key == "frames_lost":
            text, ok = f"{text}, and {jumps} jumps of unknown size of the counter", False if ok is False else None
        checks.append(Check(name, ok, share, limit, text))
    return checks
