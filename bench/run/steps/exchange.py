"""Commands and answers over a link whose frames carry a sequence number.

An answer belongs to a command if it has its sequence number and its code. A command that is not answered in time is
sent again with the same number: the unit answers a number that it has answered last from its memory, so nothing is
done twice, whichever of the two frames was lost. A refusal and a status other than done are answers: nothing is sent
again because of them.

The first command of a run is preceded by an ``identify`` whose answer counts for nothing. The number that the unit has
answered last is not known then; behind it, it is, and the next one differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.frame import FrameDefinition
from bench.model.clock import NS, to_ns
from bench.model.errors import LinkError
from bench.model.events import Exchange
from bench.plan import PlannedCommand
from bench.run.context import RunContext
from bench.run.links.reader import LinkReader, UnitAnswer
from bench.run.links.unit import IDENTIFY

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
