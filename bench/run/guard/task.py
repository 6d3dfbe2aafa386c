"""The guard's decision as a task of the run itself, where the bench is simulated in this process.

No other process can reach such a bench, and nothing of it outlives the controller: what is left to guard are its hard
limits.
"""

from __future__ import annotations

import math
from contextlib import suppress

from bench.model.errors import BenchError, RunError
from bench.model.events import Guard
from bench.model.ports import Effect, actions_of
from bench.run.guard.act import put_safe
from bench.run.guard.decision import Action, Watched, decide
from bench.run.watch.temperatures import Guarded, TemperatureWatch


class GuardTask:
    """Ends the run when a hard limit is reached, heat first; what a step is using is made safe when the step ends."""

    def __init__(self, context: Guarded, limits_degC: dict[str, float]) -> None:
        self._context = context
        self._state = Watched(limits_degC, math.inf, context.clock.now_ns())
        self._watch = TemperatureWatch(context, limits_degC, self.look)

    def __enter__(self) -> GuardTask:
        self._watch.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._watch.__exit__()

    def look(self) -> None:
        """Decide by the newest values."""
        if self._state.dismissed:
            return
        self._state.values = self._context.health.values()
        action = decide(self._state, self._context.clock.now_ns())
        if action is not None:
            self._state.dismissed = True
            self._act(action)

    def _act(self, action: Action) -> None:
        context = self._context
        roles = sorted(context.instruments, key=lambda role: not _heats(type(context.instruments[role])))
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


def _heats(driver: type) -> bool:
    return any(one.effect is Effect.THERMAL for one in actions_of(driver).values())
