"""The progress of a run for a person: two lines on a terminal, plain lines with a sign of life elsewhere.

Where the run is comes from the state document of its feed, in a few words.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from bench.model.clock import NS, Clock, WallClock
from bench.model.units import hours
from bench.plan import Plan, PlannedPrompt, PlannedRecord, PlannedSettle, PlannedSoak, Step
from bench.record import RecordRow
from bench.run.context import RunContext
from bench.run.control.client import FeedClient, FeedGone
from bench.run.feed.place import in_words
from bench.run.guard.last_words import roles_in_words

PLAIN_EVERY = 50
SIGN_OF_LIFE_S = 540.0  # looked at each half minute, so a log is never silent for more than ten
LOOK_EVERY_S = 30.0  # while the run waits for a disk, an instrument or a person, a line each time
BAR = 30  # columns
NARROW = 120  # a terminal that has less shows no bar: figures tell more
Document = Mapping[str, Any]


def _counts(row: RecordRow) -> bool:
    """Return whether a record is one of the campaign's, which the plan counts; those of the wiring check are not."""
    return str(row.window.conditions.get("purpose", "measurement")) != "wiring"


class PlainLines:
    """A line at each soak, prompt, 50th record and half minute of waiting, and each ten minutes; for logs and pipes.

    ``asks``: prompts are put to somebody; those that a simulated bench answers itself are not told.
    """

    def __init__(self, plan: Plan, out: Console, clock: Clock | None = None, *, asks: bool = True) -> None:
        self._plan, self._out, self._asks = plan, out, asks
        self._records = 0
        self._clock = clock or WallClock()
        self._said_ns = self._clock.now_ns()

    def __enter__(self) -> PlainLines:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Nothing stands in the way of a question here."""
        yield

    def follow(self, context: RunContext) -> AbstractContextManager[None]:
        """Say where the run is when it has been quiet for long; real time, whatever the clock of the run."""
        return followed(context, self._clock, LOOK_EVERY_S, self.sign_of_life)

    def sign_of_life(self, follower: Follower) -> None:
        """One line of where the run is, if nothing was said for nine minutes; of what it waits for, always."""
        document, silent_ns = follower.look(), self._clock.now_ns() - self._said_ns
        if document is None:
            return
        waits = bool(document.get("holds") or document.get("prompt"))
        if silent_ns < (LOOK_EVERY_S / 2.0 if waits else SIGN_OF_LIFE_S) * NS:
            return
        done = f"{self._records}/{self._plan.record_count} records, {losses(document)}"
        when = hours(document["t_utc_s"] - document["started_utc_s"])
        end = ends(document)
        self._say(f"{when}  {100 * document['progress']:.0f} %  {doing(document)}; {done}{f'; {end}' if end else ''}")

    def step(self, step: Step, at_s: float) -> None:
        if isinstance(step, PlannedSoak) or (isinstance(step, PlannedPrompt) and self._asks):
            what = f"prompt: {step.text}" if isinstance(step, PlannedPrompt) else in_words(step)
            self._say(f"{hours(at_s)}  step {step.number + 1}/{len(self._plan.steps)}  {what}")

    def record(self, row: RecordRow) -> None:
        if not _counts(row):
            return
        self._records += 1
        if self._records % PLAIN_EVERY == 0:
            lost = f", {row.lost} frames lost" if row.lost else ""
            self._say(f"record {self._records}/{self._plan.record_count}{lost}")

    def message(self, text: str) -> None:
        self._say(text)

    def _say(self, text: str) -> None:
        self._said_ns = self._clock.now_ns()
        self._out.print(text)


class _End(ProgressColumn):
    """The end of the run; of a rehearsal, which has no such time, how long it will still take."""

    def __init__(self) -> None:
        super().__init__()
        self._left = TimeRemainingColumn()

    def render(self, task: Task) -> Text:
        return Text(task.fields["end"]) if task.fields["end"] else self._left.render(task)


class _TwoLines(Progress):
    """The figures, and what is going on below them."""

    what = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        yield Text(f"  {self.what}", no_wrap=True, overflow="crop")


def _two_lines(out: Console) -> _TwoLines:
    return _TwoLines(
        TextColumn("{task.fields[elapsed]}"),
        *([BarColumn(bar_width=BAR)] if out.width >= NARROW else []),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[counts]}"),
        _End(),
        console=out,
        refresh_per_second=4,
    )


class ProgressBar:
    """Time, share done, records, losses and the end; below: the step, or what is waited for and its last reading."""

    def __init__(self, plan: Plan, out: Console) -> None:
        self._plan = plan
        self._total_s = plan.prepare_s + plan.duration_s + plan.finally_s
        self._progress = _two_lines(out)
        self._task = self._progress.add_task("", total=self._total_s, elapsed="0:00:00", counts="", end="")
        self._records = 0
        self._lost = 0
        self._followed = False  # the run says of itself where it is: that is newer than the last step

    def __enter__(self) -> ProgressBar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Draw nothing while a question is asked: what is drawn again and again would cover it, and what is typed."""
        before, (task,) = self._progress, self._progress.tasks
        before.stop()
        try:
            yield
        finally:  # a new one begins below what was typed; the old one would begin above
            after = _two_lines(before.console)
            after.what = before.what
            self._task = after.add_task("", total=self._total_s, completed=int(task.completed), **task.fields)
            self._progress = after
            after.start()

    def follow(self, context: RunContext) -> AbstractContextManager[None]:
        """Show what the run says of itself, twice a second; nobody waits for it, and it asks as everybody may."""
        return followed(context, WallClock(), 0.5, self.show)

    def show(self, follower: Follower) -> None:
        """The newest state document; without an answer everything stays as it is."""
        document = follower.look()
        if document is None:
            return
        self._followed = True
        self._progress.what = doing(document)
        self._progress.update(
            self._task,
            completed=document["progress"] * self._total_s,
            elapsed=hours(document["t_utc_s"] - document["started_utc_s"]),
            counts=f"{self._records}/{self._plan.record_count} records, {losses(document)}",
            end=ends(document),
        )

    def step(self, step: Step, at_s: float) -> None:
        if not self._followed and isinstance(step, PlannedSoak | PlannedRecord | PlannedSettle | PlannedPrompt):
            self._progress.what = in_words(step)
            self._progress.update(self._task, completed=at_s, elapsed=hours(at_s))

    def record(self, row: RecordRow) -> None:
        self._records += _counts(row)
        self._lost += row.lost
        if not self._followed:
            counts = f"{self._records}/{self._plan.record_count} records, {self._lost} lost"
            self._progress.update(self._task, counts=counts)

    def message(self, text: str) -> None:
        self._progress.console.print(text)


def watcher(plan: Plan, out: Console, *, asks: bool) -> PlainLines | ProgressBar:
    """Return two lines on a terminal, plain lines otherwise; ``asks``: prompts are put to somebody."""
    return ProgressBar(plan, out) if sys.stderr.isatty() else PlainLines(plan, out, asks=asks)


class Follower:
    """Asks the feed of a run for its state; an answer that does not come is no state."""

    def __init__(self, folder: Path) -> None:
        self._client = FeedClient(folder)
        self._seq = 0

    def look(self) -> Document | None:
        """Return the state document of a run under way; None if nobody answers or it does not say where it is yet."""
        try:
            header = self._client.poll(self._seq).header
        except FeedGone:
            return None
        self._seq = header["seq"]  # no point is shown, so none is asked for twice
        state: Document = header["state"]
        return state if state.get("started_utc_s") is not None and state.get("step") else None

    def close(self) -> None:
        """Ask no more."""
        self._client.close()


@contextmanager
def followed(context: RunContext, clock: Clock, every_s: float, look: Callable[[Follower], None]) -> Iterator[None]:
    """Look at what a run says of itself, again and again for as long as it goes on."""
    follower = Follower(context.folder)
    ticker = clock.every(every_s, lambda: look(follower))
    try:
        yield
    finally:
        ticker.cancel()
        follower.close()


def doing(document: Document) -> str:
    """Return what goes on: why the run stands still, else the step and, in a wait, its last reading and its time."""
    step, wait, now = document["step"], document.get("wait"), document["t_utc_s"]
    if document.get("holds"):
        reasons = "; ".join(f"{reason} ({by})" for by, reason in document["holds"].items())
        unconfirmed = (document.get("bench") or {}).get("unconfirmed")
        left = f"; NOT confirmed off: {roles_in_words(unconfirmed)}" if unconfirmed else ""
        return f"HOLDING{_since(wait, now)}: {reasons}{left}"
    where = f"step {step['number']}/{step['of']}"
    if wait is None:
        return f"{where}  {step['what']}"
    waiting = step["kind"] not in ("record", "settle")
    what = wait["reason"] if waiting else step["what"]
    last = f": {wait['last']}" if waiting and wait.get("last") else ""
    return f"{where}  {what}{last}{_since(wait, now)}"


def _since(wait: Document | None, now: float) -> str:
    """Return how long a wait has lasted, of how long."""
    if wait is None or wait.get("since_utc_s") is None:
        return ""
    since, until = wait["since_utc_s"], wait.get("until_utc_s")
    whole = "" if until is None else f" of {hours(until - since)}"
    return f", {hours(max(0.0, now - since))}{whole}"


def losses(document: Document) -> str:
    """Return frames lost and damaged, over all links."""
    links = (document.get("links") or {}).values()
    lost, bad = (sum(int(link.get(what) or 0) for link in links) for what in ("lost", "bad"))
    return f"{lost} lost" + (f", {bad} bad" if bad else "")


def ends(document: Document) -> str:
    """Return the end as a range, UTC; nothing for a rehearsal, whose time is not that of anybody."""
    eta = document.get("eta")
    if not eta or document.get("clock") != "wall":
        return ""
    likely, latest = (datetime.fromtimestamp(eta[f"{name}_utc_s"], tz=UTC) for name in ("likely", "latest"))
    now = datetime.fromtimestamp(document["t_utc_s"], tz=UTC)
    day = "" if likely.date() == now.date() else f"{likely:%m-%d} "
    return f"ends {day}{likely:%H:%M}Z, latest {latest:%H:%M}Z"
