"""Kinds of steps: one function per kind, and the dispatch at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from bench.model.clock import NS, to_ns
from bench.model.errors import LinkError, RunError
from bench.model.events import Answer, Overrun, Slip
from bench.model.quantities import QUANTITY
from bench.plan import (
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
from bench.run.context import RunContext
from bench.run.control.operator import Question, answered, judge, within
from bench.run.links.reader import LinkReader, UnitAnswer
from bench.run.links.unit import DONE, IDENTIFY
from bench.run.steps.deciding import decide
from bench.run.steps.exchange import ATTEMPTS, exchange, timeout_of
from bench.run.steps.proof import check_identity
from bench.run.steps.recording import act, call_or_flag, reading_of, take_record
from bench.run.steps.soak import soak

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
