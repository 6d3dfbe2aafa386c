"""Everything a step needs while it is executed."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from bench.model.clock import Clock
from bench.model.ports import Instrument, RecordWindow, SessionSink
from bench.plan import Plan, Step
from bench.record import PackedRows, RecordCutter, RecordRow
from bench.run.control.operator import Operator
from bench.run.guard.health import SEQUENCER, Health
from bench.run.links.acquisition import Acquisition
from bench.run.steps.timing import Timeline
from bench.run.stop import StopSwitch

Traffic = Callable[[str, str, str, int], None]
"""Takes role, direction ("tx" or "rx"), text and monotonic time in ns."""


class Listener(Protocol):
    """Who watches a run (progress bar, plain lines)."""

    def step(self, step: Step, at_s: float) -> None:
        """A step begins; ``at_s`` = seconds since the start of the run."""

    def record(self, row: RecordRow) -> None:
        """A record is complete."""

    def message(self, text: str) -> None:
        """Something a person should read."""


class InUse:
    """Which instruments the steps are talking to right now, so that nobody cuts into a sequence of commands.

    Thread-safe: a step and somebody who waits for an instrument to come back may use the same one.
    ``newest`` is the role that was taken last: of a step that uses several, the one that failed.
    """

    newest = ""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users: Counter[object] = Counter()

    @contextmanager
    def take(self, role: str) -> Iterator[None]:
        """Use an instrument for one step."""
        with self._lock:
            self._users[role] += 1
            self.newest = role
        try:
            yield
        finally:
            with self._lock:
                self._users[role] -= 1

    def __contains__(self, role: object) -> bool:
        return self._users[role] > 0


@dataclass
class RunContext:
    """State of one run; the flat plan plus these few values are the whole position.

    ``cutter`` cuts the records out of the frames of ``measurement_link``; None and "" where a plan names no link.
    ``settled`` is False from a soak that was left before the temperature was stable (policy skip) to the next soak.
    ``folder`` is the session's.
    ``unit_answer`` is who the unit said it was before a run that is gone on with was stopped.
    ``away`` are the instruments the run stands still for.
    ``ahead`` holds the windows that are open before their record step, by number of the step.
    ``manifest`` is the session's; ``traffic`` are called with every command and reply of an instrument (``earlier``:
    those before the session), ``told`` with every message for a person. They must not wait.
    ``operate`` does on a simulated bench what a person did by a prompt (name, value).
    """

    plan: Plan
    instruments: dict[str, Instrument]
    acquisition: Acquisition
    cutter: RecordCutter | None
    clock: Clock
    sink: SessionSink
    operator: Operator
    listener: Listener
    stop: StopSwitch
    timeline: Timeline
    measurement_link: str
    rows: PackedRows = field(default_factory=PackedRows)
    ahead: dict[int, RecordWindow] = field(default_factory=dict)
    away: set[str] = field(default_factory=set)
    record_count: int = 0
    retaken: int = 0
    overruns: int = 0
    settled: bool = True
    unit_answer: bytes | None = None
    folder: Path = Path()
    manifest: Mapping[str, Any] = field(default_factory=dict)
    earlier: tuple[tuple[str, str, str, int], ...] = ()
    traffic: list[Traffic] = field(default_factory=list)
    told: list[Callable[[str], None]] = field(default_factory=list)
    operate: Callable[[str, Any], None] = lambda name, value: None
    in_use: InUse = field(default_factory=InUse)
    health: Health = field(init=False)

    def __post_init__(self) -> None:
        self.health = Health(self.clock)
        self.stop.on_check = lambda: self.health.alive(SEQUENCER)

    def drop_open_records(self, count: int) -> None:
        """Forget the windows that are open, and every number given since ``count`` records were taken."""
        if self.cutter is not None:
            self.cutter.close_all()
        self.ahead.clear()
        self.record_count = count

    @property
    def frames_cutter(self) -> RecordCutter:
        """The cutter, for a record that is made of frames."""
        assert self.cutter is not None, "a plan without a link has no record of frames"
        return self.cutter

    def event(self, kind: str, **fields: object) -> None:
        """Write an event with the time of now."""
        self.sink.event(kind, self.clock.now_ns(), fields)

    @property
    def unit_temperature_degC(self) -> float:
        """Newest temperature the unit reported, degC; NaN if there is none of the last seconds."""
        return self.acquisition.unit_temperature_degC()
