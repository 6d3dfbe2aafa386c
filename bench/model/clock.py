"""Time is an object: the same code runs on the wall clock and on a virtual clock.

This is the only file of the project that sleeps or asks the time (tests/house enforces it). All order and all
durations come from the monotonic clock in nanoseconds; UTC is a label recorded beside it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Protocol

NS = 1_000_000_000
VIRTUAL_START_UTC_NS = 946_684_800 * NS  # 2000-01-01T00:00:00Z
_STAMP = "%Y%m%dT%H%M%SZ"
_BOOT: int | None = getattr(time, "CLOCK_BOOTTIME", None)  # Linux alone has it


def to_ns(seconds: float) -> int:
    """Return seconds to whole nanoseconds, rounded to the nearest."""
    return round(seconds * NS)


def utc_moment(utc_ns: int) -> datetime:
    """Return a time to the second."""
    return datetime.fromtimestamp(utc_ns // NS, UTC)


def utc_text(utc_ns: int) -> str:
    """Return a time as people write it, to the second: 2026-04-01T08:00:00Z."""
    return utc_moment(utc_ns).strftime("%Y-%m-%dT%H:%M:%SZ")


def utc_stamp(utc_ns: int) -> str:
    """Return a time as the names of sessions begin with it: 20260401T080000Z."""
    return utc_moment(utc_ns).strftime(_STAMP)


def utc_of_stamp(name: str) -> int | None:
    """Return the time that a name begins with, nanoseconds since 1970; None if it begins with none."""
    try:
        moment = datetime.strptime(name[:16], _STAMP).replace(tzinfo=UTC)
    except ValueError:
        return None
    return int(moment.timestamp()) * NS


class Periodic(Protocol):
    """Handle of a callback registered with ``Clock.every``."""

    def cancel(self) -> None:
        """Never call back again."""


class Clock(Protocol):
    """A clock of the bench, wall or virtual."""

    virtual: bool

    def now_ns(self) -> int:
        """Return monotonic time, nanoseconds from an arbitrary origin (0 at the start of a virtual run)."""

    def utc_ns(self) -> int:
        """Return UTC, nanoseconds since 1970-01-01."""

    def boot_ns(self) -> int:
        """Return monotonic time that goes on while the machine is suspended, where the system tells it."""

    def sleep_until_ns(self, t_mono_ns: int) -> None:
        """Return at or after ``t_mono_ns``; callbacks that fall due are run on the way."""

    def sleep(self, seconds: float) -> None:
        """Sleep for a duration."""

    def every(self, period_s: float, callback: Callable[[], None], *, observer: bool = True) -> Periodic:
        """Call ``callback`` each ``period_s``; ``observer`` promises that it does not change the bench."""


@dataclass(eq=False)
class _Task:
    due_ns: int
    period_ns: int
    callback: Callable[[], None]
    observer: bool
    active: bool = True
    running: bool = False

    def cancel(self) -> None:
        self.active = False


class VirtualClock:
    """A clock that jumps from event to event in one thread; deterministic.

    Callbacks run inside ``sleep_until_ns`` in order of their due time (registration order breaks ties). A callback
    may sleep itself; it is not re-entered meanwhile, and its missed ticks are dropped.
    """

    virtual = True

    def __init__(self, utc_start_ns: int = VIRTUAL_START_UTC_NS) -> None:
        self._now_ns = 0
        self._utc_start_ns = utc_start_ns
        self._tasks: list[_Task] = []
        self._running: list[_Task] = []
        self._sleepers: list[int] = []

    def now_ns(self) -> int:
        return self._now_ns

    def utc_ns(self) -> int:
        return self._utc_start_ns + self._now_ns

    def boot_ns(self) -> int:
        return self._now_ns

    def sleep(self, seconds: float) -> None:
        self.sleep_until_ns(self._now_ns + to_ns(seconds))

    def sleep_until_ns(self, t_mono_ns: int) -> None:
        self._sleepers.append(t_mono_ns)
        try:
            while (task := self._next_due(t_mono_ns)) is not None:
                self._now_ns = max(self._now_ns, task.due_ns)
                self._run(task)
            self._now_ns = max(self._now_ns, t_mono_ns)
        finally:
            self._sleepers.pop()

    def every(self, period_s: float, callback: Callable[[], None], *, observer: bool = True) -> Periodic:
        period_ns = to_ns(period_s)
        if period_ns <= 0:
            raise ValueError(f"period {period_s} s is not positive")
        self._tasks = [task for task in self._tasks if task.active]
        task = _Task(self._now_ns + period_ns, period_ns, callback, observer)
        self._tasks.append(task)
        return task

    def quiet_until_ns(self) -> int:
        """Return time until which nothing but observers runs: nobody can change the simulated bench before it."""
        horizon = min(self._sleepers, default=self._now_ns)
        for task in self._tasks:
            if task.active and not task.observer:
                horizon = min(horizon, task.due_ns)
        return max(horizon, self._now_ns)

    def turns_ahead_ns(self) -> range:
        """Return coming turns of the callback that asks, as far as nobody else acts before them.

        Until then the callback is alone: it may pass through these turns (``pass_to_ns``) and do at once what they
        would have done. The last one may be the time when others act too, if its turn comes before theirs.
        """
        task = self._running[-1]
        stop_ns, is_behind = self._sleepers[-1] + 1, False
        for other in self._tasks:  # in order of registration
            if other is task:
                is_behind = True
            elif other.active and not other.running:
                stop_ns = min(stop_ns, other.due_ns + is_behind)
        return range(self._following(task), stop_ns, task.period_ns)

    def pass_to_ns(self, turn_ns: int) -> None:
        """Let the time of one of ``turns_ahead_ns`` come; nobody else acts on the way."""
        self._now_ns = max(self._now_ns, turn_ns)

    def _next_due(self, limit_ns: int) -> _Task | None:
        first = None
        for task in self._tasks:  # in order of registration
            if task.due_ns <= limit_ns and task.active and not task.running:
                first, limit_ns = task, task.due_ns - 1
        return first

    def _run(self, task: _Task) -> None:
        task.running = True
        self._running.append(task)
        try:
            task.callback()
        finally:
            self._running.pop()
            task.running = False
            task.due_ns = self._following(task)

    def _following(self, task: _Task) -> int:
        """Return the first turn of a task after now and after the one that is due."""
        passed = max(self._now_ns - task.due_ns, 0) // task.period_ns
        return task.due_ns + (passed + 1) * task.period_ns


class _Ticker:
    """One thread that calls back on a fixed grid of real time; ticks an overrun missed are dropped, never bunched."""

    def __init__(self, period_s: float, callback: Callable[[], None], failures: list[BaseException]) -> None:
        self._period_s = period_s
        self._callback = callback
        self._failures = failures
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _loop(self) -> None:
        due = time.monotonic() + self._period_s
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            try:
                self._callback()
            except Exception as error:
                self._failures.append(error)
                return
            late = time.monotonic() - due
            due += self._period_s * (1 + max(0, int(late / self._period_s)))


class WallClock:
    """Real time: monotonic for order and durations, UTC as a label; callbacks run on threads of their own.

    A callback that raises is not called again; its exception is raised by the next sleep of the main thread.

    Args: rate: seconds of this clock in a second of real time, more than 0; a simulated bench may run faster. UTC
        stays the real one. Raises: ValueError for a rate that is not positive and finite.
    """

    virtual = False

    def __init__(self, rate: float = 1.0) -> None:
        if not 0.0 < rate < math.inf:
            raise ValueError(f"rate {rate} is not positive and finite")
        self._rate = rate
        self._origin_ns = time.monotonic_ns()
        self._failures: list[BaseException] = []

    def now_ns(self) -> int:
        real_ns = time.monotonic_ns()
        if self._rate == 1.0:
            return real_ns
        return self._origin_ns + round((real_ns - self._origin_ns) * self._rate)

    def utc_ns(self) -> int:
        return time.time_ns()

    def boot_ns(self) -> int:
        return time.monotonic_ns() if _BOOT is None else time.clock_gettime_ns(_BOOT)

    def sleep(self, seconds: float) -> None:
        self.sleep_until_ns(self.now_ns() + to_ns(max(0.0, seconds)))

    def sleep_until_ns(self, t_mono_ns: int) -> None:
        while (left_ns := t_mono_ns - self.now_ns()) > 0:
            time.sleep(left_ns / NS / self._rate)
        if self._failures and threading.current_thread() is threading.main_thread():
            raise self._failures.pop(0)

    def every(self, period_s: float, callback: Callable[[], None], *, observer: bool = True) -> Periodic:
        del observer
        if period_s <= 0:
            raise ValueError(f"period {period_s} s is not positive")
        return _Ticker(period_s / self._rate, callback, self._failures)


async def pause(seconds: float) -> None:
    """Let other tasks of an event loop go on for a while; real time, for whoever serves people and no run."""
    import asyncio  # not at the top: no command line but those that serve people needs it

    await asyncio.sleep(max(0.0, seconds))
