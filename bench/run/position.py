"""Where a run goes on after it was interrupted: a position is a number in the plan's list of steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.plan import Step
from bench.record import RecordRow


@dataclass(frozen=True)
class Resumption:
    """A session that is gone on with: from step ``start``, with the records it holds already.

    ``manifest`` is the session's; ``fields`` go into its "resume" event.
    """

    folder: Path
    manifest: Mapping[str, Any]
    start: int
    rows: Mapping[int, RecordRow] = field(default_factory=dict)
    fields: Mapping[str, Any] = field(default_factory=dict)


def point_start(steps: Sequence[Step], index: int) -> int:
    """Index of the first step of the point that holds ``steps[index]``: where its relays and level are set.

    The step itself if it belongs to no point, or to records that follow each other without a gap.
    """
    record = _record_of(steps, index)
    if record is None or steps[record].arguments.get("follows"):
        return index
    first = max(0, int(steps[record].arguments["retry_step"]) - steps[0].number)
    if first > index or any(step.kind == "soak" for step in steps[first : index + 1]):
        return index
    return first


def point_stop(steps: Sequence[Step], index: int) -> int:
    """Index behind the last step of the point that holds ``steps[index]``: its record and what verifies it."""
    record = _record_of(steps, index)
    stop = index if record is None else max(record, index)
    while stop + 1 < len(steps) and steps[stop + 1].kind == "verify":
        stop += 1
    return stop + 1


def _record_of(steps: Sequence[Step], index: int) -> int | None:
    """Index of the record of a point: the one that a verify step follows, else the next one before any soak."""
    at = index
    while at > 0 and steps[at].kind == "verify":
        at -= 1
    for later in range(at, len(steps)):
        if steps[later].kind == "record":
            return later
        if steps[later].kind in ("soak", "prompt"):
            return None
    return None
