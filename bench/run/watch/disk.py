"""Brings session and step journal to the disk each second, and holds the run while the disk is late.

What is written is in the page cache of the kernel at once, and survives a loss of power only behind an fsync(2). That
call may take as long as it likes on its thread: frames go on into the page cache meanwhile, the step goes on too. But
nothing more is measured once it takes longer than ``LATE_S``, and the guard has no part in it: a disk that hangs is no
reason to lose the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from bench.model.clock import NS, utc_moment
from bench.run.context import RunContext
from bench.run.observers import patient
from bench.run.stop import WRITER, repeated

DISK = "disk"  # who holds the run
SYNC_S, LOOK_S = 1.0, 0.5
LATE_S = 5.0  # five times what the pre-flight still takes for a disk that will do
LIMIT_S = 1800.0  # as for a silent instrument: what is not back by then will not come back by itself


class DiskWatch:
    """Syncs files by their names, one after the other (``sync``); ``look`` sees from beside how long that takes."""

    def __init__(self, context: RunContext, files: Mapping[str, Callable[[], None]]) -> None:
        self._context = context
        self._files = {name: patient(sync, context.event) for name, sync in files.items()}
        self._began_ns: int | None = None
        self._waiting = ""  # what is synced, and since when

    def sync(self) -> None:
        """Wait until all that was written is on the disk; one that was in time lets the run go on.

        One that was late does not, however it ends: a disk that takes that long each time must not hold the run anew
        and anew without end. Raises: RecordError B-REC-003.
        """
        clock = self._context.clock
        began_ns = self._began_ns = clock.now_ns()
        for name, sync in self._files.items():
            self._waiting = f"the {name} since {utc_moment(clock.utc_ns()):%H:%M:%S} UTC"
            sync()
        self._began_ns = None
        if not self._is_late(began_ns):
            self._context.stop.holds.release(DISK)

    def look(self) -> None:
        """Hold the run if the disk is late. The writer gives its sign of life here: one that waits for a disk lives."""
        stop, began_ns = self._context.stop, self._began_ns
        self._context.health.alive(WRITER)
        if began_ns is not None and self._is_late(began_ns) and stop.interruptible and DISK not in stop.holds.reasons:
            reason = f"an fsync is not over after {LATE_S:g} s: waiting for {self._waiting}"
            stop.holds.hold(DISK, reason, LIMIT_S)

    def _is_late(self, began_ns: int) -> bool:
        return self._context.clock.now_ns() - began_ns > LATE_S * NS


@contextmanager
def disk_watch(context: RunContext, files: Mapping[str, Callable[[], None]]) -> Iterator[DiskWatch]:
    """Bring files to the disk beside a run, by name what syncs them."""
    watch = DiskWatch(context, files)
    with repeated(context.clock, context.stop, (LOOK_S, watch.look), (SYNC_S, watch.sync)):
        yield watch
