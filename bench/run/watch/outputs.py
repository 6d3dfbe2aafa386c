"""Looks at everything that can be on, again and again, so that the state of the bench that people see is never old.

Asked are the questions by which a driver knows whether it is on (``Tells``); what the replies say is worked out by
bench.run.feed.outputs, from the transcript. A look waits for a moment in which the steps leave the bus alone, and for
at most one more period.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager, suppress

from bench.model.clock import NS
from bench.model.errors import InstrumentError
from bench.model.ports import Instrument
from bench.run.bench.safety import QUICK_S, hurried
from bench.run.context import RunContext
from bench.run.feed.outputs import LOOK_VIRTUAL_S, LOOK_WALL_S
from bench.run.observers import Following
from bench.run.stop import guarded
from bench.run.watch.signals import leaves_the_bus

WAKE_S = 5.0


def look(instruments: Mapping[str, Instrument], busy: Container[str] = ()) -> None:
    """Ask each instrument that can be on whether it is; one that does not answer is not waited for.

    Args: busy: roles that a step talks to right now; they are left alone.
    """
    for role, instrument in instruments.items():
        ask = getattr(instrument, "look", None)
        if ask is not None and role not in busy:
            with suppress(InstrumentError), hurried(instrument, QUICK_S):
                ask()


class OutputsWatch:
    """Looks each minute on the wall clock, each half hour in a rehearsal."""

    def __init__(self, context: RunContext, following: Following) -> None:
        self._context, self._following = context, following
        self._period_ns = round((LOOK_VIRTUAL_S if context.clock.virtual else LOOK_WALL_S) * NS)
        self._due_ns = context.clock.now_ns() + self._period_ns

    def take(self) -> None:
        """Look if it is time and the bus is free; nothing is asked any more once the bench is made safe."""
        context, now_ns = self._context, self._context.clock.now_ns()
        overdue_ns = now_ns - self._due_ns
        if overdue_ns < 0 or context.stop.over:
            return
        if leaves_the_bus(context, self._following) or overdue_ns > self._period_ns:
            self._due_ns = now_ns + self._period_ns
            look(context.instruments, context.in_use)


@contextmanager
def outputs_watch(context: RunContext, following: Following) -> Iterator[None]:
    """Look at the outputs while the run goes on, under either clock."""
    watch = OutputsWatch(context, following)
    wake_s = LOOK_VIRTUAL_S if context.clock.virtual else WAKE_S
    periodic = context.clock.every(wake_s, guarded(watch.take, context.stop))
    try:
        yield
    finally:
        periodic.cancel()
