"""What each kind of step does. One function per kind; the table at the end is the whole dispatch."""

from __future__ import annotations

from collections.abc import Callable

from bench.model.clock import NS, to_ns
from bench.model.errors import LinkError, RunError
from bench.plan import Step
from bench.run.context import RunContext
from bench.run.control.operator import Question, answer_fields, judge
from bench.run.links.reader import LinkReader, UnitAnswer
from bench.run.steps.exchange import ATTEMPTS, TIMEOUT_S, exchange
from bench.run.steps.readings import act, call_or_flag
from bench.run.steps.recording import take_record
from bench.run.steps.soak import soak

ANSWER_S = 2.0
PROMPT_SLIP_NS = NS  # a person takes longer; the simulated one takes no time
DONE = 0  # status of an answer


def call(context: RunContext, step: Step) -> None:
    """Call a declared action of an instrument; its reading, if any, becomes an event."""
    call_or_flag(context, step)


def verify(context: RunContext, step: Step) -> None:
    """The action must return True; otherwise the record before it is not valid. Raises: RunError B-RUN-030."""
    if act(context, step) is not True:
        raise RunError(
            "B-RUN-030",
            f"{step.name} is not true after the dwell",
            where=step.role,
            next_step="look for a trip in the transcript of the instrument, then start again",
        )


def settle(context: RunContext, step: Step) -> None:
    """Wait for the planned end of the settle time, but never less than the plan leaves after its bus calls."""
    end_s = step.at_s + step.duration_s
    rest_ns = to_ns(max(0.0, step.duration_s - float(step.arguments.get("bus_s", 0.0))))
    overrun_ns = context.clock.now_ns() + rest_ns - context.timeline.target_ns(end_s)
    if overrun_ns > 0:
        context.timeline.add_slip(overrun_ns)
        context.overruns += 1
        context.event("overrun", step=step.number, seconds=overrun_ns / NS)
    context.timeline.wait_until(end_s)


def record(context: RunContext, step: Step) -> None:
    """Take a record."""
    take_record(context, step)


def prompt(context: RunContext, step: Step) -> None:
    """Ask the operator; the answer is recorded and judged, and a simulated bench is changed as the person did it."""
    arguments = step.arguments
    question = Question(
        str(arguments["text"]),
        str(arguments.get("confirm", "operator")),
        str(arguments.get("unit", "")),
        arguments.get("low"),
        arguments.get("high"),
    )
    asked_ns = context.clock.now_ns()
    with context.stop.at_once():
        answer = context.operator.ask(question)
    waited_ns = context.clock.now_ns() - asked_ns
    if waited_ns > PROMPT_SLIP_NS:
        context.timeline.add_slip(waited_ns)
        context.event("slip", step=step.number, seconds=waited_ns / NS, reason="prompt")
    changes = dict(arguments.get("sets", {}))
    told = {"sets": changes} if changes else {}
    context.event("prompt", step=step.number, **answer_fields(question, answer), **told)
    judge(question, answer, step.where)
    for name, value in changes.items():
        context.operate(name, value)


def send(context: RunContext, step: Step) -> None:
    """Send a raw command of the flat timeline; a query's reply is recorded."""
    with context.in_use.take(step.role):
        context.instruments[step.role].raw(str(step.arguments["text"]))  # type: ignore[attr-defined]


def unit(context: RunContext, step: Step) -> None:
    """Send a command to the unit under test and wait for its answer; what a test of it gives is judged later.

    Raises: LinkError B-RUN-022 (no answer to this command), B-RUN-023 (the answer is a refusal); see ``exchange``.
    """
    reader, number = context.acquisition.readers[step.role], int(step.arguments["command"])
    if reader.numbered:
        found = exchange(context, step).answer
        waited = f"{ATTEMPTS} times {float(step.arguments.get('timeout', TIMEOUT_S)):g} s"
    else:
        found, waited = _answer_of(context, step, reader), f"{ANSWER_S:g} s"
    if "item" in step.arguments:
        return
    if found is None:
        raise LinkError(
            "B-RUN-022",
            f"the unit did not answer '{step.name}' within {waited}",
            where=step.role,
            next_step="check supply and cable of the unit, then start again",
        )
    status, payload = found.status, found.payload.hex()
    context.event("answer", step=step.number, role=step.role, name=step.name, status=status, payload=payload)
    if status != DONE or found.refused:
        raise LinkError(
            "B-RUN-023",
            f"the unit refused '{step.name}' with status {status}",
            where=step.role,
            next_step=f"check its code {number} and payload in the sequence against the unit's manual",
        )


def _answer_of(context: RunContext, step: Step, reader: LinkReader) -> UnitAnswer | None:
    """The answer of a unit whose commands carry no number: the first one to a command of this code."""
    number = int(step.arguments["command"])
    with context.acquisition.lock:
        context.acquisition.refresh()  # an answer that is there already belongs to somebody else's command
        reader.answers.clear()
        reader.write(reader.command(step.arguments))
    deadline = context.clock.now_ns() + to_ns(ANSWER_S)
    context.acquisition.wait_until(lambda: any(found.command == number for found in reader.answers), deadline)
    return next((found for found in reader.answers if found.command == number), None)


EXECUTORS: dict[str, Callable[[RunContext, Step], object]] = {
    "call": call,
    "verify": verify,
    "settle": settle,
    "record": record,
    "soak": soak,
    "prompt": prompt,
    "send": send,
    "unit": unit,
}
