"""Kinds of steps: one function per kind, and the dispatch at the end.

A command over a link whose frames carry a sequence number is answered if the answer has its number and its code. One
that is not answered in time is sent again with the same number: the unit answers a number that it has answered last
from its memory, so nothing is done twice, whichever of the two frames was lost. A refusal and a status other than done
are answers: nothing is sent again because of them.

The first command of a run is preceded by an ``identify`` whose answer counts for nothing. The number that the unit has
answered last is not known then; behind it, it is, and the next one differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import stdev
from typing import Any

from bench.frame import FrameDefinition
from bench.maths.stein import LEAST_FIRST, needed
from bench.model.clock import NS, to_ns
from bench.model.errors import LinkError, RunError
from bench.model.events import DECISION, Answer, Decision, Exchange, Overrun, Slip
from bench.model.installed import named
from bench.model.quantities import QUANTITY
from bench.model.stopping import UNTIL, Point
from bench.model.systems import declared_by
from bench.plan import (
    FAIL,
    HOLD,
    KINDS,
    PlannedCall,
    PlannedCommand,
    PlannedDecision,
    PlannedPrompt,
    PlannedRecord,
    PlannedSend,
    PlannedSettle,
    PlannedSoak,
    PlannedVerify,
    Step,
)
from bench.record import RecordRow
from bench.run.bus.reader import LinkReader, UnitAnswer
from bench.run.context import Read, RunContext
from bench.run.links.unit import DONE, IDENTIFY, check_identity
from bench.run.operator import Question, answered, judge, within
from bench.run.steps.recording import act, call_or_flag, reading_of, take_record
from bench.run.steps.soak import soak
from bench.run.stop import Interruption, Wish

ATTEMPTS = 3
TIMEOUT_S = 0.2  # of a command for which neither step nor frame definition says more
_SOON_NS = NS // 20  # most answers come within this time
_OFTEN_S, _SELDOM_S = 0.002, 0.01  # between two looks, before and after it


@dataclass(frozen=True)
class Exchanged:
    """A command and what came back. ``answer`` is None if nobody answered; ``ignored``: answers to other commands."""

    sequence: int
    attempts: int
    begin_ns: int
    end_ns: int
    answer: UnitAnswer | None
    ignored: int


def exchange(context: RunContext, step: PlannedCommand) -> Exchanged:
    """Send the command of a step and wait for its answer; both become an event ``exchange``.

    A stop is obeyed while waiting. A hold waits until the answer is there, because the unit may do already what it was
    told; only a link that is lost lets the run stand still in between, and the step is then done again under the same
    number. If another command was sent meanwhile the unit may not know that number any more: a test is then noted as
    not answered, because it is not done twice; any other command is sent under a new number.

    Raises: LinkError B-RUN-020, B-RUN-024; OperatorStop; Interruption; the fault of another thread.
    """
    reader = context.acquisition.readers[step.role]
    try:
        with context.stop.deferring():
            _open(context, reader)
            if step.item and reader.numbers.overtaken(step.number):
                done = _given_up(context, reader, step)
            else:
                number = reader.numbers.of_step(step.number)
                if step.name == IDENTIFY and not step.item:
                    reader.numbers.ask(number)
                done = _exchanged(context, reader, number, step.code, step.payload, timeout_of(step))
    except LinkError:
        context.stop.check()
        raise
    if done.answer is None:
        context.stop.check()  # nobody could answer on a link that is lost
    reader.numbers.settled()
    context.event(_event_of(step, done))
    return done


def _given_up(context: RunContext, reader: LinkReader, step: PlannedCommand) -> Exchanged:
    context.message(f"{step.role}: '{step.name}' may be done already and is not sent again; it has no answer")
    now_ns = context.clock.now_ns()
    return Exchanged(reader.numbers.last, 1, now_ns, now_ns, None, 0)


def _open(context: RunContext, reader: LinkReader) -> None:
    """Have the unit answer a number that is known, once in a run."""
    code = code_of(reader.definition, IDENTIFY)
    if reader.numbers.opened or code is None:
        return
    done = _exchanged(context, reader, reader.numbers.last, code, (), TIMEOUT_S)
    reader.numbers.opened = done.answer is not None


def timeout_of(step: PlannedCommand) -> float:
    """Return how long the answer to one sending may take, second."""
    return TIMEOUT_S if step.timeout_s is None else step.timeout_s


def _exchanged(
    context: RunContext, reader: LinkReader, number: int, code: int, payload: Sequence[int], timeout_s: float
) -> Exchanged:
    acquisition, frame = context.acquisition, reader.command(code, payload, number)
    with acquisition.lock:
        acquisition.refresh()  # an answer that is there already belongs to somebody else's command
        ignored = len(reader.answers)
        reader.answers.clear()
    begin_ns = context.clock.now_ns()
    answer, attempts = None, 0
    while answer is None and attempts < ATTEMPTS:
        attempts += 1
        reader.write(frame)
        answer = _awaited(context, reader, (number, code), context.clock.now_ns() + to_ns(timeout_s))
    with acquisition.lock:
        ignored += len(reader.answers) - (answer is not None)
        reader.answers.clear()
    return Exchanged(number, attempts, begin_ns, context.clock.now_ns(), answer, ignored)


def _awaited(context: RunContext, reader: LinkReader, due: tuple[int, int], until_ns: int) -> UnitAnswer | None:
    """Return the answer with this number and code; None if there is none in time."""

    def found() -> UnitAnswer | None:
        return next((answer for answer in reader.answers if (answer.sequence, answer.command) == due), None)

    soon_ns = min(until_ns, context.clock.now_ns() + _SOON_NS)
    wait = context.acquisition.wait_until
    if wait(lambda: found() is not None, soon_ns, _OFTEN_S) or soon_ns < until_ns:
        wait(lambda: found() is not None, until_ns, _SELDOM_S)
    with context.acquisition.lock:
        return found()


def _event_of(step: PlannedCommand, done: Exchanged) -> Exchange:
    answer = done.answer
    return Exchange(
        step=step.number,
        item=step.item,
        name=step.name,
        role=step.role,
        sequence=done.sequence,
        attempts=done.attempts,
        begin_ns=done.begin_ns,
        end_ns=done.end_ns,
        status=None if answer is None else answer.status,
        refused=answer is not None and answer.refused,
        sent=bytes(step.payload).hex(),
        received="" if answer is None else answer.payload.hex(),
        ignored=done.ignored,
        conditions=dict(step.conditions),
    )


def code_of(definition: FrameDefinition, name: str) -> int | None:
    """Return code of a command of a frame definition; None if it has no such command."""
    layout = definition.commands.get(name)
    return None if layout is None else layout.code


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


ANSWER_S = 2.0
PROMPT_SLIP_NS = NS  # a person takes longer; the simulated one takes no time


def _verify(context: RunContext, step: PlannedVerify) -> None:
    """Call an action that must return True; otherwise the record before is not valid. Raises: RunError B-RUN-030."""
    if act(context, step) is not True:
        raise RunError(
            "B-RUN-030",
            f"{step.name} is not true after the dwell",
            where=step.role,
            next_step="look for a trip in the transcript of the instrument, then start again",
        )


def _settle(context: RunContext, step: PlannedSettle) -> None:
    """Wait for the planned end of the settle time, but never less than the plan leaves after its bus calls."""
    end_s = step.at_s + step.duration_s
    rest_ns = to_ns(max(0.0, step.duration_s - step.bus_s))
    overrun_ns = context.clock.now_ns() + rest_ns - context.timeline.target_ns(end_s)
    if overrun_ns > 0:
        context.timeline.add_slip(overrun_ns)
        context.overruns += 1
        context.event(Overrun(step=step.number, seconds=overrun_ns / NS))
    context.timeline.wait_until(end_s)


def _prompt(context: RunContext, step: PlannedPrompt) -> None:
    """Ask the operator; the answer is recorded and judged, and a simulated bench is changed as the person did it."""
    question = Question(step.text, step.confirm, step.unit, step.low, step.high, step.quantity, step.presence)
    asked_ns = context.clock.now_ns()
    with context.stop.at_once():
        answer = context.operator.ask(question)
    waited_ns = context.clock.now_ns() - asked_ns
    if waited_ns > PROMPT_SLIP_NS:
        context.timeline.add_slip(waited_ns)
        context.event(Slip(step=step.number, seconds=waited_ns / NS, reason="prompt"))
    context.event(answered(question, answer, step, dict(step.sets)))
    judge(question, answer, step.where)
    if step.required and not within(question, answer.value):
        context.failed.add(step.number)
    for name, value in step.sets.items():
        context.operate(name, value)


def _send(context: RunContext, step: PlannedSend) -> None:
    """Send a raw command; a query's reply is recorded."""
    with context.in_use.take(step.role):
        reply = context.instruments[step.role].raw(step.text)  # type: ignore[attr-defined]
    _keep_reply(context, step, reply)


def _keep_reply(context: RunContext, step: PlannedSend | PlannedCommand, reply: str | None) -> None:
    """A reply of which something is expected is a reading."""
    if QUANTITY in step.conditions:
        context.event(reading_of(step, reply))


def _command(context: RunContext, step: PlannedCommand) -> None:
    """Send a command to the unit under test and wait for its answer; what a test of it gives is judged later.

    Raises: LinkError B-RUN-022 (no answer to this command), B-RUN-023 (the answer is a refusal); see ``exchange``.
    """
    reader = context.acquisition.readers[step.role]
    if reader.numbered:
        answer = exchange(context, step).answer
        waited = f"{ATTEMPTS} times {timeout_of(step):g} s"
    else:
        answer, waited = _answer_of(context, step, reader), f"{ANSWER_S:g} s"
    if step.item:
        return
    if answer is None:
        raise LinkError(
            "B-RUN-022",
            f"the unit did not answer '{step.name}' within {waited}",
            where=step.role,
            next_step="check supply and cable of the unit, then start again",
        )
    status, payload = answer.status, answer.payload.hex()
    context.event(Answer(step=step.number, role=step.role, name=step.name, status=status, payload=payload))
    if status != DONE or answer.refused:
        raise LinkError(
            "B-RUN-023",
            f"the unit refused '{step.name}' with status {status}",
            where=step.role,
            next_step=f"check its code {step.code} and payload in the sequence against the unit's manual",
        )
    if step.name == IDENTIFY:
        check_identity(context.plan, step, answer.payload)
    _keep_reply(context, step, answer.payload.decode("ascii", "replace"))


def _answer_of(context: RunContext, step: PlannedCommand, reader: LinkReader) -> UnitAnswer | None:
    """Return the answer of a unit whose commands carry no number: the first one to a command of this code."""
    with context.acquisition.lock:
        context.acquisition.refresh()  # an answer that is there already belongs to somebody else's command
        reader.answers.clear()
        reader.write(reader.command(step.code, step.payload))
    deadline = context.clock.now_ns() + to_ns(ANSWER_S)
    context.acquisition.wait_until(lambda: any(answer.command == step.code for answer in reader.answers), deadline)
    return next((answer for answer in reader.answers if answer.command == step.code), None)


def _call(context: RunContext, step: PlannedCall) -> None:
    """Call an action; what it asks of the air is known from here on."""
    call_or_flag(context, step, dict(step.arguments) if QUANTITY in step.conditions else None)
    if step.set_point is not None:
        context.observers.set_point(step.set_point)


_DO: Mapping[type[Step], Callable[[RunContext, Any], object]] = {
    PlannedCall: _call,
    PlannedVerify: _verify,
    PlannedSend: _send,
    PlannedSettle: _settle,
    PlannedRecord: take_record,
    PlannedSoak: soak,
    PlannedPrompt: _prompt,
    PlannedCommand: _command,
    PlannedDecision: decide,
}
if undone := set(KINDS.values()) - set(_DO):
    raise TypeError(f"nobody does the kinds of step {undone}")


def execute(context: RunContext, step: Step) -> None:
    """Do one step of a plan."""
    _DO[type(step)](context, step)
