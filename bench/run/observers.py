"""Observers of a run, in a stated order: the recorder first, so that nobody acts on what is not written.

There is one list. Nobody stands between the run and somebody else, and nobody is replaced. A disk that refuses for a
while ends nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from enum import IntEnum
from pathlib import Path
from typing import Any, ClassVar, Protocol

from bench.frame import LinkBatch
from bench.model.clock import Clock
from bench.model.errors import OperatorStop
from bench.model.events import Disk, Event
from bench.model.ports import SessionSink
from bench.plan import SetPoint, Step
from bench.record import PackedList, RecordError, RecordRow

StoredEvent = tuple[str, int, Mapping[str, Any]]
"""Kind, monotonic time in ns and fields, as a session has them."""
DISK_REFUSES = ("B-REC-001", "B-REC-005")


class Order(IntEnum):
    """Places in the order of observers; at the same place, who came first hears first."""

    RECORDER = 0
    PLACE = 1  # where the run is, for those behind
    SAFETY = 2  # links and interlocks
    WATCHERS = 3  # trend, feed, notifications
    TERMINAL = 4


class Observer:
    """Hears what it has a method for, on the thread it comes from, and must not wait.

    ``vital``: the run cannot do without it, so its error is an error of the run. Any other observer that raises is not
    told anything any more, and ``loss`` is said once: the run goes on.
    """

    order: ClassVar[Order] = Order.WATCHERS
    vital: ClassVar[bool] = False
    loss: ClassVar[str] = ""

    def event(self, event: Event, t_mono_ns: int) -> None:
        """Something happened."""

    def step(self, step: Step, at_s: float) -> None:
        """A step begins; ``at_s`` = seconds since the start of the run."""

    def set_point(self, asked: SetPoint) -> None:
        """The chamber was given a set-point, by a step or on the way back into a plan."""

    def record(self, row: RecordRow) -> None:
        """A record is complete."""

    def batch(self, link: str, batch: LinkBatch) -> None:
        """Frames of a link were decoded."""

    def traffic(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        """A command to ("tx") or reply of ("rx") an instrument."""

    def message(self, text: str) -> None:
        """Something a person should read that is no event."""

    def failed(self) -> None:
        """It has raised, and is not told anything any more."""


_TOLD = ("event", "step", "set_point", "record", "batch", "traffic", "message")


def _hears(observer: Observer, name: str) -> bool:
    return getattr(type(observer), name) is not getattr(Observer, name)


class Observers:
    """The list."""

    def __init__(self, clock: Clock, *observers: Observer) -> None:
        self._clock = clock
        self._observers: tuple[Observer, ...] = ()
        self._who_hears: dict[str, tuple[Observer, ...]] = {}  # by name of what is told
        for observer in observers:
            self.add(observer)

    def add(self, observer: Observer) -> None:
        """Tell somebody else too from now on."""
        self._set(sorted((*self._observers, observer), key=lambda other: other.order))

    def _set(self, observers: Iterable[Observer]) -> None:
        self._observers = tuple(observers)
        self._who_hears = {
            name: tuple(observer for observer in self._observers if _hears(observer, name)) for name in _TOLD
        }

    def event(self, event: Event) -> None:
        """Something happens now. Raises: what a vital observer raises; those behind it are not told then."""
        self._tell("event", event, self._clock.now_ns())

    def note(self, event: Event) -> None:
        """Something happens that nothing depends on: a person hears of it even if the disk refuses it."""
        try:
            self.event(event)
        except RecordError:
            if event.told:
                self.message(event.sentence)

    def step(self, step: Step, at_s: float) -> None:
        """A step begins."""
        self._tell("step", step, at_s)

    def set_point(self, asked: SetPoint) -> None:
        """The chamber was given a set-point."""
        self._tell("set_point", asked)

    def record(self, row: RecordRow) -> None:
        """A record is complete."""
        self._tell("record", row)

    def batch(self, link: str, batch: LinkBatch) -> None:
        """Frames of a link were decoded."""
        self._tell("batch", link, batch)

    def traffic(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        """A command went to an instrument, or its reply came."""
        self._tell("traffic", role, direction, text, t_mono_ns)

    def message(self, text: str) -> None:
        """Say something to a person."""
        self._tell("message", text)

    def _tell(self, name: str, *told: Any) -> None:
        for observer in self._who_hears[name]:
            if observer.vital:
                getattr(observer, name)(*told)
                continue
            try:
                getattr(observer, name)(*told)
            except OperatorStop:  # a second signal, wherever it comes
                raise
            except (Exception, SystemExit) as error:  # a terminal that hung up: some writers want to exit then
                self._drop(observer, error)

    def _drop(self, observer: Observer, error: BaseException) -> None:
        if observer not in self._observers:
            return
        self._set(other for other in self._observers if other is not observer)
        observer.failed()
        if observer.loss:
            self.message(f"{observer.loss} ({type(error).__name__}: {error}); the run goes on")


class Recorder(Observer):
    """Writes everything into the session, and keeps events of some kinds for the end of the run.

    A command to an instrument goes on if the disk is full, least of all is the one kept back that makes it safe: the
    recorder reports the fault by itself at its next tick.
    """

    order = Order.RECORDER
    vital = True

    def __init__(self, sink: SessionSink, kinds: Collection[str] = ()) -> None:
        self._sink = sink
        self._kinds = frozenset(kinds)
        self._kept: PackedList[StoredEvent] = PackedList()

    def event(self, event: Event, t_mono_ns: int) -> None:
        """Write an event."""
        if not event.recorded:
            return
        document = event.document()
        self._sink.event(event.kind, t_mono_ns, document)
        if event.kind in self._kinds:
            self._kept.append((event.kind, t_mono_ns, document))

    def traffic(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        """Write a command or reply."""
        with suppress(RecordError):
            self._sink.command(role, direction, text, t_mono_ns)

    @property
    def events(self) -> list[StoredEvent]:
        """The events that were kept, in order."""
        return list(self._kept)


class Listener(Protocol):
    """A person at the terminal (progress bar, plain lines)."""

    def step(self, step: Step, at_s: float) -> None:
        """A step begins; ``at_s`` = seconds since the start of the run."""

    def record(self, row: RecordRow) -> None:
        """A record is complete."""

    def message(self, text: str) -> None:
        """Something a person should read."""


class AtTerminal(Observer):
    """Tells a listener what happens; one that is gone is no reason to stop measuring."""

    order = Order.TERMINAL

    def __init__(self, listener: Listener) -> None:
        self._listener = listener

    def event(self, event: Event, t_mono_ns: int) -> None:
        if event.told:
            self._listener.message(event.sentence)

    def step(self, step: Step, at_s: float) -> None:
        self._listener.step(step, at_s)

    def record(self, row: RecordRow) -> None:
        self._listener.record(row)

    def message(self, text: str) -> None:
        self._listener.message(text)


def patient(write: Callable[..., None], tell: Callable[[Disk], None]) -> Callable[..., None]:
    """Return the same call of the recorder, which goes on while the disk refuses.

    What a session was given is held until the disk takes it (B-REC-001), a line of the step journal is left out
    (B-REC-005). ``tell`` is called once per trouble. When too much is held, or for too long, the recorder raises
    B-REC-003, and that ends the run.
    """
    said = False

    def call(*arguments: Any) -> None:
        nonlocal said
        try:
            write(*arguments)
        except RecordError as error:
            if error.code not in DISK_REFUSES:
                raise
            if not said:
                tell(Disk(code=error.code, text=str(error)))
            said = True
        else:
            said = False

    return call


class HeldTranscript:
    """Holds commands and replies until a session is there, then hands them on as they come.

    ``earlier`` are those from before the session.
    """

    def __init__(self) -> None:
        self._held: list[tuple[str, str, str, int]] = []
        self._observers: Observers | None = None
        self.earlier: tuple[tuple[str, str, str, int], ...] = ()
        self.on_traffic: Callable[[str], None] = lambda at: None  # a sign of life of whoever talks, and of what to

    def __call__(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        self.on_traffic(f"{role} {text}")
        if self._observers is None:
            self._held.append((role, direction, text, t_mono_ns))
        else:
            self._observers.traffic(role, direction, text, t_mono_ns)

    def attach(self, observers: Observers) -> None:
        """Tell what was held, and everything from now on."""
        self._held.sort(key=lambda line: line[3])  # instruments of different buses were asked side by side
        for line in self._held:
            observers.traffic(*line)
        self.earlier = tuple(self._held)
        self._held.clear()
        self._observers = observers


def new_folder(out: Path, name: str) -> Path:
    """Return a folder that does not exist yet; a taken name gets the suffix -2, -3 ..., which appears in no file."""
    folder = out / name
    suffix = 2
    while folder.exists():
        folder = out / f"{name}-{suffix}"
        suffix += 1
    return folder
