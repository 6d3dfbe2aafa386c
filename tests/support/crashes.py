"""Sessions as a killed run leaves them, and what goes on with them.

A copy of the session's folder while the run goes on is what a killed process leaves: the files as they are then. The
run itself ends undisturbed and is what the resumed ones are held against.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from recorded import writable_copy
from rehearsal import SEED, Watched, compiled, tiny_plan

from bench.model.clock import NS, VIRTUAL_START_UTC_NS, VirtualClock
from bench.plan import Plan, Step
from bench.run.control.operator import SimulatedOperator
from bench.run.resume import read_stopped, resumption
from bench.run.session import Conducted, conduct
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.world import World


@dataclass
class Crashes:
    """Copies of a session by the step that was about to begin, and the session of the run that went on to its end."""

    plan: Plan
    folder: Path
    whole: Path

    def at(self, number: int) -> Path:
        """Return the session as it was when the step of this number was about to begin."""
        return self.folder / f"step{number}" / self.whole.name


def kinds(plan: Plan) -> dict[str, int]:
    """Steps before which the run is killed: one of each sort of place."""
    records = [step.number for step in plan.phase("campaign") if step.kind == "record"]
    soak = next(step.number for step in plan.phase("campaign") if step.kind == "soak")
    return {
        "prompt": 3,
        "power": 10,
        "wiring": plan.phase("prepare")[-3].number,
        "soak": soak,
        "first point": records[0] - 1,
        "behind a record": records[4] + 1,
        "between points": records[7] + 2,
        "last record": records[-1],
        "finally": plan.phase("finally")[1].number,
    }


def crashed_everywhere(folder: Path) -> None:
    """Record one run, copied at every place of ``kinds`` and then undisturbed to its end."""
    plan = tiny_plan(folder)
    crashed_at(plan, folder, set(kinds(plan).values()))


def crashes_in(folder: Path) -> Crashes:
    """Return what ``crashed_everywhere`` left in a folder."""
    (whole,) = (folder / "out").iterdir()
    return Crashes(compiled(folder / "tiny.yaml"), folder, whole)


def crashed_at(plan: Plan, folder: Path, places: set[int]) -> Crashes:
    """One run of a plan, copied where the steps of these numbers are about to begin, undisturbed to its end."""
    watched = Watched(lambda world, step: copy(step))

    def copy(step: Step) -> None:
        if step.number in places:
            (session,) = (folder / "out").iterdir()
            shutil.copytree(session, folder / f"step{step.number}" / session.name)

    with pytest.MonkeyPatch.context() as patch:
        watch_worlds(patch, watched)
        run = conduct(
            plan, clock=VirtualClock(), seed=SEED, out=folder / "out", operator=SimulatedOperator(), listener=watched
        )
    assert run.outcome.error is None
    return Crashes(plan, folder, run.folder)


def watch_worlds(patch: pytest.MonkeyPatch, watched: Watched) -> None:
    plain = simulation.open_world

    def open_world(*words: object, **options: object) -> World:
        world = plain(*words, **options)  # type: ignore[arg-type]
        watched.worlds.append(world)
        return world

    patch.setattr(simulation, "open_world", open_world)


def go_on(folder: Path, watched: Watched, away_s: float = 0.0, utc_back_s: float = 0.0) -> Conducted:
    """What ``bench resume`` does on a simulated bench, with somebody who watches; UTC may have gone back meanwhile."""
    stopped = read_stopped(folder)
    clock = VirtualClock(VIRTUAL_START_UTC_NS - round(utc_back_s * NS))
    clock.sleep_until_ns(stopped.last_ns + round(away_s * NS))
    resumed = resumption(stopped, clock.utc_ns())
    return conduct(
        stopped.plan, clock=clock, seed=SEED, out=folder.parent, operator=SimulatedOperator(), listener=watched,
        resumed=resumed,
    )  # fmt: skip


def nobody() -> Watched:
    return Watched(lambda world, step: None)


def copied(crashes: Crashes, place: str, tmp_path: Path) -> Path:
    """A copy that a test may write into."""
    source = crashes.at(kinds(crashes.plan)[place])
    return writable_copy(source, tmp_path / source.name)


def crash_of(plan: Plan, folder: Path, number: int) -> Path:
    """A copy of a session from the moment when step ``number`` was about to begin."""

    def copy(world: World, step: Step) -> None:
        if step.number == number:
            (session,) = (folder / "out").iterdir()
            shutil.copytree(session, folder / "crash" / session.name)

    watched = Watched(copy, worlds=[None])  # type: ignore[list-item]
    conduct(plan, clock=VirtualClock(), seed=SEED, out=folder / "out", operator=SimulatedOperator(), listener=watched)
    (found,) = (folder / "crash").iterdir()
    return found


def nobody_in(monkeypatch: pytest.MonkeyPatch) -> Watched:
    watch_worlds(monkeypatch, watched := nobody())
    return watched
