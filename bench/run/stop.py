"""Wishes from beside the sequencer: that it stops, stands still, takes the point again or skips it.

The operator stops it (first Ctrl-C or SIGTERM: at the next check, the second: at once), or a fault does. The sequencer
checks between steps and while it waits; each check is its sign of life. A hang-up of the terminal (SIGHUP) stops
nothing: an unattended run does not need the terminal it was started from.

The guard is told that all is well only while every part of the run has given a sign of life not long ago.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Literal

from bench.model.clock import NS, Clock
from bench.model.errors import BenchError, OperatorStop
from bench.model.installed import unforeseen

SEQUENCER, WRITER, LINKS = "sequencer", "writer", "links"
CHAMBER_AIR, UNIT = "chamber_air_degC", "unit_degC"


class Health:
    """Thread-safe; the thread that makes it is the sequencer's."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stamps_ns: dict[str, int] = {}
        self._values: dict[str, tuple[float, int]] = {}
        self._sequencer = threading.get_ident()
        self._asking = False
        self.is_over = self.heat_off = False
        self._unconfirmed: dict[str, str] = {}
        self._at = "", clock.now_ns()

    def alive(self, part: str, at: str = "") -> None:
        """A part gives a sign of life; one of the sequencer counts only from its own thread. ``at``: what it is at."""
        if part != SEQUENCER:
            self._stamps_ns[part] = self._clock.now_ns()
        elif threading.get_ident() == self._sequencer:
            now_ns = self._stamps_ns[part] = self._clock.now_ns()
            if at != self._at[0]:
                self._at = at, now_ns

    def at(self) -> tuple[str, float]:
        """Return what the sequencer is at, by its last sign of life, and for how long it has been, second."""
        what, since_ns = self._at
        return what, (self._clock.now_ns() - since_ns) / NS

    @contextmanager
    def asking(self) -> Iterator[None]:
        """While a person is asked the sequencer waits for that person, however long it takes: it lives."""
        self._asking = True
        try:
            yield
        finally:
            self.alive(SEQUENCER)
            self._asking = False

    def begin(self, roles: Iterable[str]) -> None:
        """From now on these may be on: whoever leaves without ``over`` leaves all of them behind."""
        self._unconfirmed = dict.fromkeys(roles, "unreachable")

    def over(self, unconfirmed: Mapping[str, str], *, heat_off: bool = False) -> None:
        """The bench was made safe, but for these: the rest of the run is paper work, and nothing of it has to hurry.

        ``heat_off``: a source of heat among them is to be stopped, not held.
        """
        self._unconfirmed, self.heat_off = dict(unconfirmed), heat_off
        self.is_over = True

    @property
    def unconfirmed(self) -> dict[str, str]:
        """What is not confirmed safe, by role: the last words of a controller to its guard."""
        return dict(self._unconfirmed)

    def silence_s(self) -> Mapping[str, float]:
        """Return seconds since the last sign of life, by part; a part that gave none is left out, at the end all."""
        if self.is_over:
            return {}
        now_ns = self._clock.now_ns()
        silence = {part: (now_ns - stamp_ns) / NS for part, stamp_ns in list(self._stamps_ns.items())}
        return {**silence, SEQUENCER: 0.0} if self._asking else silence

    def note(self, name: str, value: float) -> None:
        """The newest value of a quantity, named with its unit: ``chamber_air_degC``, ``unit_degC`` ..."""
        self._values[name] = (value, self._clock.now_ns())

    def values(self) -> dict[str, float]:
        """Return the newest values."""
        return {name: value for name, (value, _) in list(self._values.items())}

    def newest(self, name: str) -> tuple[float, int] | None:
        """Return the newest value and when it was noted, on the bench clock, ns; None if it never was."""
        return self._values.get(name)

    def age_s(self, name: str) -> float | None:
        """Return seconds since a value was noted; None if it never was."""
        known = self.newest(name)
        return None if known is None else (self._clock.now_ns() - known[1]) / NS


Kind = Literal["hold", "retake", "skip"]
HOLD_LIMIT_S = 4 * 3600.0  # a cause that nobody removed by then will not go away by itself
SUSPEND_S = 2.0  # the guard's own limit of silence: what is shorter is a machine with much to do
AWAY_LIMIT_S = 1800.0  # a switch of a network that restarts is back long before
_STOPS = (signal.SIGINT, signal.SIGTERM)
_HANGUPS = tuple(filter(None, [getattr(signal, "SIGHUP", None)]))  # not every system has it


@dataclass(frozen=True)
class Wish:
    """A wish at the point under way: take it again, skip it, or stand still; ``by`` = who wishes it."""

    kind: Kind
    by: str
    reason: str


class Interruption(Exception):
    """Leaves the step under way because of a wish; only the sequencer catches it."""

    def __init__(self, wish: Wish) -> None:
        super().__init__(f"{wish.kind}: {wish.reason}")
        self.wish = wish


class Holds:
    """The reasons to stand still, by who gave them; the run goes on when the last one is gone. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._reasons: dict[str, str] = {}
        self._limits_s: dict[str, float] = {}
        self._since_s: dict[str, float] = {}  # when a reason was first seen while the run stood still
        self._wish: Wish | None = None
        self._armed_by = ""

    def hold(self, by: str, reason: str, limit_s: float = HOLD_LIMIT_S) -> None:
        """Stand still from the next check on, until ``release`` is called with the same ``by``.

        ``limit_s``: the run ends safely when it has stood still that long for this reason.
        """
        with self._lock:
            self._reasons[by] = reason
            self._limits_s[by] = limit_s
            self._armed_by = ""

    def release(self, by: str) -> bool:
        """Take a reason back; False if there was none."""
        with self._lock:
            return self._take_back(by)

    def let_go(self, everyone: Iterable[str], armed_by: str) -> bool:
        """Take the reasons of several back at once; False if there was none.

        ``armed_by``: who does it at the bench, "" from afar; counts if nothing else holds the run.
        """
        with self._lock:
            released = [by for by in everyone if self._take_back(by)]
            if released and not self._reasons:
                self._armed_by = armed_by
            return bool(released)

    @property
    def armed_by(self) -> str:
        """Who has let the run go on at the bench since the last reason to hold came, "" if nobody."""
        with self._lock:
            return self._armed_by

    def _take_back(self, by: str) -> bool:
        self._limits_s.pop(by, None)
        self._since_s.pop(by, None)
        return self._reasons.pop(by, None) is not None

    def wish(self, wish: Wish) -> None:
        """Retake or skip the point under way; the first wish counts until it is granted."""
        with self._lock:
            self._wish = self._wish or wish

    @property
    def reasons(self) -> dict[str, str]:
        """Reasons to stand still, by who gave them."""
        with self._lock:
            return dict(self._reasons)

    def overdue(self, held_s: float) -> tuple[str, str, float] | None:
        """Return the first reason with its limit over after a stand of ``held_s``: (by, reason, limit in second).

        A reason that comes while the run stands still for another one has its whole limit from then on.
        """
        with self._lock:
            for by, limit_s in self._limits_s.items():
                if held_s - self._since_s.setdefault(by, held_s) > limit_s:
                    return by, self._reasons[by], limit_s
            return None

    def stands_for(self, by: str) -> bool:
        """Return whether the run stands still by now, and knows of this reason."""
        with self._lock:
            return by in self._since_s

    def take(self) -> Wish | None:
        """Return what is wished now: standing still comes first. A retake or skip is handed out once."""
        with self._lock:
            if self._reasons:
                by, reason = next(iter(self._reasons.items()))
                return Wish("hold", by, reason)
            wish, self._wish = self._wish, None
            return wish


class StopSwitch:
    """Turns signals into a request that the sequencer honours between steps and while it waits.

    Use as a context manager around a run; the previous handlers are put back. Once ``shield`` was called no signal
    raises any more: nothing may interrupt the way to the safe state.
    """

    def __init__(self) -> None:
        self.requested = ""
        self.fault: BenchError | None = None
        self.holds = Holds()
        self.interruptible = True  # False while the bench is put away at the end
        self.deferred = False  # True while a hold, retake or skip has to wait: the way back to the temperature
        self.live: list[Callable[[str], None]] = []  # told each sign of life of the sequencer, and what it is at
        self._shielded = False
        self._at_once = False
        self._nudged = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> StopSwitch:
        for number in _STOPS:
            self._previous[number] = signal.signal(number, self._on_signal)
        for number in _HANGUPS:
            self._previous[number] = signal.signal(number, signal.SIG_IGN)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, _: FrameType | None) -> None:
        name = signal.Signals(number).name
        again = bool(self.requested) and not self._nudged
        self.requested, self._nudged = self.requested or name, False
        if self._shielded:
            return
        if again:
            raise OperatorStop("B-RUN-011", f"stopped at once by a second signal ({name})")
        if self._at_once:
            self.check()

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """While a person is asked: the first signal raises where it arrives, nothing is under way then."""
        self.check()
        self._at_once = True
        try:
            yield
        finally:
            self._at_once = False

    @contextmanager
    def deferring(self) -> Iterator[None]:
        """Let a hold, retake or skip wait; a stop or fault still ends the run."""
        before, self.deferred = self.deferred, True
        try:
            yield
        finally:
            self.deferred = before

    def fail(self, error: BenchError) -> None:
        """End the run at the next check because of an error on another thread; the first one counts."""
        self.fault = self.fault or error
        self._nudge()

    def survive(self, error: BenchError) -> None:
        """Go on in spite of the fault of another thread; nothing if it is another one."""
        self.fault = None if self.fault is error else self.fault

    def shield(self) -> None:
        """From now on signals are noted and raise nothing."""
        self._shielded = True

    @property
    def over(self) -> bool:
        """True from the moment on when the bench is made safe at the end."""
        return self._shielded

    def request(self, who: str) -> None:
        """Stop at the next check, as the first Ctrl-C does; a person who is being asked is asked no longer."""
        self.requested = self.requested or who
        self._nudge()

    def _nudge(self) -> None:
        """Only a signal gets the thread that waits for a person out of it."""
        if self._at_once and self._previous:
            self._nudged = True
            os.kill(os.getpid(), signal.SIGTERM)

    def check(self) -> None:
        """As ``check_stop``; then raise Interruption if somebody wants the run to stand still, retake or skip."""
        self.check_stop()
        if not self.interruptible or self.deferred or self._shielded:
            return
        if (wish := self.holds.take()) is not None:
            raise Interruption(wish)

    def is_alive(self, at: str) -> None:
        """The sequencer gives a sign of life. ``at``: what it is at."""
        for hear in self.live:
            hear(at)

    def check_stop(self) -> None:
        """Raise the fault of another thread, or OperatorStop B-RUN-010 if a stop was requested."""
        self.is_alive("between two looks at what is wished")
        if self.fault is not None:
            raise self.fault
        if self.requested:
            raise OperatorStop("B-RUN-010", f"stopped by the operator ({self.requested})")


@contextmanager
def repeated(clock: Clock, stop: StopSwitch, *duties: tuple[float, Callable[[], None]]) -> Iterator[None]:
    """Do each duty again and again while this is entered, each after its own seconds; an error ends the run safely."""
    running = [clock.every(period_s, guarded(duty, stop)) for period_s, duty in duties]
    try:
        yield
    finally:
        for periodic in running:
            periodic.cancel()


def guarded(callback: Callable[[], None], stop: StopSwitch) -> Callable[[], None]:
    """Return a callback for ``Clock.every``: its error ends the run safely instead of killing its thread unseen."""

    def call() -> None:
        try:
            callback()
        except (Exception, SystemExit) as error:
            stop.fail(unforeseen(error))

    return call
