"""What the tests of campaigns on the bench of probe_bench share: a command, and something that happens at a reading."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from typer.testing import CliRunner

from bench.cli import app
from bench.model.events import Event, Hold
from bench.run.context import RunContext
from bench.run.observers import Observer


def command(*words: object) -> str:
    """Return what a command says; it must succeed."""
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


class AtReading:
    """Does something to the run at its nth call of the meter; a Beside of ``conduct``.

    With ``held_s`` every hold is released after this time; else what holds the run must let it go.
    """

    def __init__(self, nth: int, act: Callable[[RunContext], None], held_s: float | None = None) -> None:
        self._left, self._act, self._held_s = nth, act, held_s

    def __call__(self, context: RunContext) -> AbstractContextManager[None]:
        meter: Any = context.instruments["meter"]
        plain, held_s = meter.measure_resistance, self._held_s

        def measure(**arguments: Any) -> float:
            self._left -= 1
            if self._left == 0:
                self._act(context)
            return float(plain(**arguments))

        class Releasing(Observer):
            def event(self, event: Event, t_mono_ns: int) -> None:
                if held_s is not None and isinstance(event, Hold):
                    context.clock.sleep(held_s)
                    context.stop.holds.release(event.by)

        meter.measure_resistance = measure
        context.observers.add(Releasing())
        return nullcontext()
