"""The step that decides by a reading: which branch is done, or that the run holds, or ends.

What a stop rule goes by: the scatter of the records of a first stage, and how many more the point needs by it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from statistics import stdev
from typing import Any

from bench.maths.stein import LEAST_FIRST, needed
from bench.model.errors import RunError
from bench.model.events import DECISION, Decision
from bench.model.installed import named
from bench.model.stopping import UNTIL, Point
from bench.model.systems import declared_by
from bench.plan import FAIL, HOLD, PlannedDecision
from bench.record import RecordRow
from bench.run.context import RunContext
from bench.run.steps.decided import Read
from bench.run.stop import Interruption, Wish


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


def decide(context: RunContext, step: PlannedDecision) -> None:
    """Decide once: what the session holds already is not decided again, though the reading may be another by now.

    Raises: RunError B-RUN-073 if the sequence says so; Interruption if the run is to stand still.
    """
    if step.number in context.decided.outcomes:
        return
    if step.word == UNTIL:
        more, readings = looked_at(first_stage(context, step), step, context.plan.campaign)
        context.event(Decision(step=step.number, word=step.word, readings=readings, outcome=step.outcome(more)))
        return
    read = context.decided.newest(step)
    outcome = step.outcome(None if read is None else read.value)
    if outcome == FAIL:
        raise RunError("B-RUN-073", _why(step, read), where=step.where, next_step=_NEXT)
    if outcome == HOLD:
        reason = _why(step, read)
        context.stop.holds.hold(DECISION, reason)
        raise Interruption(Wish("hold", DECISION, reason))
    readings = [] if read is None else [_reading(step, read)]
    context.event(Decision(step=step.number, word=step.word, readings=readings, outcome=outcome))


_NEXT = (
    "look why the reading did not come to what the sequence waits for; 'bench resume SESSION' reads and decides again"
)


def _why(step: PlannedDecision, read: Read | None) -> str:
    """Return why no branch can be taken: the reading is missing, or a loop has had all of its turns."""
    if read is None:
        return f"{step.reading} was never read, so nothing can be decided by it"
    if read.value is None:
        return f"{step.reading} gave no value at step {read.step}, so nothing can be decided by it"
    return "{reading} is {newest} after the last turn, still {comparison} {limits}".format(**step.still(read.value))


def _reading(step: PlannedDecision, read: Read) -> dict[str, object]:
    name = f"{step.role}.{step.name}" if step.role else step.name
    asked = {"arguments": dict(step.arguments)} if step.arguments else {}
    return {"name": name, **asked, "value": read.value, "unit": step.unit, "step": read.step}
