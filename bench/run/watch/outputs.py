"""Looks at everything that can be on, again and again, so that the state of the bench that people see is never old.

Asked are the questions by which a driver knows whether it is on (``Tells``); what the replies say is worked out by
``BenchState``, from the transcript. A look waits for a moment in which the steps leave the bus alone, and for
at most one more period.

What is on and leads or drives a stimulus, or moves, is asked each second whether it is there, unless it has just
answered a step. One that is silent for longer than ``LOST_S`` holds the run, which opens its path over what still
answers and takes the point again. Only on the wall clock: a bench inside this process has no network.

What answers that it is on, though the steps up to now leave it off as they declare it, holds the run too.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from bench.model.clock import NS, to_ns
from bench.model.errors import InstrumentError
from bench.model.events import UNDECLARED
from bench.model.ports import DE_ENERGISING, ENERGISING, SWITCHED_OFF, Instrument, drivers_of, effects_of
from bench.plan import Step
from bench.run.bus.safety import QUICK_S, hurried
from bench.run.context import RunContext
from bench.run.feed.bench_state import LOOK_VIRTUAL_S, LOOK_WALL_S, BenchState
from bench.run.observers import Observer, Order
from bench.run.setpoints import goes_off
from bench.run.stop import repeated
from bench.run.watch.signals import leaves_the_bus

WAKE_S = 5.0
CONTACT_S = 1.0
CONTACT_WAKE_S = 0.25
LOST_S = 1.5  # with a second for the question and one for making safe, the path is open 5 s after a loss


def look(instruments: Mapping[str, Instrument], busy: Container[str] = ()) -> None:
    """Ask each instrument that can be on whether it is; one that does not answer is not waited for.

    Args: busy: roles that a step talks to right now; they are left alone.
    """
    for role, instrument in instruments.items():
        ask = getattr(instrument, "look", None)
        if ask is not None and role not in busy:
            with suppress(InstrumentError), hurried(instrument, QUICK_S):
                ask()


class OutputsWatch:
    """Looks each minute on the wall clock, each half hour in a rehearsal."""

    def __init__(self, context: RunContext) -> None:
        self._context = context
        self._period_ns = to_ns(LOOK_VIRTUAL_S if context.clock.virtual else LOOK_WALL_S)
        self._due_ns = context.clock.now_ns() + self._period_ns

    def take(self) -> None:
        """Look if it is time and the bus is free; nothing is asked any more once the bench is made safe."""
        context, now_ns = self._context, self._context.clock.now_ns()
        overdue_ns = now_ns - self._due_ns
        if overdue_ns < 0 or context.stop.over:
            return
        if leaves_the_bus(context) or overdue_ns > self._period_ns:
            self._due_ns = now_ns + self._period_ns
            look(context.instruments, context.in_use)


class Declared(Observer):
    """Compares what each instrument answers with what the steps up to now declare; holds the run once for each.

    ``off``: roles that must answer so: a step that takes all energy away is done, or none up to now brings any and the
    instrument has answered once that it is off; before that it is as its last user left it. A step that a decision has
    left out may have brought energy, and takes none away. On the run's own way back to a point nothing is judged.
    """

    order = Order.SAFETY
    loss = "nobody watches any more whether something is on that no step switches on"

    def __init__(self, context: RunContext) -> None:
        self._context, self._drivers = context, drivers_of(context.instruments)
        self._judged = {role for role, one in context.instruments.items() if effects_of(type(one)) & ENERGISING}
        self._untouched, self._off = set(self._judged), set[str]()
        places = ((role, context.plan.station.instruments[role]) for role in self._judged)
        self._bench = BenchState({role: (entry.driver, entry.resource) for role, entry in places}, math.inf)
        self._lock = threading.Lock()
        self._begun = set[int]()
        self._newest = 0

    def step(self, step: Step, at_s: float) -> None:
        if again := step.number in self._begun or step.number < self._newest:
            self._begun = {number for number in self._begun if number < step.number}
            self._off &= self._untouched
        for before in self._context.plan.steps[0 if again else self._newest : step.number]:
            self._declare(before, done=before.number in self._begun)
        self._declare(step, done=False)
        self._begun.add(step.number)
        self._newest = step.number

    def _declare(self, step: Step, *, done: bool) -> None:
        effects = step.effects(self._drivers.get(step.role, {}))
        if effects and (effects <= DE_ENERGISING or step.name in SWITCHED_OFF):
            if done:
                self._off.add(step.role)
        elif effects & ENERGISING:
            self._untouched.discard(step.role)
            self._off.discard(step.role)

    @property
    def on(self) -> set[str]:
        """Roles that are on, by what they answer and were told."""
        with self._lock:
            return self._bench.on

    def traffic(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        stop = self._context.stop
        with self._lock:
            self._bench.on_traffic(role, direction, text, t_mono_ns / NS)
            if role in self._untouched and self._bench.off_since(role, -math.inf):
                self._off.add(role)
            on = direction == "rx" and role in self._off and role in self._judged and self._bench.answers_on(role)
        if on and self._begun and stop.interruptible and not stop.deferred:
            self._judged.discard(role)
            stop.holds.hold(
                UNDECLARED,
                f"{role} answers that it is on, though the steps up to now leave it off; "
                "find out what switched it on, then let the run go on",
            )


class Contact:
    """Asks what is on whether it is still there. Args: declared: knows by the traffic what is on."""

    def __init__(self, context: RunContext, declared: Declared) -> None:
        self._context, self._declared = context, declared
        self._asked = {
            role: instrument
            for role, instrument in context.instruments.items()
            if goes_off(type(instrument)) and hasattr(instrument, "silence_s")
        }

    def take(self) -> None:
        """Ask what is on and has not answered for a second; hold the run for what does not answer."""
        context, stop = self._context, self._context.stop
        if stop.over or not stop.interruptible or stop.holds.reasons:
            return
        for role in self._declared.on & self._asked.keys():
            instrument: Any = self._asked[role]
            if instrument.heard_s() >= CONTACT_S and role not in context.in_use:
                look({role: instrument})
            silence_s = instrument.silence_s()
            if silence_s > LOST_S:
                context.wait_for(role, f"it is on and has not answered for {silence_s:.1f} s")


@contextmanager
def outputs_watch(context: RunContext) -> Iterator[None]:
    """Look at the outputs while the run goes on, under either clock."""
    watch = OutputsWatch(context)
    wake_s = LOOK_VIRTUAL_S if context.clock.virtual else WAKE_S
    duties = [(wake_s, watch.take)]
    declared = Declared(context)
    context.observers.add(declared)
    if not context.clock.virtual:
        duties.append((CONTACT_WAKE_S, Contact(context, declared).take))
    with repeated(context.clock, context.stop, *duties):
        yield
