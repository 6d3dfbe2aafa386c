"""Early verdicts that hold for every session: the frames of all links."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One verdict: ``ok`` None if there is too little to judge yet."""

    name: str
    ok: bool | None
    value: float | None
    limit: float
    text: str


def link_checks(counts: Mapping[str, int], max_lost: float, max_bad: float) -> list[Check]:
    """Share of the frames of all links that are missing, and that are damaged."""
    due = counts["frames"] + counts["frames_lost"]
    shares = (("frames lost", "frames_lost", max_lost, due), ("frames damaged", "frames_bad", max_bad, due))
    found = []
    for name, key, limit, of in shares:
        share = counts[key] / of if of else None
        ok = None if share is None else share <= limit
        found.append(Check(name, ok, share, limit, f"{counts[key]} of {of} frames"))
    return found
