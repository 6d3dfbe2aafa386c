"""The guard as a process: hears heartbeats on its standard input, and acts when they say so or no longer come.

Everything it may need is imported and the VISA library is loaded before it says "ready"; no instrument is opened
before it acts, because not every interface bears two controllers. Only the chamber is, when the controller has had no
reading of its air for a while.
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

from bench.model.clock import NS, Clock, WallClock, to_ns
from bench.model.drivers import driver_class
from bench.model.errors import BenchError
from bench.model.lab import demand
from bench.model.ports import Instrument, actions_of
from bench.model.posix import signals
from bench.run.bus.opener import open_instrument, open_visa, unheard
from bench.run.bus.side_by_side import bus_of
from bench.run.guard.act import Controller, Opener, act
from bench.run.guard.decision import Action, Address, Brief, Watched, decide
from bench.run.guard.diary import Diary

PRIORITY = -10
_MCL_CURRENT_ON_FAULT = 1 | 4
READY = b"ready\n"
HEARD = b"."
LOOK_S = 0.1
_READ_BYTES = 65536
_DIARY_S = 10.0
_TERMINAL = signals("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP")
AIR = "chamber_air_degC"
STALE_S = 10.0  # no step talks to the chamber for so long
AGAIN_S = 5.0
_CALL_S = 0.5


def main() -> int:
    """Watch one controller. Returns: 0 once the bench is safe, 3 if it was taken over before."""
    for number in _TERMINAL:  # the guard outlives whatever ends the controller
        signal.signal(number, signal.SIG_IGN)
    lines = _Lines(0)
    brief = Brief.of_line(lines.first())
    clock = WallClock()
    controller = Controller(brief.pid)
    visa = open_visa(brief.visa, brief.boards)
    demand(brief.code, "the run")
    for entry in brief.instruments:
        driver_class(entry.driver)

    def opened(address: Address) -> Instrument:
        return open_instrument(visa, address.role, address, clock, unheard)  # its diary says what was confirmed

    diary = Diary(Path(brief.diary), clock)
    _stay_ready()
    diary.note("ready", pid=os.getpid(), controller=brief.pid, limits=dict(brief.limits), silence_s=brief.silence_s)
    os.write(1, READY)
    os.set_blocking(1, False)
    action = _watch(lines, Watched(brief.limits, brief.silence_s, clock.now_ns()), brief, opened, clock, diary)
    safe = True
    if action is None:
        diary.note("dismissed")
    else:
        safe = act(action, brief, controller, opened, clock, diary)
    diary.close(_DIARY_S)
    return 0 if safe else 3


def _stay_ready() -> None:
    """Before other work, and never waiting for its own pages to come back from the disk, where the system permits it.

    Source: mlockall(2); what is mapped now stays once it was read, no later allocation can fail for the limit.
    """
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).mlockall(_MCL_CURRENT_ON_FAULT)


def _watch(
    lines: _Lines, state: Watched, brief: Brief, opened: Opener, clock: WallClock, diary: Diary
) -> Action | None:
    """Hear heartbeats until something is to be done (the action) or the controller says goodbye (None).

    A guard that was stopped itself cannot say that its controller was silent meanwhile. It begins to wait anew, but
    once only until it hears a heartbeat again: one that hangs must not live on with a guard that is often late.
    """
    own = OwnReading(brief, opened, clock)

    def judge(limit_s: float) -> Action | None:
        for line in lines.next(limit_s):
            air_degC = own.look(_hear(state, line, clock.now_ns()))
            if air_degC is not None:
                state.values = {**state.values, AIR: air_degC}
        state.gone = lines.ended
        return decide(state, clock.now_ns())

    action, looked_ns, away_ns, anew_ns = None, clock.now_ns(), 0, -1
    while action is None and state.goodbye is None:
        heard_ns, action = state.heard_ns, judge(LOOK_S)
        if action is not None and action.reason == "silent":
            action = judge(0.0)  # it may be this process that was given no time: what came meanwhile counts
        now_ns = clock.now_ns()
        away_ns = max(now_ns - looked_ns, away_ns if state.heard_ns == heard_ns else 0)  # since the last heartbeat
        looked_ns = now_ns
        # half of the limit: the last heartbeat was up to 0.5 s old, and the controller needs some time to wake up too
        asleep = away_ns > state.silence_s / 2 * NS and state.heard_ns != anew_ns
        if action is not None and action.reason == "silent" and asleep:
            diary.note("asleep", seconds=round(away_ns / NS, 3))
            action, state.heard_ns, anew_ns = None, now_ns, now_ns
    return action


def _hear(state: Watched, line: bytes, now_ns: int) -> float | None:
    """Return one message of the controller: {"values": ...} is a heartbeat, {"goodbye": ...} the end.

    Returns: how old the controller's reading of the chamber's air is, second; None if it has none to take.
    """
    age_s: float | None = None
    with suppress(ValueError):
        message = json.loads(line)
        state.goodbye = message.get("goodbye", state.goodbye)
        state.heat_off = message.get("heat_off", False)
        state.values, state.at = message.get("values", {}), message.get("at", state.at)
        age_s = message.get("air_age_s")
        state.heard_ns = now_ns
        with suppress(OSError):  # nobody hears it any more, or nobody has read for long
            os.write(1, HEARD)
    return age_s


class _Lines:
    """Lines from a descriptor, as they come."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""
        self._whole: deque[bytes] = deque()
        self.ended = False

    def first(self) -> bytes:
        """Return the first line, however long it takes. Raises: EOFError."""
        while self._whole or not self.ended:
            for line in self.next(None):
                return line
        raise EOFError("the controller ended before it gave a brief")

    def next(self, limit_s: float | None) -> Iterator[bytes]:
        """Yield whole lines that are there after ``limit_s`` at the latest."""
        # a reader that takes one line leaves the others: a goodbye may come with the brief
        if not self._whole and select.select([self._descriptor], [], [], limit_s)[0]:
            chunk = os.read(self._descriptor, _READ_BYTES)
            self.ended = self.ended or not chunk
            *lines, self._rest = (self._rest + chunk).split(b"\n")
            self._whole.extend(lines)
        while self._whole:
            yield self._whole.popleft()


class OwnReading:
    """Reads in a thread of its own, so that an instrument that hangs keeps the guard from nothing.

    The chamber is opened when the first reading is due, and stays open; not behind an adapter, which has one client:
    the controller, as long as it lives.
    """

    def __init__(self, brief: Brief, opened: Callable[[Address], Instrument], clock: Clock) -> None:
        reached = [one for one in brief.instruments if AIR in brief.limits and bus_of(one.resource) not in brief.boards]
        self._address = next((one for one in reached if "measure_air" in actions_of(driver_class(one.driver))), None)
        self._opened = opened
        self._clock = clock
        self._chamber: Instrument | None = None
        self._thread: threading.Thread | None = None
        self._next_ns = 0
        self.newest: float | None = None

    def look(self, age_s: float | None) -> float | None:
        """Return the newest reading of its own, degC, while the controller's is older than ``STALE_S``; else None."""
        if age_s is None or age_s < STALE_S or self._address is None:
            self.newest = None
            return None
        now_ns = self._clock.now_ns()
        busy = self._thread is not None and self._thread.is_alive()
        if not busy and now_ns >= self._next_ns:
            self._next_ns = now_ns + to_ns(AGAIN_S)
            self._thread = threading.Thread(target=self._read, args=(self._address,), daemon=True)
            self._thread.start()
        return self.newest

    def _read(self, address: Address) -> None:
        try:
            if self._chamber is None:
                self._chamber = self._opened(address)
            with self._chamber.quick(_CALL_S):  # type: ignore[attr-defined]
                self.newest = float(self._chamber.measure_air())  # type: ignore[attr-defined]
        except (BenchError, OSError):
            self.newest = None
