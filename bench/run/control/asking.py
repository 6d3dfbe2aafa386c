"""A question that several people may answer: at the terminal of the run, or from anywhere through its control socket.

Whoever gives the first answer that is inside the limits counts; a wrong one is told to who gave it, and may be given
again. What concerns hands, wiring, doors or mounting counts from the bench only. The sequencer waits here, gives its
sign of life, and hears a stop within ``POLL_S``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from bench.model.clock import NS
from bench.model.errors import BenchError, RunError
from bench.model.events import PromptAlarm
from bench.model.units import parse_quantity, plain_quantity, plain_unit
from bench.run.context import RunContext
from bench.run.operator import BENCH, Answer, Question, judge, limits_of

POLL_S = 0.25
YES = ("y", "yes")
LARGEST_VALUE = 1e15
AT_BENCH = "this is answered at the bench: at a terminal there, or on a page opened with the token of the bench"


class Terminal(Protocol):
    """The terminal a run was started from."""

    def ask(self, question: Question) -> None:
        """Show a question and how to answer it."""

    def line(self, timeout_s: float) -> str | None:
        """Return a typed line, None if none comes in time. Raises: OperatorStop for "stop"; OSError if it is gone."""

    def tell(self, text: str) -> None:
        """Say something about the question."""


class Refused(ValueError):
    """An answer that does not count; its text says why."""


@dataclass
class _Open:
    """The question that is asked now; ``answer`` once there is one."""

    id: str
    question: Question
    since_ns: int
    answer: Answer | None = None


class WaitingOperator:
    """Waits for an answer from anywhere. ``reachable``: the control socket of the run is there.

    Args: terminal: of the run; None if nobody sits there.
    """

    def __init__(self, terminal: Terminal | None) -> None:
        self._terminal = terminal
        self._lock = threading.Lock()
        self._open: _Open | None = None
        self._context: RunContext | None = None
        self._count = 0
        self.reachable = False

    def attach(self, context: RunContext) -> None:
        """The run whose questions these are."""
        self._context = context

    def ask(self, question: Question) -> Answer:
        """Wait until somebody has answered. Raises: OperatorStop; RunError B-CLI-005 if nobody ever could."""
        context = self._context
        if context is None or (self._terminal is None and not self.reachable):
            message = f"nobody is there to answer '{question.text}'"
            raise RunError("B-CLI-005", message, where="prompt", next_step="run from a terminal")
        self._count += 1
        asked = _Open(str(self._count), question, context.clock.now_ns())
        with self._lock:
            self._open = asked
        try:
            self._announce(context, asked)
            return self._wait(context, asked)
        finally:
            with self._lock:
                self._open = None

    def propose(self, prompt: str | None, value: object, by: str, place: str) -> str:
        """Take an answer that was given at a ``place``; return what the one who gave it is told. Raises: Refused."""
        with self._lock:
            asked = self._open
            if asked is None or prompt not in (None, asked.id):
                raise Refused("this is not asked, or not any more")
            if asked.answer is not None:
                raise Refused(f"answered already by {asked.answer.by}")
            if asked.question.presence == BENCH and place != BENCH:
                raise Refused(AT_BENCH)
            if asked.question.arms and (trouble := self._in_the_way()):
                raise Refused(f"the bench is not armed: {'; '.join(trouble)}")
            asked.answer = _judged(asked.question, value, by)
            given = asked.answer.value
        return "confirmed" if given is None else f"answered with {plain_quantity(given, asked.question.unit)}"

    def document(self, utc_s: Callable[[int], float]) -> dict[str, Any] | None:
        """Return the question as part of the state document; ``utc_s`` turns the run's clock into UTC."""
        with self._lock:
            asked = self._open
        if asked is None or asked.answer is not None:
            return None
        return {**_fields(asked), "since_utc_s": utc_s(asked.since_ns)}

    def _in_the_way(self) -> list[str]:
        context = self._context
        if context is None:
            return []
        return [*context.stop.holds.reasons.values(), *context.interlocks.in_the_way().values()]

    def _announce(self, context: RunContext, asked: _Open) -> None:
        if self._terminal is not None:
            with self._terminal_may_go():
                self._terminal.ask(asked.question)
        if asked.question.arms:  # a hold is not foreseen: nobody may sit there by now
            context.event(PromptAlarm(**_fields(asked)))
        if self._terminal is None:
            self._ask_others(context, asked)

    def _ask_others(self, context: RunContext, asked: _Open) -> None:
        """Tell whoever else can answer that a question waits, where no terminal does or not any more."""
        if not asked.question.arms:
            context.event(PromptAlarm(**_fields(asked)))
        context.message(_how(context, asked.question))

    def _wait(self, context: RunContext, asked: _Open) -> Answer:
        while asked.answer is None:
            # what cannot be reached has to go off, whoever is asked; any other hold waits for the answer
            (context.stop.check if context.away else context.stop.check_stop)()
            if context.clock.now_ns() - asked.since_ns > asked.question.limit_s * NS:
                raise RunError(
                    "B-RUN-070", f"no answer for more than {asked.question.limit_s:g} s: {asked.question.text}",
                    where="prompt", next_step="'bench resume SESSION' at the bench",
                )  # fmt: skip
            seated, line = self._terminal is not None, self._typed(context)
            if line is not None:
                self._take_typed(asked, line)
            if seated and self._terminal is None and asked.answer is None:
                self._ask_others(context, asked)
        if self._terminal is not None and asked.answer.by != asked.question.confirm:
            with self._terminal_may_go():
                self._terminal.tell(f"answered by {asked.answer.by}")
        return asked.answer

    def _typed(self, context: RunContext) -> str | None:
        if self._terminal is not None:
            with self._terminal_may_go():
                return self._terminal.line(POLL_S)
        context.clock.sleep(POLL_S)
        return None

    @contextmanager
    def _terminal_may_go(self) -> Iterator[None]:
        """Leave the question to the others if the terminal hangs up. Raises: RunError B-CLI-005 if there are none."""
        try:
            yield
        except OSError:
            if not self.reachable:
                raise RunError(
                    "B-CLI-005", "the terminal is gone and nobody else can answer", where="prompt",
                    next_step="'bench resume SESSION' from a terminal",
                ) from None  # fmt: skip
            self._terminal = None

    def _take_typed(self, asked: _Open, line: str) -> None:
        assert self._terminal is not None
        try:
            self.propose(asked.id, line.strip(), asked.question.confirm, BENCH)
        except Refused as why:
            if asked.answer is None:
                with self._terminal_may_go():
                    self._terminal.tell(str(why))
                    self._terminal.ask(asked.question)


def _fields(asked: _Open) -> dict[str, Any]:
    question = asked.question
    return {"id": asked.id, **question.shown, "presence": question.presence, "arms": question.arms}


def _how(context: RunContext, question: Question) -> str:
    """Return what whoever reads the log of a run without a terminal is told of a question."""
    value, limits = (" VALUE", f" ({limits_of(question)})") if question.unit else ("", "")
    where = "; at the bench only" if question.presence == BENCH else ""
    return (
        f"waiting for an answer: {question.text}{limits}\n"
        f"'bench answer {context.folder}{value}' or the live page gives it{where}"
    )


def _judged(question: Question, value: object, by: str) -> Answer:
    """Return the answer if it counts. A number is in the unit of the question, a text a number with its unit."""
    if not question.unit:
        if value is None or value is True or str(value).strip().lower() in YES:
            return Answer(by)
        raise Refused("a confirmation is 'yes'; what is not so is put right first, or the run is ended")
    answer = Answer(by, _number(question, value))
    try:
        judge(question, answer, "prompt")
    except BenchError as error:
        raise Refused(error.message) from error
    return answer


def _number(question: Question, value: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool):
        if not abs(value) <= LARGEST_VALUE:  # JSON has numbers that no float holds, and Python's has NaN
            raise Refused("a finite number is due")
        return float(value)
    if not isinstance(value, str) or not value.strip():
        raise Refused(f"a value in {plain_unit(question.unit)} is due")
    try:
        return parse_quantity(value, question.unit)
    except ValueError as error:
        raise Refused(str(error)) from error
