"""Where a run is and what happened in it last, for whoever goes on beside the sequencer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from bench.plan import MEASUREMENT, Step
from bench.record import RecordRow
from bench.run.context import RunContext

Heard = Callable[[str, Mapping[str, Any]], None]


class Following:
    """Stands between a run and its listener and session, passes everything on, and remembers where the run is.

    ``step_under_way`` is None before the first; ``records`` are the numbers of those that are complete and count
    (no wiring checks, none that was taken back). ``heard`` are called
    with kind and fields of each event, ``taken`` with each record, on the thread they come from; they must not wait.
    """

    def __init__(self, context: RunContext) -> None:
        self.step_under_way: Step | None = None
        self.records: set[int] = set()
        self.heard: list[Heard] = []
        self.taken: list[Callable[[RecordRow], None]] = []
        self._listener = context.listener
        self._event = context.sink.event
        self.raw = context.sink.raw
        self.command = context.sink.command
        self.message = context.listener.message
        context.listener = self
        context.sink = self

    def step(self, step: Step, at_s: float) -> None:
        """A step begins."""
        self.step_under_way = step
        self._listener.step(step, at_s)

    def record(self, row: RecordRow) -> None:
        """A record is complete."""
        if row.window.conditions.get("purpose", MEASUREMENT) == MEASUREMENT:
            self.records.add(row.window.number)
        self._listener.record(row)
        for call in self.taken:
            call(row)

    def event(self, kind: str, t_mono_ns: int, fields: Mapping[str, Any]) -> None:
        """Something happened."""
        self._event(kind, t_mono_ns, fields)
        if kind == "retake":
            self.records.discard(int(fields["record"]))
        for call in self.heard:
            call(kind, fields)
