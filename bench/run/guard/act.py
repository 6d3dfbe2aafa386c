"""The act of the guard: end the controller, take the bench, make it safe, tell it; for as long as anything is not.

Each instrument is tried by a thread of its own, so that one that hangs keeps no other waiting, and opened anew for each
attempt: a connection from before a loss may take minutes to find out that the network is back.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from bench.model.clock import NS, Clock, to_ns, utc_moment
from bench.model.drivers import driver_class
from bench.model.errors import BenchError
from bench.model.installed import unforeseen
from bench.model.ports import Effect, Instrument, actions_of, effects_of
from bench.run.bus.safety import SafeState, WayToSafe, hurried
from bench.run.guard.decision import Action, Address, Brief
from bench.run.guard.diary import Diary
from bench.run.guard.last_words import last_words, write_to_terminal
from bench.run.guard.lock import GUARD, BenchLock, bus_keys
from bench.run.guard.take_over import Request, take_over_request

LEAVE_S = 1.0  # a killed process has left by then, unless the kernel itself hangs
QUICK_S = 0.5  # longest wait of one call in the first attempt
TURN_S = 1.0  # how long the ones behind it wait for an instrument in its first attempt
PAUSE_S = 2.0  # between two attempts: one that can be reached again drives for no longer than 5 s
LOOK_S = 0.1
FIRST_TOLD_S = 15.0  # a device that restarts may need a minute, and somebody may be beside it
NOTE_S, LONG_S = 5.0, 120.0  # between two lines of the diary about one that fails alike, at first and later
TOLD_S = 600.0  # again and again, as long as something is not confirmed
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
    """Bring the bench to its safe state, however long it takes, unless somebody takes it over. Never raises.

    A controller that left by itself is not ended; until it has given the lock back the guard acts beside it.
    ``opened`` opens one instrument of the list.   Returns: whether every instrument is confirmed safe.
    """
    diary.restart()
    diary.note("act", reason=action.reason, text=action.text)
    if action.left is None:
        diary.note("controller", pid=brief.pid, ended=controller.end(LEAVE_S))
    folder = Path(brief.diary).parent
    take_over_request(folder)  # of an earlier guard
    lock = BenchLock(bus_keys(entry.resource for entry in brief.instruments), GUARD, clock)
    lock.name_session(folder.name, folder)
    turn = _Turn(lock, brief.pid, clock, diary)
    bench = _Bench(action, brief, opened, clock, diary, turn)
    bench.begin()
    told_ns = clock.now_ns() + to_ns(FIRST_TOLD_S)
    request: Request | None = None
    while bench.left and request is None and not (brief.simulated and _is_gone(folder)):
        clock.sleep(LOOK_S)
        turn.take()
        request = take_over_request(folder)
        if bench.left and clock.now_ns() >= told_ns:
            told_ns = clock.now_ns() + to_ns(TOLD_S)
            diary.note("unsafe", instruments=bench.left)
            threading.Thread(target=_tell, args=(brief, action, bench.left, clock, diary), daemon=True).start()
    bench.end()
    left = bench.left
    diary.note("unsafe" if left else "safe", instruments=left)
    if request is not None:
        diary.note("taken over", by=request.by)
    take_over_request(folder)  # one that came too late concerns no later guard of this session
    lock.release()
    _tell(brief, action, left, clock, diary, "" if request is None else request.by)
    return not left


def _is_gone(folder: Path) -> bool:
    try:
        return not folder.exists()
    except OSError:
        return False


class _Turn:
    """Whose turn it is on the bench: the guard's while it has the lock, while nobody has, and beside its controller."""

    def __init__(self, lock: BenchLock, controller: int, clock: Clock, diary: Diary) -> None:
        self._lock, self._controller, self._clock, self._diary = lock, controller, clock, diary
        self._said = ""
        self.mine = True
        end_ns = clock.now_ns() + to_ns(LEAVE_S)
        while not self.take(said=clock.now_ns() >= end_ns) and clock.now_ns() < end_ns:
            clock.sleep(PAUSE_S / 50)

    def take(self, *, said: bool = True) -> bool:
        """Take the lock if it is free; returns whether it is held. One that cannot be had keeps nobody safe."""
        if self._lock.held:
            return True
        try:
            other = self._lock.attempt()
            text = "taken" if other is None else f"held by process {other[1].get('pid', 'unknown')}"
            self.mine = other is None or other[1].get("pid") == self._controller
        except BenchError as error:
            text, self.mine = error.message, True
        if text != self._said and (said or self._lock.held):
            self._said = text
            self._diary.note("lock", text=text)
        return self._lock.held


class _Bench:
    """The instruments of the safe-state list, each on its way by a thread of its own."""

    def __init__(self, action: Action, brief: Brief, opened: Opener, clock: Clock, diary: Diary, turn: _Turn) -> None:
        self._addresses = [a for a in brief.instruments if action.left is None or a.role in action.left]
        if action.heat_off:
            self._addresses.sort(key=lambda address: heats(driver_class(address.driver)), reverse=True)
        self._clock, self._diary, self._turn = clock, diary, turn
        self._threads: list[threading.Thread] = []
        self._over = threading.Event()
        self._remotes = {a.role: _Remote(a, action.heat_off, opened, self._over) for a in self._addresses}
        self._ways = {role: WayToSafe({role: remote}, (role,), clock) for role, remote in self._remotes.items()}

    @property
    def left(self) -> dict[str, SafeState]:
        """What is not confirmed safe."""
        return {role: state for way in self._ways.values() for role, state in way.left.items()}

    def begin(self) -> None:
        """Begin with each in the stated order; one that is mute costs those behind it ``TURN_S``."""
        for address in self._addresses:
            tried = threading.Event()
            thread = threading.Thread(target=self._tried_until_safe, args=(address.role, tried), daemon=True)
            self._threads.append(thread)
            thread.start()
            if not tried.wait(TURN_S):
                self._diary.note("instrument", role=address.role, safe=False, text="still trying")

    def end(self) -> None:
        """Try nothing any more; the last words of those that are done come before what is said of all."""
        self._over.set()
        for thread in self._threads:
            thread.join(LOOK_S)
        for remote in self._remotes.values():
            remote.close()  # not every instrument bears two connections

    def _tried_until_safe(self, role: str, tried: threading.Event) -> None:
        way, said, noted_ns = self._ways[role], "", 0
        began_ns = self._clock.now_ns()
        quick: Sequence[str] = (role,)
        while way.left and not self._over.is_set():
            if self._turn.mine:
                way.attempt(quick=quick)
                error = way.failures.get(role)
                text = "answered, and is asked once more" if error is None else str(unforeseen(error))
                now_ns = self._clock.now_ns()
                again_s = NOTE_S if now_ns - began_ns < to_ns(LONG_S) else LONG_S
                if way.left and (text != said or now_ns >= noted_ns + to_ns(again_s)):
                    noted_ns, said = now_ns, text
                    self._diary.note("instrument", role=role, safe=False, state=way.left[role], text=text)
            tried.set()
            quick = ()
            if way.left:
                self._clock.sleep(PAUSE_S)
        if not way.left:
            took_s = round((self._clock.now_ns() - began_ns) / NS, 3)
            self._diary.note("instrument", role=role, safe=True, state="confirmed off", took_s=took_s)


class _Remote:
    """One instrument as something that can be made safe: opened, told, confirmed, and closed again if that fails."""

    def __init__(self, address: Address, heat_off: bool, opened: Opener, over: threading.Event) -> None:
        self._address, self._heat_off, self._opened, self._over = address, heat_off, opened, over
        self._open: Instrument | None = None
        self._limit_s: float | None = None

    @contextmanager
    def quick(self, limit_s: float) -> Iterator[None]:
        """No call waits longer than ``QUICK_S``."""
        self._limit_s = max(limit_s, QUICK_S)
        try:
            yield
        finally:
            self._limit_s = None

    def make_safe(self) -> None:
        """Bring it to its safe state. Raises: whatever the driver raises."""
        try:
            if self._open is None:
                self._open = self._opened(self._address)
            if self._over.is_set():  # it took long: the bench is somebody else's by now
                raise ConnectionAbortedError("the bench was let go")
            with hurried(self._open, self._limit_s):
                _clear(self._open, self._address.resource)
                put_safe(self._open, self._heat_off)
        except Exception:
            self.close()
            raise

    def close(self) -> None:
        """Release the instrument."""
        instrument, self._open = self._open, None
        if instrument is not None:
            with suppress(Exception):
                instrument.close()


def put_safe(instrument: Instrument, heat_off: bool) -> None:
    """The declared safe state; with ``heat_off`` a source of heat is stopped, not held."""
    stop = actions_of(type(instrument)).get("stop")
    if heat_off and stop is not None and stop.effect is Effect.THERMAL:
        instrument.stop()  # type: ignore[attr-defined]
    else:
        instrument.make_safe()


def heats(driver: type) -> bool:
    """Return whether instruments of a driver are sources of heat."""
    return Effect.THERMAL in effects_of(driver)


def _clear(instrument: Instrument, resource: str) -> None:
    """Whatever the controller was in the middle of is over; a network connection of the guard's own begins clean."""
    clear = getattr(getattr(instrument, "bus", None), "clear", None)
    if clear is not None and not resource.upper().startswith("TCPIP"):
        with suppress(BenchError, OSError):
            clear()


def _tell(
    brief: Brief, action: Action, left: Mapping[str, SafeState], clock: Clock, diary: Diary, by: str = ""
) -> None:
    """Tell the terminal of the controller and everybody who wants to know of alarms."""
    utc = utc_moment(clock.utc_ns()).isoformat()
    word = {"reason": action.text, "safe": not left, "unsafe": left, "utc": utc, "by": by}
    write_to_terminal(brief.terminal, last_words(word, str(Path(brief.diary).parent)))
    if not brief.notify:
        return
    done = {"reason": action.reason, "text": action.text, "unsafe": dict(left)}
    message = {"kind": "alarm", "event": "guard", "session": Path(brief.diary).parent.name, **done}
    try:
        ended = subprocess.run(
            brief.notify, input=json.dumps(message), text=True, timeout=_NOTIFY_S, check=False, capture_output=True
        )
        diary.note("notify", status=ended.returncode, text=ended.stderr[-_TAIL:])
    except (OSError, subprocess.SubprocessError) as error:
        diary.note("notify", text=str(error))
