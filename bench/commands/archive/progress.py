"""What a person is told of work on many sessions: a line on standard error for each, with the time that is left."""

from __future__ import annotations

from bench.commands.console import console
from bench.model.clock import NS, Clock, WallClock
from bench.model.units import hours


class Lines:
    """Counts the sessions that are done; the time left is that of those done since it began."""

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or WallClock()
        self._out = console(stderr=True)
        self._total = self._done = self._before = 0
        self._began_ns = self._clock.now_ns()

    def begin(self, total: int, done: int) -> None:
        """Tell how many of how many sessions are done already."""
        self._total, self._done, self._before, self._began_ns = total, done, done, self._clock.now_ns()
        if done:
            self._out.print(f"{done}/{total}  done before")

    def session(self, name: str) -> None:
        """Tell of one more session."""
        self._done += 1
        spent_s = (self._clock.now_ns() - self._began_ns) / NS
        left = self._total - self._done
        eta = f"  {hours(spent_s * left / (self._done - self._before))} left" if left > 0 else ""
        of = f"/{self._total}" if self._total else ""
        self._out.print(f"{self._done}{of}  {name}{eta}")
