"""The person at the terminal of a run, who is asked."""

from __future__ import annotations

import sys

from bench.commands.console import console
from bench.model.errors import OperatorStop, RunError
from bench.model.units import parse_quantity
from bench.run.control.operator import Answer, Question


class TerminalOperator:
    """Asks the person at the terminal; refuses to guess when there is none."""

    def ask(self, question: Question) -> Answer:
        if not sys.stdin.isatty():
            raise RunError(
                "B-CLI-005",
                f"nobody is there to answer '{question.text}'",
                where="prompt",
                next_step="run from a terminal",
            )
        console(stderr=True).print(question.text)
        if not question.unit:
            while True:
                reply = _typed("done? [yes/stop] ").lower()
                if reply in ("y", "yes"):
                    return Answer(question.confirm)
        while True:
            try:
                return Answer(
                    question.confirm, parse_quantity(_typed(f"value in {question.unit} (or stop): "), question.unit)
                )
            except ValueError as error:
                console(stderr=True).print(str(error))


def _typed(prompt: str) -> str:
    """Return one line from the terminal. Raises: OperatorStop B-CLI-006 for "stop" and at the end of the input."""
    try:
        reply = input(prompt).strip()
    except EOFError:
        reply = "stop"
    if reply.lower() == "stop":
        raise OperatorStop("B-CLI-006", "the operator refused a prompt", where="prompt")
    return reply
