"""Tells people what happens in a run, without ever keeping the run waiting.

Messages go into a bounded queue; one thread sends them, each way a few times. What does not get through becomes an
event "notify" of the session. A heartbeat goes out by command and webhook, so that silence itself is an alarm.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from bench.model.clock import NS, utc_text
from bench.model.events import Alarm, Deviation, End, Error, Event, Hold, Interlock, Notify, Release, Verdict
from bench.model.yamlio import load_yaml
from bench.plan import Notify as NotifySection
from bench.run.context import RunContext
from bench.run.guard.notify_ways import ATTEMPTS, Message, NotSent, ways_of
from bench.run.observers import Observer
from bench.run.stop import repeated

LONGEST_QUEUE = 100
PAUSE_S = 5.0
LAST_WORDS_S = 20.0  # what is still in the queue at the end of a run has this long
HEARTBEAT = "heartbeat"
READ_BY_PEOPLE = ("email", "apprise")  # who would not want a sign of life each ten minutes


Shelved = Callable[[Event, float], bool]
"""Whether somebody has shelved what an event tells of, at a moment (UTC, seconds since 1970)."""


def nothing_shelved(event: Event, t_utc_s: float) -> bool:
    """Return that nothing is."""
    return False


def occasion(event: Event) -> str:
    """Return which occasion an event is: hold, alarm, end, error, or "" for one that nobody is told of."""
    match event:
        case Hold() | Release():
            return "hold"
        case Deviation(state="over"):
            return ""
        case Alarm() | Interlock(state="tripped" | "stale") | Verdict(ok=False):
            return "alarm"
        case End() | Error():
            return event.kind
    return ""


class Notifier(Observer):
    """Sends the messages of one run; ``event`` never waits. ``bench`` says in a line what is on."""

    loss = "nobody is notified any more"

    def __init__(
        self,
        notify: NotifySection,
        context: RunContext,
        bench: Callable[[], str],
        pause_s: float = PAUSE_S,
        shelved: Shelved = nothing_shelved,
    ) -> None:
        self._notify = notify
        self._context = context
        self._bench = bench
        self._pause_s = pause_s
        self._shelved = shelved
        self._queue: deque[Message] = deque()
        self._dropped = 0
        self._wake = threading.Condition()
        self._ending = threading.Event()  # no more pauses between attempts
        self._ended = False
        self._thread = threading.Thread(target=self._send_all, name="notify", daemon=True)
        self._thread.start()

    def event(self, event: Event, t_mono_ns: int) -> None:
        """Queue what an event says, if somebody wants to know."""
        which, t_utc_s = occasion(event), self._context.clock.utc_ns() / NS
        if which in self._notify.on and not (which == "alarm" and self._shelved(event, t_utc_s)):
            said = {name: str(value) for name, value in event.document().items()}
            self._put({"kind": which, "event": event.kind, **said})

    def beat(self) -> None:
        """Queue a sign of life; one that would have to wait behind others is left out."""
        with self._wake:
            waiting = bool(self._queue)
        if not waiting:
            self._put({"kind": HEARTBEAT})

    def close(self) -> None:
        """Send what is left, within ``LAST_WORDS_S``."""
        self._ending.set()
        with self._wake:
            self._ended = True
            self._wake.notify()
        self._thread.join(LAST_WORDS_S)

    def _put(self, message: Message) -> None:
        utc = utc_text(self._context.clock.utc_ns())
        message |= {"bench": self._bench(), "session": self._context.folder.name, "utc": utc}
        with self._wake:
            if len(self._queue) >= LONGEST_QUEUE:
                self._queue.popleft()
                self._dropped += 1
            self._queue.append(message)
            self._wake.notify()

    def _send_all(self) -> None:
        while True:
            with self._wake:
                while not self._queue and not self._ended:
                    self._wake.wait()
                if not self._queue:
                    return
                message = self._queue.popleft()
                message |= {"left_out": self._dropped} if self._dropped else {}
                self._dropped = 0
            for name, send in ways_of(self._notify):
                if name not in READ_BY_PEOPLE or message["kind"] != HEARTBEAT:
                    self._send(name, send, message)

    def _send(self, name: str, send: Callable[[Message], None], message: Message) -> None:
        """Try a few times; a failure is an event, never an error of the run."""
        why = ""
        for attempt in range(1 if message["kind"] == HEARTBEAT else ATTEMPTS):
            if attempt:
                self._ending.wait(self._pause_s)
            try:
                send(message)
            except NotSent as error:
                why = str(error)
            except Exception as error:  # a bad address, a header that cannot be: the run goes on
                why = type(error).__name__
            else:
                return
        self._context.note(Notify(way=name, message=message["kind"], sent=False, why=why))


@contextmanager
def notifications(
    context: RunContext, notify: NotifySection, bench: Callable[[], str], shelved: Shelved = nothing_shelved
) -> Iterator[Notifier]:
    """Tell people while the run goes on, on the wall clock; nobody of an alarm that is ``shelved``."""
    notifier = Notifier(notify, context, bench, shelved=shelved)
    context.observers.add(notifier)
    duties = [] if notify.heartbeat is None else [(notify.heartbeat, notifier.beat)]
    if duties:
        notifier.beat()
    try:
        with repeated(context.clock, context.stop, *duties):
            yield notifier
    finally:
        notifier.close()


def user_notify(environment: Mapping[str, str]) -> NotifySection | None:
    """Return what ``inertial-bench/notify.yaml`` in the user's configuration folder says; None without such a file.

    Raises: InputErrors with every mistake and its position.
    Source: XDG Base Directory Specification: XDG_CONFIG_HOME, else ~/.config.
    """
    base = environment.get("XDG_CONFIG_HOME", "")
    folder = Path(base) if Path(base).is_absolute() else Path(environment.get("HOME", "/")) / ".config"
    path = folder / "inertial-bench" / "notify.yaml"
    return load_yaml(path, NotifySection).model if path.is_file() else None
