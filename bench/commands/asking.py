"""The terminal of a run, where a question is answered by typing; others may answer it meanwhile."""

from __future__ import annotations

import errno
import select
import sys
import termios
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress

from bench.commands.console import console
from bench.model.errors import OperatorStop
from bench.run.control.operator import Answer, Operator, Question, limits_of


class Aside:
    """An operator who is asked while nothing else is drawn on the terminal (bench.run.control.operator.Operator)."""

    def __init__(self, operator: Operator, aside: Callable[[], AbstractContextManager[None]]) -> None:
        self._operator, self._aside = operator, aside

    def ask(self, question: Question) -> Answer:
        """As the operator does."""
        with self._aside():
            return self._operator.ask(question)


class StdinTerminal:
    """Standard input and error of the process (bench.run.control.asking.Terminal)."""

    def ask(self, question: Question) -> None:
        """Show a question and how to answer it. What was typed before is no answer to it, and is dropped."""
        with suppress(termios.error):
            termios.tcflush(sys.stdin, termios.TCIFLUSH)
        due = f"value ({limits_of(question)})" if question.unit else "yes"
        self.tell(f"{question.text}\n{due} or stop:")

    def line(self, timeout_s: float) -> str | None:
        """A line that was typed, None if none comes in time.

        Raises: OperatorStop B-CLI-006 for "stop" and at the end of the input; OSError if the terminal is gone.
        """
        ready, _, _ = select.select([sys.stdin], [], [], timeout_s)
        if not ready:
            return None
        typed = sys.stdin.readline()
        if not typed and not sys.stdin.isatty():  # a terminal that has hung up reads like one where nothing is said
            raise OSError(errno.EIO, "the terminal has hung up")
        if not typed or typed.strip().lower() == "stop":
            raise OperatorStop("B-CLI-006", "the operator refused a prompt", where="prompt")
        return typed.strip()

    def tell(self, text: str) -> None:
        """Say something about the question."""
        console(stderr=True).print(text)


def terminal_here() -> StdinTerminal | None:
    """The terminal this process was started from; None if nobody sits there."""
    return StdinTerminal() if sys.stdin is not None and sys.stdin.isatty() else None
