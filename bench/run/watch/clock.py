"""Notices when the clock of the machine is stepped while a run goes on, or the machine was asleep.

Order and durations come from the monotonic clock, so nothing of the run depends on it; but UTC is the label that
joins a session to the world, and a jump must not pass unseen. A time service that slews moves UTC by 0.5 ms in a second
at most (adjtimex(2)), far below ``STEP_S``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bench.model.clock import NS, Clock
from bench.model.events import ClockStep
from bench.run.context import RunContext
from bench.run.stop import guarded

LOOK_S = 0.5
STEP_S = 0.5
SURE_NS = 20_000_000  # both clocks are read within this time, or again
_TRIES = 5


class ClockWatch:
    """Compares UTC with the monotonic clock; ``look`` is called each ``LOOK_S``."""

    def __init__(self, context: RunContext) -> None:
        self._context = context
        self._offset_ns = _offset_ns(context.clock)

    def look(self) -> None:
        """Write an event "clock_step" if UTC has moved against the monotonic clock since the last look."""
        context, offset_ns = self._context, _offset_ns(self._context.clock)
        step_ns, self._offset_ns = offset_ns - self._offset_ns, offset_ns
        if abs(step_ns) <= STEP_S * NS:
            return
        context.note(ClockStep(step_s=step_ns / NS, t_utc_ns=context.clock.utc_ns()))


def _offset_ns(clock: Clock) -> int:
    """Return UTC minus monotonic time; a thread that had no processor between the two readings reads again."""
    for _ in range(_TRIES):
        before_ns = clock.now_ns()
        utc_ns = clock.utc_ns()
        if clock.now_ns() - before_ns < SURE_NS:
            break
    return utc_ns - before_ns


@contextmanager
def clock_watch(context: RunContext) -> Iterator[ClockWatch]:
    """Watch the clock beside a run."""
    watch = ClockWatch(context)
    periodic = context.clock.every(LOOK_S, guarded(watch.look, context.stop))
    try:
        yield watch
    finally:
        periodic.cancel()
