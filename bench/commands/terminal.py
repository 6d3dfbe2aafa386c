"""What a person sees while a run goes on: a progress bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from contextlib import suppress
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from bench.commands.console import console, hours
from bench.model.errors import OperatorStop, RunError
from bench.model.units import format_quantity, parse_quantity
from bench.plan import Plan, Step
from bench.record import RecordRow
from bench.run.operator import Answer, Question

PLAIN_EVERY = 50
BAR = 30  # columns
NARROW = 120  # a terminal that has less shows no bar: figures tell more


def describe(step: Step) -> str:
    """One line about a step: what is done and under which conditions."""
    conditions = step.conditions
    parts = []
    if "temperature_degC" in conditions:
        parts.append(f"{conditions['temperature_degC']:g} degC")
    if "channel" in conditions:
        parts.append(f"channel {conditions['channel']}")
    if conditions.get("route") == "open":
        parts.append("open")
    elif "current_A" in conditions:
        sign = "-" if conditions.get("polarity", 1) < 0 else "+"
        parts.append(sign + format_quantity(float(conditions["current_A"]), "A"))
    what = f"{step.role}.{step.name}" if step.kind in ("call", "verify", "send", "unit") else step.kind
    return f"{what:<24} {' '.join(parts)}"


def _counts(row: RecordRow) -> bool:
    """Whether a record is one of the campaign's, which the plan counts; those of the wiring check are not."""
    return str(row.window.conditions.get("purpose", "measurement")) != "wiring"


class PlainLines:
    """A line at each soak, prompt and every 50th record; for logs and pipes."""

    def __init__(self, plan: Plan, out: Console) -> None:
        self._plan = plan
        self._out = out
        self._records = 0

    def __enter__(self) -> PlainLines:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def step(self, step: Step, at_s: float) -> None:
        if step.kind in ("soak", "prompt"):
            self._out.print(f"{hours(at_s)}  step {step.number + 1}/{len(self._plan.steps)}  {describe(step)}")

    def record(self, row: RecordRow) -> None:
        if not _counts(row):
            return
        self._records += 1
        if self._records % PLAIN_EVERY == 0:
            lost = f", {row.lost} frames lost" if row.lost else ""
            self._out.print(f"record {self._records}/{self._plan.record_count}{lost}")

    def message(self, text: str) -> None:
        self._out.print(text)


class ProgressBar:
    """Steps done, what is going on, records, losses and the time left."""

    def __init__(self, plan: Plan, out: Console) -> None:
        self._plan = plan
        self._progress = Progress(
            TextColumn("{task.fields[campaign]}"),
            *([BarColumn(bar_width=BAR)] if out.width >= NARROW else []),
            TextColumn("{task.percentage:>3.0f} %"),
            TextColumn("{task.fields[what]}", markup=False),
            TextColumn("{task.fields[counts]}"),
            TimeRemainingColumn(),
            console=out,
            refresh_per_second=4,
        )
        self._task = self._progress.add_task(
            "", total=plan.prepare_s + plan.duration_s + plan.finally_s, campaign="0:00:00", what="", counts=""
        )
        self._records = 0
        self._lost = 0

    def __enter__(self) -> ProgressBar:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):  # the terminal may be gone; the results must still be written
            self._progress.stop()

    def step(self, step: Step, at_s: float) -> None:
        if step.kind in ("soak", "record", "settle", "prompt"):
            self._progress.update(self._task, completed=at_s, what=describe(step), campaign=hours(at_s))

    def record(self, row: RecordRow) -> None:
        self._records += _counts(row)
        self._lost += row.lost
        counts = f"{self._records}/{self._plan.record_count} records, {self._lost} lost"
        self._progress.update(self._task, counts=counts)

    def message(self, text: str) -> None:
        self._progress.console.print(text)


def watcher(plan: Plan, out: Console) -> PlainLines | ProgressBar:
    """Progress bar on a terminal, plain lines otherwise."""
    return ProgressBar(plan, out) if sys.stderr.isatty() else PlainLines(plan, out)


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
    """One line from the terminal. Raises: OperatorStop B-CLI-006 for "stop" and at the end of the input."""
    try:
        reply = input(prompt).strip()
    except EOFError:
        reply = "stop"
    if reply.lower() == "stop":
        raise OperatorStop("B-CLI-006", "the operator refused a prompt", where="prompt")
    return reply
