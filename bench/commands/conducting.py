"""Parts common to ``bench run`` and ``bench resume``: watchers beside a run, the pre-flight before it, and the terminal
where a person is asked; others may answer meanwhile.
"""

from __future__ import annotations

import errno
import os
import select
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

from rich.console import Console

from bench.commands.console import console, warn
from bench.commands.progress import watcher
from bench.commands.tables import print_finished, print_units, print_without_results
from bench.model.clock import Clock, WallClock
from bench.model.errors import ExitStatus, FitError, InstallationError, OperatorStop, RunError
from bench.model.posix import forget_typed, require
from bench.model.units import parse_quantity, plain_unit
from bench.plan import Plan
from bench.run.besides import besides
from bench.run.control.asking import WaitingOperator
from bench.run.guard.guarding import guard_beside
from bench.run.operator import Answer, Operator, Question, SimulatedOperator, limits_of
from bench.run.position import Resumption
from bench.run.preflight import Preflight, stay_awake
from bench.run.session import Beside, Conducted, conduct
from bench.run.watch.clock import clock_watch
from bench.session.finish import finish
from bench.session.happenings import happenings
from bench.session.one_unit import serials_of
from bench.session.units import RESULTS, finish_units
from bench.session.view import KEPT_EVENTS, SessionView


def conduct_watched(
    plan: Plan,
    clock: Clock,
    *,
    seed: int,
    out: Path,
    errors: Console,
    resumed: Resumption | None = None,
    ask: bool = False,
    uncommissioned: str = "",
) -> Conducted:
    """Conduct a plan with everything that watches over it; a person is told on ``errors``.

    ``ask``: prompts are put to a person on a simulated bench too. Under the wall clock anybody who reaches the run may
    answer them. ``uncommissioned``: why drivers may be used that nobody has tried on these instruments.
    """
    simulated = plan.station.simulated and not ask
    asking = None if simulated or clock.virtual else WaitingOperator(terminal_here())
    with watcher(plan, errors, asks=not simulated) as listener:
        operator: Operator = SimulatedOperator() if simulated else Aside(asking or TerminalOperator(), listener.aside)
        return conduct(
            plan,
            clock=clock,
            seed=seed,
            out=out,
            operator=operator,
            listener=listener,
            keep_events=KEPT_EVENTS,
            beside=[*watchers(plan, clock, asking), listener.follow],
            preflight=Preflight(tell=listener.message, uncommissioned=uncommissioned),
            resumed=resumed,
        )


def ended(done: Conducted, view: Callable[[], SessionView], what_is_left: str, url: str, as_json: bool) -> int:
    """Tell how a run has ended, how its bench is left, and its results or what is left; return the exit status.

    ``view``: what is known of its session. What has begun was no bad input, whatever the error says of itself.
    """
    out, error, unsafe = console(stderr=as_json), done.outcome.error, done.outcome.unsafe
    for failure in unsafe:
        warn(failure)
    roles = ", ".join(failure.where for failure in unsafe)
    bench = f"The bench is {f'NOT confirmed safe: {roles}, switch off at the front panel' if roles else 'safe'}"
    if error is None:
        status = tell_results(view(), done.folder, url, as_json, f"{bench}. ")
        if unsafe:
            out.print(bench)
    else:
        warn(error)
        out.print(f"{bench}; {what_is_left}")
        status = error.exit_status
    return ExitStatus.SAFE_AFTER_FAULT if unsafe or status == ExitStatus.BAD_INPUT else status


def tell_results(view: SessionView, folder: Path, url: str, as_json: bool, bench: str = "") -> int:
    """Write results and report of a session whose every step was done, of each unit where several share it; then tell.

    ``bench``: how it was left, told where there is no result.
    """
    out = console(stderr=as_json)
    told: Callable[[], int | None]
    if not view.has_analysis:
        told = partial(out.print, f"its records are in {folder}; the sequence asks for no analysis")
    elif serials_of(view.manifest):
        told = partial(print_units, finish_units(folder, url), out)
        if as_json:
            sys.stdout.write((folder / RESULTS).read_text(encoding="utf-8"))
    else:
        try:
            told = partial(print_finished, finish(folder, view, url), out, as_json)
        except (FitError, InstallationError) as error:
            told = partial(print_without_results, error, folder, out, bench)
    for line in happenings(view):
        out.print(line)
    return told() or ExitStatus.PASS


def wall_clock() -> Clock:
    """Return the clock of a run in real time. Raises: InputError B-SYS-001 where no such run can be guarded."""
    require("a run on the wall clock")
    return WallClock()


def watchers(plan: Plan, clock: Clock, asking: WaitingOperator | None = None) -> list[Beside]:
    """Return those who watch over a run, the guard first: it is the last one to be let go."""
    watching: list[Beside] = [
        guard_beside(plan.station),
        *besides(plan, os.environ, virtual=clock.virtual, asking=asking),
    ]
    return watching if clock.virtual else [*watching, clock_watch, stay_awake]


class Aside:
    """An operator who is asked while nothing else is drawn on the terminal (bench.run.operator.Operator)."""

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
        forget_typed(sys.stdin)
        due = f"value ({limits_of(question)})" if question.unit else "yes"
        self.tell(f"{question.text}\n{due} or stop:")

    def line(self, timeout_s: float) -> str | None:
        """Return a line that was typed, None if none comes in time.

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
        warn(text)


def terminal_here() -> StdinTerminal | None:
    """Return the terminal this process was started from; None if nobody sits there."""
    return StdinTerminal() if sys.stdin is not None and sys.stdin.isatty() else None


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
        warn(question.text)
        if not question.unit:
            while True:
                reply = _typed("done? [yes/stop] ").lower()
                if reply in ("y", "yes"):
                    return Answer(question.confirm)
        while True:
            try:
                return Answer(
                    question.confirm,
                    parse_quantity(_typed(f"value in {plain_unit(question.unit)} (or stop): "), question.unit),
                )
            except ValueError as error:
                warn(error)


def _typed(prompt: str) -> str:
    """Return one line from the terminal. Raises: OperatorStop B-CLI-006 for "stop" and at the end of the input."""
    try:
        reply = input(prompt).strip()
    except EOFError:
        reply = "stop"
    if reply.lower() == "stop":
        raise OperatorStop("B-CLI-006", "the operator refused a prompt", where="prompt")
    return reply
