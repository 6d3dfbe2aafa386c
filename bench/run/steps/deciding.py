"""The step that decides by a reading: which branch is done, or that the run holds, or ends."""

from __future__ import annotations

from bench.model.errors import RunError
from bench.model.events import DECISION, Decision
from bench.model.stopping import UNTIL
from bench.plan import FAIL, HOLD, PlannedDecision
from bench.run.context import RunContext
from bench.run.steps.decided import Read
from bench.run.steps.first_stage import first_stage, looked_at
from bench.run.stop import Interruption, Wish


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
