"""The act of the guard: end the controller, take the bench, make it safe, tell it."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.model.clock import NS, Clock, to_ns
from bench.model.drivers import driver_class
from bench.model.errors import BenchError
from bench.model.ports import Effect, Instrument, actions_of
from bench.run.bench.safety import hurried
from bench.run.guard.decision import Action, Address, Brief
from bench.run.guard.diary import Diary
from bench.run.guard.lock import GUARD, BenchLock, bus_keys

LEAVE_S = 1.0  # a killed process has left by then, unless the kernel itself hangs
QUICK_S = 0.5  # longest wait of one call in the first pass
TURN_S = 1.0  # how long the others wait for one instrument in the first pass, and later
LATER_TURN_S = 2.0
LAST_S = 60.0  # no more attempts after that
PAUSE_S = 1.0
_NOTIFY_S = 120.0
_TAIL = 300

Opener = Callable[[Address], Instrument]


class Controller:
    """The parent process. The handle is a process file descriptor (Linux 5.3); elsewhere the parent's number, which
    is trusted only while it is still the parent's.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._handle: int | None = None
        with suppress(OSError, AttributeError):
            self._handle = os.pidfd_open(pid)
        self._gone = os.getppid() != pid  # it died before its handle was open: the number may be somebody else's

    def end(self, limit_s: float) -> bool:
        """Kill it, stopped or not, and wait until it has left; False if it has not after ``limit_s``."""
        if self._gone:
            return True
        with suppress(ProcessLookupError):
            if self._handle is not None:
                signal.pidfd_send_signal(self._handle, signal.SIGKILL)
            elif os.getppid() == self._pid:
                os.kill(self._pid, signal.SIGKILL)
        if self._handle is None:
            return os.getppid() != self._pid
        readable, _, _ = select.select([self._handle], [], [], limit_s)
        return bool(readable)


def act(action: Action, brief: Brief, controller: Controller, opened: Opener, clock: Clock, diary: Diary) -> bool:
    """Bring the bench to its safe state; returns whether every instrument is confirmed safe. Never raises.

    ``opened`` opens one instrument of the list.
    """
    diary.restart()
    diary.note("act", reason=action.reason, text=action.text)
    diary.note("controller", pid=brief.pid, ended=controller.end(LEAVE_S))
    lock = BenchLock(bus_keys(entry.resource for entry in brief.instruments), GUARD, clock)
    _take(lock, clock, diary)
    bench = _Bench(brief.instruments, action.heat_off, opened, clock, diary)
    unsafe = bench.make_safe()
    diary.note("safe" if not unsafe else "unsafe", instruments=unsafe)
    lock.release()
    _tell(brief, {"reason": action.reason, "text": action.text, "unsafe": unsafe}, diary)
    return not unsafe


def _take(lock: BenchLock, clock: Clock, diary: Diary) -> None:
    """Take the lock. One that is not free keeps nobody safe: the first passes are made all the same."""
    end_ns = clock.now_ns() + to_ns(LEAVE_S)
    while True:
        try:
            lock.take()
        except BenchError as error:
            if clock.now_ns() < end_ns:
                clock.sleep(PAUSE_S / 50)
                continue
            diary.note("lock", text=error.message)
        else:
            diary.note("lock", text="taken")
        return


class _Bench:
    """The instruments of the safe-state list; each is opened when its turn comes, and stays open."""

    def __init__(
        self, addresses: Sequence[Address], heat_off: bool, opened: Opener, clock: Clock, diary: Diary
    ) -> None:
        self._addresses = list(addresses)
        if heat_off:
            self._addresses.sort(key=lambda address: heats(driver_class(address.driver)), reverse=True)
        self._heat_off = heat_off
        self._opened = opened
        self._clock = clock
        self._diary = diary
        self._open: dict[str, Instrument] = {}
        self._turns: dict[str, threading.Thread] = {}
        self._safe: set[str] = set()

    def make_safe(self) -> list[str]:
        """Return one quick pass in order, then more with patience; returns the roles that are not confirmed safe."""
        end_ns = self._clock.now_ns() + to_ns(LAST_S)
        self._pass(TURN_S, QUICK_S)
        while self._left() and self._clock.now_ns() < end_ns:
            self._clock.sleep(PAUSE_S)
            self._pass(LATER_TURN_S, None)
        return self._left()

    def _left(self) -> list[str]:
        return [address.role for address in self._addresses if address.role not in self._safe]

    def _pass(self, turn_s: float, call_s: float | None) -> None:
        for address in self._addresses:
            if address.role in self._safe:
                continue
            turn = self._turns.get(address.role)
            if turn is None or not turn.is_alive():
                turn = threading.Thread(target=self._turn, args=(address, call_s), daemon=True)
                self._turns[address.role] = turn
                turn.start()
            turn.join(turn_s)  # one that hangs goes on by itself: the others do not wait for it
            if turn.is_alive():
                self._diary.note("instrument", role=address.role, safe=False, text="still trying")

    def _turn(self, address: Address, call_s: float | None) -> None:
        started_ns = self._clock.now_ns()
        try:
            instrument = self._open.get(address.role)
            if instrument is None:
                instrument = self._opened(address)
                self._open[address.role] = instrument
            with hurried(instrument, call_s):
                _clear(instrument, address.resource)
                put_safe(instrument, self._heat_off)
        except Exception as error:  # whatever it is, the instruments after this one must still be made safe
            self._diary.note("instrument", role=address.role, safe=False, text=" ".join(str(error).split()))
            return
        self._safe.add(address.role)
        took_s = round((self._clock.now_ns() - started_ns) / NS, 3)
        self._diary.note("instrument", role=address.role, safe=True, took_s=took_s)


def put_safe(instrument: Instrument, heat_off: bool) -> None:
    """The declared safe state; with ``heat_off`` a source of heat is stopped, not held."""
    stop = actions_of(type(instrument)).get("stop")
    if heat_off and stop is not None and stop.effect is Effect.THERMAL:
        instrument.stop()  # type: ignore[attr-defined]
    else:
        instrument.make_safe()


def heats(driver: type) -> bool:
    """Return whether instruments of a driver are sources of heat."""
    return any(action.effect is Effect.THERMAL for action in actions_of(driver).values())


def _clear(instrument: Instrument, resource: str) -> None:
    """Whatever the controller was in the middle of is over; a network connection of the guard's own begins clean."""
    clear = getattr(getattr(instrument, "bus", None), "clear", None)
    if clear is not None and not resource.upper().startswith("TCPIP"):
        with suppress(BenchError, OSError):
            clear()


def _tell(brief: Brief, done: Mapping[str, Any], diary: Diary) -> None:
    if not brief.notify:
        return
    message = {"kind": "alarm", "event": "guard", "session": Path(brief.diary).parent.name, **done}
    try:
        ended = subprocess.run(
            brief.notify, input=json.dumps(message), text=True, timeout=_NOTIFY_S, check=False, capture_output=True
        )
        diary.note("notify", status=ended.returncode, text=ended.stderr[-_TAIL:])
    except (OSError, subprocess.SubprocessError) as error:
        diary.note("notify", text=str(error))
