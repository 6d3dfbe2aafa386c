"""Where a run is, for whoever goes on beside the sequencer."""

from __future__ import annotations

from bench.model.events import Event, Retake
from bench.plan import MEASUREMENT, Step
from bench.record import RecordRow
from bench.run.context import RunContext
from bench.run.observers import Observer, Order


class Following(Observer):
    """Remembers where the run is.

    ``step_under_way`` is None before the first; ``records`` are the numbers of those that are complete and count
    (no wiring checks, none that was taken back).
    """

    order = Order.PLACE
    vital = True

    def __init__(self, context: RunContext) -> None:
        self.step_under_way: Step | None = None
        self.records: set[int] = set()
        context.observers.add(self)

    def step(self, step: Step, at_s: float) -> None:
        """A step begins."""
        self.step_under_way = step

    def record(self, row: RecordRow) -> None:
        """A record is complete."""
        if row.window.conditions.get("purpose", MEASUREMENT) == MEASUREMENT:
            self.records.add(row.window.number)

    def event(self, event: Event, t_mono_ns: int) -> None:
        """Something happened."""
        if isinstance(event, Retake):
            self.records.discard(event.record)
