"""One short campaign for all system tests, and a way to run a plan and reach the simulated world."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from crashes import Crashes, crashed_everywhere
from rehearsal import SEED, Act, Rehearsal, Watched, run_short

from bench.model.clock import VirtualClock
from bench.plan import Plan
from bench.run.control.operator import SimulatedOperator
from bench.run.session import conduct
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.world import World


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    return run_short(tmp_path_factory.mktemp("short"))


@pytest.fixture(scope="session")
def crashes(tmp_path_factory: pytest.TempPathFactory) -> Crashes:
    return crashed_everywhere(tmp_path_factory.mktemp("crashes"))


@pytest.fixture
def rehearse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Rehearsal]:
    """Run a plan; ``arrange`` changes the world before anything is opened, ``act`` at each step."""

    plain = simulation.open_world  # not what an earlier run of the same test has put there

    def start(plan: Plan, arrange: Callable[[World], None] | None = None, act: Act | None = None) -> Rehearsal:
        watched = Watched(act or (lambda world, step: None))

        def open_world(*words: Any, **options: Any) -> World:
            world = plain(*words, **options)
            watched.worlds.append(world)
            if arrange is not None:
                arrange(world)
            return world

        monkeypatch.setattr(simulation, "open_world", open_world)
        kinds = ("retake", "error", "end", "safe", "late", "slip", "record", "reading")
        run = conduct(
            plan, clock=VirtualClock(), seed=SEED, out=tmp_path / "out", operator=SimulatedOperator(), listener=watched,
            keep_events=kinds,
        )  # fmt: skip
        return Rehearsal(run, watched)

    return start
