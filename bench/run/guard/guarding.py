"""The guarding of a run: a process where others can reach the bench, a task where they cannot; and the bench lock.

No other process can reach a bench that is simulated in this one, and nothing of it outlives the controller: what is
left to guard are its hard limits.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path

from bench.model.clock import Clock
from bench.model.errors import BenchError, RunError
from bench.model.events import Guard
from bench.model.lab import code_used
from bench.plan import Station
from bench.run.context import RunContext
from bench.run.guard.act import heats, put_safe
from bench.run.guard.decision import Action, Address, Brief, Watched, decide
from bench.run.guard.diary import DIARY
from bench.run.guard.last_words import terminal_of
from bench.run.guard.lock import BenchLock, bench_lock
from bench.run.guard.notice import notice_command
from bench.run.guard.start import GuardProcess
from bench.run.guard.temperatures import Guarded, TemperatureWatch
from bench.run.operator import Answer, Operator, Question
from bench.run.stop import Health


def guard_beside(station: Station) -> Callable[[RunContext], AbstractContextManager[object]]:
    """Return what guards a run on this station, as something that goes on beside the sequencer.

    A bench that other processes can reach gets a guard process, started before the first step. Raises: RunError
    B-RUN-090 if it does not start. A bench simulated in this process gets a task with the same decision.
    """

    def begin(context: RunContext) -> AbstractContextManager[object]:
        if station.in_process:
            return GuardTask(context, station.guard_limits_degC)
        return _guarded_run(context, station)

    return begin


def station_lock(
    station: Station, what: str, clock: Clock, roles: Collection[str] = (), *, take_over: bool = False
) -> BenchLock:
    """Return the lock of a controller on a station, or on some roles of it; a bench inside this process needs none.

    ``what``: "run", "talk" ... A guard that is making the bench safe is waited for, or with ``take_over`` sent home.
    """
    reached = {} if station.in_process else station.instruments
    resources = (entry.resource for role, entry in reached.items() if not roles or role in roles)
    return bench_lock(resources, what, clock, take_over=take_over)


def brief_of(station: Station, diary: Path) -> Brief:
    """Return what the guard of this process is told about a station."""
    entries = {role: station.instruments[role] for role in station.safe_order}
    addresses = (
        Address(role, entry.driver, entry.resource, dict(entry.options), entry.line) for role, entry in entries.items()
    )
    return Brief(
        pid=os.getpid(),
        visa=station.file.visa,
        instruments=tuple(addresses),
        limits=station.guard_limits_degC,
        silence_s=station.file.guard.silence,
        diary=str(diary.absolute()),
        notify=notice_command(station.file.notify),
        terminal=terminal_of(2),
        simulated=station.simulated,
        boards=station.boards,
        code=code_used({entry.driver for entry in entries.values()}),
    )


@contextmanager
def _guarded_run(context: RunContext, station: Station) -> Iterator[None]:
    brief = brief_of(station, context.folder / DIARY)
    with ExitStack() as stack:
        guard = stack.enter_context(GuardProcess(brief, context.health, context.stop, context.clock, context.event))
        context.operator = _Attended(context.operator, context.health)
        stack.enter_context(TemperatureWatch(context, brief.limits, guard.beat))
        yield


class _Attended:
    """An operator whose answer may take hours: the sequencer lives while it waits for a person."""

    def __init__(self, operator: Operator, health: Health) -> None:
        self._operator = operator
        self._health = health

    def ask(self, question: Question) -> Answer:
        """Block until answered."""
        with self._health.asking():
            return self._operator.ask(question)


class GuardTask:
    """Ends the run when a hard limit is reached, heat first; what a step is using is made safe when the step ends."""

    def __init__(self, context: Guarded, limits_degC: dict[str, float]) -> None:
        self._context = context
        self._state = Watched(limits_degC, math.inf, context.clock.now_ns())
        self._watch = TemperatureWatch(context, limits_degC, self.look)
        self._acted = False

    def __enter__(self) -> GuardTask:
        self._watch.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._watch.__exit__()

    def look(self) -> None:
        """Decide by the newest values."""
        if self._acted:
            return
        self._state.values = self._context.health.values()
        action = decide(self._state, self._context.clock.now_ns())
        if action is not None:
            self._acted = True
            self._act(action)

    def _act(self, action: Action) -> None:
        context = self._context
        roles = sorted(context.instruments, key=lambda role: not heats(type(context.instruments[role])))
        for role in roles:
            if role not in context.in_use:
                with suppress(BenchError):  # the sequencer makes everything safe once more, and reports what is not
                    put_safe(context.instruments[role], action.heat_off)
        context.event(Guard(state="acted", reason=action.reason, text=action.text))
        context.stop.fail(limit_crossed(action))


def limit_crossed(action: Action) -> RunError:
    """Return the error of a run that reached a hard limit."""
    return RunError(
        "B-RUN-094",
        f"{action.text}; the heat was switched off",
        where="guard",
        next_step="find out why before the bench is used again",
    )
