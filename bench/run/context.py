"""Everything a step needs while it is executed, and the campaign's timeline: planned times, slip, how late steps were.

Overrun policy: planned time advances only in settle, record and soak steps. A bus call that takes longer than the
settle time it shares shifts everything after it (a *slip*, recorded as an event and reported); a settle time never
gets shorter than what its plan leaves after the bus calls, and a record is never cut short.

What was read and decided is known by the events of the session: a run that is gone on with knows the same.
"""

from __future__ import annotations

import math
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import InitVar, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from bench.maths.relaxation import Lag
from bench.model.clock import NS, Clock, to_ns
from bench.model.events import Decision, Event, Prompt, Reading, ThermalLag, UnitLeftOut, by_instrument
from bench.model.ports import Instrument, RecordWindow
from bench.model.quantities import Values
from bench.plan import Plan, PlannedCall, PlannedDecision, PlannedUnit, Step, is_answered, left_out_by
from bench.record import PackedRows, RecordCutter
from bench.run.bus.acquisition import Acquisition
from bench.run.observers import Observers
from bench.run.operator import Operator
from bench.run.stop import AWAY_LIMIT_S, SEQUENCER, Health, StopSwitch, Wish


@dataclass(frozen=True)
class Read:
    """A reading: its value, None if there should have been one, and the step that took it."""

    value: float | None
    step: int


KNOWN = 0.2  # of a lag, one standard uncertainty: with less nothing is ended by it


class Decided:
    """The newest reading of each action, the outcome of each decision, and the steps that are left out by them.

    ``lags``: of the units, by serial number, None where a bench has only one; as soon as they are ``KNOWN``.

    Args: steps: those of the plan, so that a number is an index.
    """

    def __init__(self, steps: Sequence[Step]) -> None:
        self._steps = steps
        self._follows = any(isinstance(step, PlannedDecision) for step in steps)
        self._newest: dict[tuple[str, str, str], tuple[Values, Read]] = {}  # oldest first
        self.outcomes: dict[int, str] = {}
        self.left_out: set[int] = set()
        self.units_out: set[str] = set()  # serial numbers of units that are left out
        self.lags: dict[str | None, Lag] = {}

    def take(self, event: Event) -> None:
        """Take what an event says of it; of readings a plan without decisions needs to know nothing."""
        if isinstance(event, UnitLeftOut):
            self.units_out.add(str(event.uut))
            self.left_out.update(*left_out_by(self._steps, [event]))
        elif isinstance(event, ThermalLag) and event.share <= KNOWN:
            self.lags[event.uut] = Lag(event.lag_s, event.share)
        if not self._follows:
            return
        if isinstance(event, Reading):
            self._read(event.role, event.name, self._arguments(event), event.value, event.step)
        elif isinstance(event, Prompt) and event.quantity:
            self._read("", event.quantity, {}, event.value, event.step)
        elif isinstance(event, Decision):
            self.outcomes[event.step] = event.outcome
            self.left_out.update(*left_out_by(self._steps, [event]))

    def newest(self, decision: PlannedDecision) -> Read | None:
        """Return the newest reading that a decision asks for, None if it was never taken."""
        for (role, name, _), (arguments, read) in reversed(self._newest.items()):
            if (role, name) == (decision.role, decision.name) and is_answered(decision, arguments):
                return read
        return None

    def _read(self, role: str, name: str, arguments: Values, value: Any, step: int) -> None:
        key = role, name, repr(sorted(arguments.items()))
        self._newest.pop(key, None)
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        self._newest[key] = arguments, Read(float(value) if number else None, step)

    def _arguments(self, event: Reading) -> Values:
        if event.arguments is not None:
            return event.arguments
        step = self._steps[event.step] if 0 <= event.step < len(self._steps) else None
        return step.arguments if isinstance(step, PlannedCall) else {}


_CONTIGUOUS_S = 1e-6  # planned times are rounded to a thousandth of that
_WALL_SLICE_NS = NS // 4  # how soon a stop is honoured; a virtual wait takes no real time and is never sliced


@dataclass
class Timeline:
    """Maps planned seconds of one phase to the bench clock.

    ``slip_ns`` is how much later than planned the phase runs now; ``lateness_ns`` holds one value per timed wait.
    ``done_s``: planned end of the step that is done, None where the run has jumped for another reason than a decision.
    """

    clock: Clock
    stop: StopSwitch
    origin_ns: int
    slip_ns: int = 0
    lateness_ns: list[int] = field(default_factory=list)
    done_s: float | None = None

    def target_ns(self, at_s: float) -> int:
        """Return bench-clock time of a planned moment, slip included."""
        return self.origin_ns + to_ns(at_s) + self.slip_ns

    def wait_until(self, at_s: float) -> None:
        """Wait for a planned moment and note how late it is left."""
        target = self.target_ns(at_s)
        self.wait_until_ns(target)
        late = self.clock.now_ns() - target
        self.lateness_ns.append(late)

    def reach(self, at_s: float) -> None:
        """Wait for the planned start of a step; one that is already past by then starts at once."""
        if self.target_ns(at_s) > self.clock.now_ns():
            self.wait_until(at_s)

    def bring_forward(self, at_s: float) -> None:
        """Leave out the planned time that a decision leaves between the step that is done and the one that begins."""
        gap_s = 0.0 if self.done_s is None else at_s - self.done_s
        if gap_s > _CONTIGUOUS_S:
            self.leave_out(gap_s)

    def leave_out(self, seconds: float) -> None:
        """Bring everything that follows forward: so much planned time is left out."""
        self.origin_ns -= to_ns(seconds)

    def wait_until_ns(self, t_mono_ns: int) -> None:
        """Wait for a moment of the bench clock; a stop ends the wait."""
        while (now := self.clock.now_ns()) < t_mono_ns:
            self.stop.check()
            self.clock.sleep_until_ns(t_mono_ns if self.clock.virtual else min(t_mono_ns, now + _WALL_SLICE_NS))
        self.stop.check()

    def add_slip(self, slip_ns: int) -> None:
        """Shift everything that follows."""
        self.slip_ns += slip_ns


class InUse:
    """Instruments the steps are talking to right now, so that nobody cuts into a sequence of commands.

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


class Interlocks(Protocol):
    """The interlocks of a run, which keep it from going on while one is beyond its limit."""

    def in_the_way(self) -> Mapping[str, str]:
        """Return sentences on those that keep the run from going on, by name."""

    def look_again(self) -> None:
        """Read them anew, and hold the run for what is beyond its limit."""

    def watching(self) -> AbstractContextManager[object]:
        """Watch them while the run goes on."""


def hottest_degC(temperatures_degC: Sequence[float]) -> float:
    """Return the highest of the known temperatures, NaN if none is known."""
    return max((degC for degC in temperatures_degC if not math.isnan(degC)), default=math.nan)


@dataclass
class RunContext:
    """State of one run; the flat plan plus these few values are the whole position.

    ``cutters`` cut the records out of the frames of ``measurement_link``, by link; of several units each has one. Empty
    and "" where a plan names no link.
    ``settled`` is False from a soak that was left before the temperature was stable (policy skip) to the next soak.
    ``folder`` is the session's.
    ``unit_answer`` is who the unit said it was before a run that is gone on with was stopped.
    ``away`` are the instruments the run stands still for.
    ``failed`` are the steps of checks that failed and without which what is behind them is left out.
    ``step`` is the step under way, None before the first.
    ``measured``: numbers of the records that are complete and count: no wiring check, none that was taken back.
    ``ahead`` holds the windows that are open before their record step, by number of the step.
    ``manifest`` is the session's; ``observers`` hear everything that happens; ``earlier`` are the commands and replies
    of instruments from before the session.
    ``decided``: what was read and decided, by the events written so far.
    ``operate`` does on a simulated bench what a person did by a prompt (name, value).

    Args: watched: makes the interlocks of the run, so that they are there before anybody goes by them.
    """

    plan: Plan
    instruments: dict[str, Instrument]
    acquisition: Acquisition
    cutters: Mapping[str, RecordCutter]
    clock: Clock
    observers: Observers
    operator: Operator
    stop: StopSwitch
    timeline: Timeline
    measurement_link: str
    watched: InitVar[Callable[[RunContext], Interlocks]]
    rows: PackedRows = field(default_factory=PackedRows)
    step: Step | None = None
    measured: set[int] = field(default_factory=set)
    ahead: dict[int, RecordWindow] = field(default_factory=dict)
    away: set[str] = field(default_factory=set)
    failed: set[int] = field(default_factory=set)
    record_count: int = 0
    retaken: int = 0
    overruns: int = 0
    settled: bool = True
    unit_answer: bytes | None = None
    folder: Path = Path()
    manifest: Mapping[str, Any] = field(default_factory=dict)
    earlier: tuple[tuple[str, str, str, int], ...] = ()
    operate: Callable[[str, Any], None] = lambda name, value: None
    in_use: InUse = field(default_factory=InUse)
    health: Health = field(init=False)
    decided: Decided = field(init=False)
    interlocks: Interlocks = field(init=False)

    def __post_init__(self, watched: Callable[[RunContext], Interlocks]) -> None:
        self.health = Health(self.clock)
        self.decided = Decided(self.plan.steps)
        self.stop.live.append(partial(self.health.alive, SEQUENCER))
        for name, reader in self.acquisition.readers.items():
            reader.listeners.append(partial(self.observers.batch, name))
        self.interlocks = watched(self)

    def drop_open_records(self, count: int) -> None:
        """Forget the windows that are open, and every number given since ``count`` records were taken."""
        for cutter in self.cutters.values():
            cutter.close_all()
        self.ahead.clear()
        self.record_count = count

    def wait_for(self, role: str, reason: str) -> Wish:
        """Hold the run for an instrument that does not answer, from the next check on; returns the wish."""
        wish = Wish("hold", by_instrument(role), reason)
        self.away.add(role)
        self.stop.holds.hold(wish.by, wish.reason, AWAY_LIMIT_S)
        return wish

    def event(self, event: Event) -> None:
        """Write an event with the time of now, then tell everybody. Raises: RecordError."""
        self.observers.event(event)
        self.decided.take(event)

    def note(self, event: Event) -> None:
        """Write an event that nothing depends on; a disk that refuses it changes nothing."""
        self.observers.note(event)

    def message(self, text: str) -> None:
        """Say something to a person that is no event."""
        self.observers.message(text)

    @property
    def rate_Hz(self) -> float:
        """Frames per second of the measurement link."""
        return float(self.plan.campaign["rate_Hz"])

    @property
    def units(self) -> tuple[PlannedUnit, ...]:
        """The units that share the campaign and are not left out; () where there is one."""
        return tuple(unit for unit in self.plan.units if unit.serial not in self.decided.units_out)

    @property
    def unit_temperatures_degC(self) -> list[float]:
        """Newest temperatures the units reported, degC; NaN if there is none of the last seconds."""
        return [self.acquisition.unit_temperature_degC(unit) for unit in self.units or (None,)]

    @property
    def unit_temperature_degC(self) -> float:
        """Newest temperature the unit reported, degC, of several that of the hottest; NaN if there is none."""
        return hottest_degC(self.unit_temperatures_degC)
