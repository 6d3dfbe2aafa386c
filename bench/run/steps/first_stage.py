"""What a stop rule goes by: the scatter of the records of a first stage, and how many more the point needs by it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from statistics import stdev
from typing import Any

from bench.maths.stein import LEAST_FIRST, needed
from bench.model.stopping import Point
from bench.model.systems import declared_by, named
from bench.plan import PlannedDecision
from bench.record import RecordRow
from bench.run.context import RunContext


def first_stage(context: RunContext, step: PlannedDecision) -> list[RecordRow]:
    """Return the records that a stop rule goes by: those of the first stage, the last that were taken."""
    rows = []
    for number in range(context.record_count, 0, -1):
        row = context.rows.get(number)
        if row is None or row.window.step not in step.arguments["first"]:
            break
        rows.append(row)
    return rows


def looked_at(
    rows: Iterable[RecordRow], step: PlannedDecision, campaign: Mapping[str, Any]
) -> tuple[float | None, list[dict[str, Any]]]:
    """Return how many more records a point needs by those of its first stage, and the readings that say so.

    None and nothing where so many of them do not count that the rest says too little.
    """
    declared = declared_by(campaign)
    assert declared is not None  # it was when the plan was made
    point: Point = named(declared.point)
    asked, means = step.arguments, [mean for row in rows if math.isfinite(mean := point.mean(row, campaign))]
    if len(means) < LEAST_FIRST:
        return None, []
    due = max(asked["least"], needed(means, asked["target"]))
    last = max(asked["first"])
    return float(due - len(means)), [
        {"name": "scatter", "value": stdev(means), "unit": point.UNIT, "step": last},
        {"name": "records_due", "value": due, "unit": "1", "step": last},
    ]
