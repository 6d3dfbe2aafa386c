"""What ``bench run`` and ``bench resume`` share: the watchers beside a run and the pre-flight before it."""

from __future__ import annotations

import os
from pathlib import Path

from rich.console import Console

from bench.commands.asking import Aside, terminal_here
from bench.commands.progress import watcher
from bench.commands.terminal import TerminalOperator
from bench.model.clock import Clock
from bench.plan import Plan
from bench.run.besides import besides
from bench.run.control.asking import WaitingOperator
from bench.run.control.operator import Operator, SimulatedOperator
from bench.run.guard.guarding import guard_beside
from bench.run.preflight import Preflight, stay_awake
from bench.run.session import Beside, Conducted, conduct
from bench.run.steps.position import Resumption
from bench.run.watch.clock import clock_watch
from bench.session.view import KEPT_EVENTS


def conduct_watched(
    plan: Plan,
    clock: Clock,
    *,
    seed: int,
    out: Path,
    errors: Console,
    resumed: Resumption | None = None,
    ask: bool = False,
) -> Conducted:
    """Conduct a plan with everything that watches over it; a person is told on ``errors``.

    ``ask``: prompts are put to a person on a simulated bench too. Under the wall clock anybody who reaches the run may
    answer them.
    """
    simulated = plan.station.simulated and not ask
    asking = None if simulated or clock.virtual else WaitingOperator(terminal_here())
    with watcher(plan, errors, asks=not simulated) as listener:
        operator: Operator = SimulatedOperator() if simulated else Aside(asking or TerminalOperator(), listener.aside)
        return conduct(
            plan,
            clock=clock,
            seed=seed,
            out=out,
            operator=operator,
            listener=listener,
            keep_events=KEPT_EVENTS,
            beside=[*watchers(plan, clock, asking), listener.follow],
            preflight=Preflight(tell=listener.message),
            resumed=resumed,
        )


def watchers(plan: Plan, clock: Clock, asking: WaitingOperator | None = None) -> list[Beside]:
    """Who watches over a run, the guard first: it is the last one to be let go."""
    found: list[Beside] = [guard_beside(plan.station), *besides(plan, os.environ, virtual=clock.virtual, asking=asking)]
    return found if clock.virtual else [*found, clock_watch, stay_awake]
