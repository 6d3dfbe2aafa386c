"""Notices when the clock of the machine is stepped while a run goes on, and when machine or process stood still.

Order and durations come from the monotonic clock, so nothing of the run depends on UTC; but UTC is the label that
joins a session to the world, and a jump must not pass unseen. A time service that slews moves UTC by 0.5 ms in a second
at most (adjtimex(2)), far below ``STEP_S``.

A machine that slept left its stimulus on with nobody watching, and so did a run that was stopped together with its
guard. A sleep is the boot clock minus the monotonic one (clock_gettime(2)); a stop moves no clock, and is a beat of
this process that comes late. Both hold the run: the stimulus goes off and the point under way is taken again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bench.model.clock import NS, Clock
from bench.model.events import ClockStep, Suspend
from bench.run.context import RunContext
from bench.run.stop import SUSPEND_S, repeated

LOOK_S = 0.5
STEP_S = 0.5
SURE_NS = 20_000_000  # both clocks are read within this time, or again
_TRIES = 5


class ClockWatch:
    """Compares UTC and the boot clock with the monotonic clock; ``look`` is called each ``LOOK_S``."""

    def __init__(self, context: RunContext) -> None:
        self._context = context
        self._lock = threading.RLock()  # a signal checks too, wherever it comes
        self._beat_ns = context.clock.now_ns()
        self._boot_ns = _ahead_ns(context.clock, context.clock.boot_ns)
        self._utc_ns = _ahead_ns(context.clock, context.clock.utc_ns)

    def look(self) -> None:
        """Write an event "clock_step" if UTC has moved against the monotonic clock since the last look.

        A run that stands still because of a suspend may go on: it is awake, and its stimulus is off.
        """
        self.beat()
        context, holds = self._context, self._context.stop.holds
        if holds.stands_for(Suspend.kind):
            holds.release(Suspend.kind)
        utc_ns = _ahead_ns(context.clock, context.clock.utc_ns)
        step_ns, self._utc_ns = utc_ns - self._utc_ns, utc_ns
        if abs(step_ns) > STEP_S * NS:
            context.note(ClockStep(step_s=step_ns / NS, t_utc_ns=context.clock.utc_ns()))

    def beat(self) -> None:
        """Hold the run, and say so, if everything stood still since the last beat of any thread.

        The sequencer beats at each of its checks too: it must not end a step after a suspend before it has seen it.
        """
        suspend = None if self._context.stop.over else self._suspend()
        if suspend is not None:
            self._context.note(suspend)  # outside the lock: who hears it may wait for a thread that beats

    def _suspend(self) -> Suspend | None:
        clock, stop = self._context.clock, self._context.stop
        with self._lock:
            boot_ns, beat_ns = _ahead_ns(clock, clock.boot_ns), clock.now_ns()
            asleep_ns, late_ns = boot_ns - self._boot_ns, beat_ns - self._beat_ns
            self._boot_ns, self._beat_ns = boot_ns, beat_ns
            if asleep_ns > SUSPEND_S * NS:
                suspend = Suspend(seconds=asleep_ns / NS, seen="boottime")
            elif late_ns > SUSPEND_S * NS:
                suspend = Suspend(seconds=late_ns / NS, seen="late beat")
            else:
                return None
            if stop.interruptible:  # the end of a run switches off by itself
                stop.holds.hold(Suspend.kind, suspend.sentence)
            return suspend


def _ahead_ns(clock: Clock, read: Callable[[], int]) -> int:
    """Return another clock minus the monotonic one; a thread that had no processor between the two reads again."""
    for _ in range(_TRIES):
        before_ns = clock.now_ns()
        other_ns = read()
        if clock.now_ns() - before_ns < SURE_NS:
            break
    return other_ns - before_ns


@contextmanager
def clock_watch(context: RunContext) -> Iterator[ClockWatch]:
    """Watch the clock beside a run."""
    watch, stop = ClockWatch(context), context.stop

    def hear(at: str) -> None:
        watch.beat()

    stop.live.append(hear)
    try:
        with repeated(context.clock, stop, (LOOK_S, watch.look)):
            yield watch
    finally:
        stop.live.remove(hear)
