"""The interlocks of a plan, beside the sequencer: beyond its level for the dwell one trips, and does what it says."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Literal

from bench.model.clock import NS, to_ns
from bench.model.errors import RunError
from bench.model.events import Interlock
from bench.model.units import finite
from bench.plan import Action, InterlockRule
from bench.record import RecordRow
from bench.run.context import RunContext
from bench.run.observers import Observer, Order
from bench.run.stop import HOLD_LIMIT_S, Wish, repeated
from bench.run.watch.signals import RateStep, WatchedSignals, leaves_the_bus

Change = Literal["tripped", "stale", "released", "lasting"]
RATE_STEP = "rate_step"
LASTING_S = 2.0  # a glitch is over by then
LOOK_WALL_S, LOOK_VIRTUAL_S = 1.0, 30.0
UNIT_LIMIT_S = 600.0  # what one of several units holds the others up with
ASK_WALL_S, ASK_VIRTUAL_S = 60.0, 300.0  # a rehearsal of 38 hours must not spend its time on these


class InterlockState:
    """Feed it with ``take``; pure logic, no clock of its own.

    A value on the trip level is not beyond, a value on the release level is back. No reading, or one that is not
    finite, neither trips nor releases by itself; where ``stale_s`` is set, no reading for longer than that counts as
    beyond and trips at once.
    """

    def __init__(self, rule: InterlockRule, start_ns: int) -> None:
        self.rule = rule
        self.tripped = False
        self.value = math.nan  # the newest that was read
        self._read_ns = start_ns
        self._beyond_ns: int | None = None
        self._back_ns: int | None = None
        self._lasting_ns: int | None = None

    def take(self, t_ns: int, value: float | None) -> Change | None:
        """Return what changes with the reading at ``t_ns`` (None: there was none).

        "lasting" comes once, when a tripped interlock is still beyond after another dwell, 2 s at least.
        """
        if value is None or not math.isfinite(value):
            return self._without(t_ns)
        self.value, self._read_ns = value, t_ns
        return self._while_tripped(t_ns, value) if self.tripped else self._while_well(t_ns, value)

    def _without(self, t_ns: int) -> Change | None:
        self._back_ns = None
        stale_s = self.rule.stale_s
        if stale_s is None or self.tripped or t_ns - self._read_ns <= stale_s * NS:
            return self._lasting(t_ns) if self.tripped else None
        self.value = math.nan
        return self.trip(t_ns, "stale")

    def _while_well(self, t_ns: int, value: float) -> Change | None:
        if not self.rule.beyond(value):
            self._beyond_ns = None
            return None
        self._beyond_ns = t_ns if self._beyond_ns is None else self._beyond_ns
        return self.trip(t_ns, "tripped") if t_ns - self._beyond_ns >= self.rule.dwell_s * NS else None

    def _while_tripped(self, t_ns: int, value: float) -> Change | None:
        if not self.rule.back(value):
            self._back_ns = None
            return self._lasting(t_ns)
        self._back_ns = t_ns if self._back_ns is None else self._back_ns
        if t_ns - self._back_ns < self.rule.release_after_s * NS:
            return self._lasting(t_ns)
        self.tripped, self._beyond_ns, self._back_ns = False, None, None
        return "released"

    def trip(self, t_ns: int, change: Change) -> Change:
        """Trip now, dwell or not; returns ``change``."""
        self.tripped, self._back_ns = True, None
        self._lasting_ns = t_ns + to_ns(max(self.rule.dwell_s, LASTING_S))
        return change

    def _lasting(self, t_ns: int) -> Change | None:
        if self._lasting_ns is None or t_ns < self._lasting_ns:
            return None
        self._lasting_ns = None
        return "lasting"


class InterlockWatch:
    """The interlocks of one run; ``take`` judges the newest readings.

    Actions: ``hold`` stands still until the value is back; ``retake`` and ``skip`` act at once on the point under way
    and hold if the value is still beyond a dwell later, so that no point is measured beyond a limit; ``abort`` ends
    the run safely (B-RUN-071); ``warn`` says so.
    """

    def __init__(self, rules: Sequence[InterlockRule], context: RunContext) -> None:
        now_ns = context.clock.now_ns()
        self._period_ns = to_ns(ASK_VIRTUAL_S if context.clock.virtual else ASK_WALL_S)
        self._ask_ns = now_ns + min(self._period_ns, to_ns(ASK_WALL_S))
        self.signals = WatchedSignals(context, rules)
        self._context = context
        self._all = [InterlockState(rule, now_ns) for rule in rules]
        self._asking, self._judging = threading.Lock(), threading.Lock()  # a slow instrument delays no judgement

    @property
    def _states(self) -> list[InterlockState]:
        """The interlocks that count; not those of a unit that was left out: it is off."""
        out = self._context.decided.units_out
        of = {name for unit in self._context.plan.units if unit.serial in out for name in unit.names} if out else ()
        return [state for state in self._all if state.rule.of not in of] if out else self._all

    def in_the_way(self) -> dict[str, str]:
        """Return sentences on what is beyond its limit by its newest reading, dwell or not, but for mere warnings."""
        kept = (state for state in self._states if state.rule.action != "warn")
        return {state.rule.name: _sentence(state) for state in kept if state.tripped or _is_beyond(state)}

    def look_again(self) -> None:
        """Read the instruments anew; what is beyond its limit holds the run at once, until its value is back."""
        with self._asking:
            self.signals.ask(all_of_them=True)
        with self._judging:
            self._judge()
            for state in self._states:
                if state.rule.action not in ("warn", "abort") and not state.tripped and _is_beyond(state):
                    self._changed(state, state.trip(self._context.clock.now_ns(), "tripped"), "hold")

    def take(self) -> None:
        """Look at the streams and judge every interlock; nothing is judged any more once the bench is made safe."""
        if not self._context.stop.over:
            with self._judging:
                self._judge()

    def _judge(self) -> None:
        self.signals.look()
        now_ns = self._context.clock.now_ns()
        for state in self._states:
            change = state.take(now_ns, self.signals.value(state.rule))
            if change is not None:
                self._changed(state, change, state.rule.action)

    def ask(self) -> None:
        """Read the instruments that interlocks need, when it is time and the steps leave the bus alone for a while."""
        now_ns = self._context.clock.now_ns()
        overdue = now_ns - self._ask_ns
        free = overdue > self._period_ns or leaves_the_bus(self._context)
        if overdue < 0 or self._context.stop.over or not free or not self._asking.acquire(blocking=False):
            return  # all are being read anew: under the virtual clock by this very thread
        try:
            self._ask_ns = now_ns + self._period_ns
            self.signals.ask()
        finally:
            self._asking.release()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch while the run goes on, under either clock."""
        context = self._context
        if any(state.rule.signal == RATE_STEP for state in self._all):
            steps = {}
            for link in context.cutters.keys() & context.acquisition.readers.keys():
                reader = context.acquisition.readers[link]
                steps[link] = RateStep(reader.definition.rate_Hz or math.nan)
                reader.listeners.insert(0, steps[link].feed)  # before the cutter, which may end the record with it
            context.observers.add(_RateOfRecords(self, steps, of_units=bool(context.plan.units)))
        look_s = LOOK_VIRTUAL_S if context.clock.virtual else LOOK_WALL_S
        with repeated(context.clock, context.stop, (look_s, self.take), (look_s, self.ask)):
            yield

    def _changed(self, state: InterlockState, change: Change, action: Action) -> None:
        if change == "lasting":
            if action not in ("retake", "skip"):
                return
            action = "hold"
        self._tell(state, change, action)
        by, reason, stop = f"interlock {state.rule.name}", _sentence(state), self._context.stop
        if change == "released":
            stop.holds.release(by)
        elif action == "hold":
            of_unit = self._context.plan.unit_of(state.rule.of) is not None
            stop.holds.hold(by, reason, UNIT_LIMIT_S if of_unit else HOLD_LIMIT_S)
        elif action in ("retake", "skip"):
            stop.holds.wish(Wish(action, by, reason))
        elif action == "abort":
            advice = "look for the cause, then 'bench resume SESSION'"
            stop.fail(RunError("B-RUN-071", reason, where=by, next_step=advice))

    def _tell(self, state: InterlockState, change: Change, action: Action) -> None:
        rule, value = state.rule, finite(state.value)
        below = rule.low is not None and value is not None and value < rule.low
        limit = rule.low if below or rule.high is None else rule.high
        self._context.event(
            Interlock(
                name=rule.name,
                signal=rule.signal,
                of=rule.of,
                value=value,
                limit=limit,
                unit=rule.unit,
                action=action,
                state=change,
            )
        )


def _is_beyond(state: InterlockState) -> bool:
    """Return whether the newest reading is; that of a record says nothing of a run that stands still."""
    return state.rule.signal != RATE_STEP and state.rule.beyond(state.value)


def _sentence(state: InterlockState) -> str:
    rule = state.rule
    name = f"{rule.signal} of {rule.of}" if rule.of else rule.signal
    if not math.isfinite(state.value):
        return f"no reading of {name} for more than {rule.stale_s:g} s"
    limits = " ... ".join("" if limit is None else f"{limit:g}" for limit in (rule.low, rule.high))
    return f"{name} is {state.value:.6g} {rule.unit}, limits {limits.strip()} {rule.unit}"


class _RateOfRecords(Observer):
    """Gives the interlocks the step of the rate in each record."""

    order = Order.SAFETY
    vital = True

    def __init__(self, watch: InterlockWatch, steps: Mapping[str, RateStep], *, of_units: bool) -> None:
        self._watch, self._steps, self._of_units = watch, steps, of_units

    def record(self, row: RecordRow) -> None:
        link = row.window.link
        self._watch.signals.put(RATE_STEP, self._steps[link].of(row), link if self._of_units else "")
