"""What did not go to plan in a run, as lines of the terminal and as a table of the report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol, TypeVar

from bench.analysis import Table
from bench.model.clock import NS
from bench.model.events import End, Event, Guard, Link, Phase, Preflight
from bench.model.units import hours

E = TypeVar("E", bound=Event)

KINDS = (
    "late", "slip", "overrun", "retake", "hold", "release", "skip", "control", "interlock", "alarm", "verdict", "link",
    "guard", "clock_step", "config", "error",
)  # fmt: skip


class Events(Protocol):
    """A session, as far as its events are asked for."""

    @property
    def events(self) -> Sequence[tuple[int, Event]]:
        """Return all that is kept, with its time."""

    def events_of(self, model: type[E]) -> list[tuple[int, E]]:
        """Return times and events of one kind."""


def happenings(view: Events) -> list[str]:
    """Return one line for each thing that did not go to plan, by kind, and how punctual the run was."""
    start_ns = _start_ns(view)
    troubles = sorted(_troubles(view), key=lambda trouble: KINDS.index(trouble[1].kind))
    said = [f"{event.kind} at {_since(t_ns, start_ns)}: {event.sentence}" for t_ns, event in troubles]
    return [*said, *punctuality(view)]


def happening_tables(view: Events) -> list[Table]:
    """Return the same as a table of the report, in order of time; none for a run to which nothing happened."""
    troubles = sorted((t_ns, event.kind, event.sentence) for t_ns, event in _troubles(view))
    if not troubles:
        return []
    start_ns = _start_ns(view)
    return [
        Table(
            "What happened during the run",
            "Everything that did not go to plan; time since the run began.",
            ["time", "what", "in words"],
            [[_since(t_ns, start_ns), kind, text] for t_ns, kind, text in troubles],
            prose=True,
        )
    ]


def preflight_table(event: Preflight) -> Table:
    """Return the event "preflight" of a session as a table of its report."""
    rows = [[str(row[key]) for key in ("name", "status", "value", "limit", "text")] for row in event.findings]
    headers = ["looked at", "status", "found", "due", "remark"]
    return Table("Pre-flight", "What was looked at before the run began.", headers, rows)


def punctuality(view: Events) -> Iterator[str]:
    """Return how late the timed waits ended."""
    for _, end in view.events_of(End):
        median, p99, worst = end.lateness_ms
        yield (
            f"Timer: {end.steps} steps; timed waits ended {median:.3g} ms late in the median, "
            f"{p99:.3g} ms at the 99th percentile, {worst:.3g} ms at worst; "
            f"slip {end.slip_s:.3g} s, {end.overruns} overruns."
        )


def _start_ns(view: Events) -> int:
    """When the run began, as the lines of its progress count; the bench clock itself may begin with the machine."""
    return min((t_ns for t_ns, _ in view.events_of(Phase)), default=0)


def _since(t_ns: int, start_ns: int) -> str:
    return hours(max(0, t_ns - start_ns) / NS)


def _troubles(view: Events) -> Iterator[tuple[int, Event]]:
    for t_ns, event in view.events:
        as_it_should_be = isinstance(event, Link | Guard) and event.state in ("open", "ready")
        if event.kind in KINDS and not as_it_should_be:
            yield t_ns, event
