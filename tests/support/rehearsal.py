"""The rig of whole runs. A test gets from here:

* a command, as a process of its own (``bench``) or in this one (fixture ``inside``, ``main_of``);
* a run in this process, with something changed in its world or under way (``rehearsed``, fixture ``rehearse``), of a
  sequence or of the shortest campaign (``tiny_plan``);
* a session as a killed run leaves it (``crashed_at``, fixture ``crashes``), and what goes on with it (``go_on``);
* a finished session, recorded once for a test run (``recorded``, fixtures ``short``, ``golden``, ``ramp``).

Simulated benches without a run are in ``sim_bench``, served ones in ``served``, files of records in ``record_sample``.
"""

import fcntl
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from plan_sample import reworded

from bench import cli
from bench.model.clock import NS, VIRTUAL_START_UTC_NS, Clock, VirtualClock
from bench.plan import Plan, Step, check_plan, compile_sequence
from bench.run.operator import Operator, SimulatedOperator
from bench.run.resume import read_stopped, resumption
from bench.run.session import Beside, Conducted, conduct
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.world import World

ROOT = Path(__file__).resolve().parents[2]
SEED = 11
SHORT_SEQUENCE = ROOT / "sequences" / "scale_factor_short.yaml"
SOAK_s = 1800  # of the tiny campaign: the unit is within 1 degC of 25 degC after 20 minutes
NAME = "20000101T000000Z_scale_factor_short_SIM-1"
SAID = "said.json"
DONE = "recorded.done"
GOLDEN_SEQUENCE = str(ROOT / "tests" / "golden" / "sessions" / "golden.yaml")  # the smallest with an analysis
KEPT = ("retake", "error", "end", "safe", "late", "slip", "record", "reading")
Act = Callable[[World, Step], object]
Inside = Callable[..., subprocess.CompletedProcess[str]]


def bench(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Give a command as a process of its own."""
    command = [sys.executable, "-m", "bench", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, stdin=subprocess.DEVNULL)


def main_of(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Give a command in this process and return its exit status."""
    monkeypatch.setattr(sys, "argv", ["bench", *words])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    return int(caught.value.code or 0)


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file of a session, by its name."""
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@dataclass
class Watched:
    """Listener of a run that reaches into the simulated world at the beginning of each step."""

    act: Act = lambda world, step: None
    worlds: list[World] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)

    def step(self, step: Step, at_s: float) -> None:
        self.steps.append(step)
        self.act(self.worlds[-1] if self.worlds else None, step)  # type: ignore[arg-type]

    def record(self, row: object) -> None:
        return None

    def message(self, text: str) -> None:
        self.messages.append(text)


@dataclass
class Rehearsal:
    """A run on the simulated bench: what it gave, who watched it, the world it left behind."""

    run: Conducted
    watched: Watched

    @property
    def world(self) -> World:
        return self.watched.worlds[-1]

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [dict(fields) for found, _, fields in self.run.events if found == kind]


def rehearsed(
    out: Path, plan: Plan, arrange: Callable[[World], None] | None = None, act: Act | None = None, seed: int = SEED,
    beside: Sequence[Beside] = (), watched: Watched | None = None, clock: Clock | None = None,
    operator: Operator | None = None, kept: Sequence[str] = KEPT, **options: Any,
) -> Rehearsal:  # fmt: skip
    """Run a plan; ``arrange`` changes the world before anything is opened, ``act`` at each step.

    ``watched`` has the world even if the run does not begin. ``options``: of ``conduct``.
    """
    watched = watched or Watched(act or (lambda world, step: None))
    with pytest.MonkeyPatch.context() as patch:
        watch_worlds(patch, watched, arrange)
        run = conduct(
            plan, clock=clock or VirtualClock(), seed=seed, out=out, operator=operator or SimulatedOperator(),
            listener=watched, keep_events=kept, beside=beside, **options,
        )  # fmt: skip
    return Rehearsal(run, watched)


def watch_worlds(patch: pytest.MonkeyPatch, watched: Watched, arrange: Callable[[World], None] | None = None) -> None:
    """Note every world that is opened, and change it before anything else is."""
    plain = simulation.open_world

    def open_world(*words: Any, **options: Any) -> World:
        world = plain(*words, **options)
        watched.worlds.append(world)
        if arrange is not None:
            arrange(world)
        return world

    patch.setattr(simulation, "open_world", open_world)


def assert_safe(world: World) -> None:
    """No current, no closed relay, no power to the unit, chamber stopped or on hold: what the world itself says."""
    assert world.wiring.loop_current_A == 0.0
    assert world.wiring.closed == frozenset()
    assert not world.instruments["calibrator"].operating
    assert not world.instruments["supply"].on
    assert world.instruments["chamber"].outputs()["mode"] in ("stopped", "holding")


def overheard(world: World) -> list[str]:
    """Return a list that takes every command which an instrument of a world gets from now on."""
    heard: list[str] = []
    for device in world.instruments.values():
        plain = device.execute
        device.execute = lambda text, plain=plain: (heard.append(text), plain(text))[1]  # type: ignore[misc]
    return heard


def assert_nothing_switched(heard: list[str]) -> None:
    """Instruments were asked, and none was told to drive, lead or heat anything."""
    assert heard
    stimulus = ("OPER", "OUT ", "OUTP ON", ":CLOS", "RUNM", "SETP1,", "VOLT ", "FUNC")
    assert [text for text in heard if text.upper().startswith(stimulus) and "?" not in text] == []


def shortened(
    source: Path, folder: Path, name: str, *changes: tuple[str, str], cut: tuple[str, str] = ("", "")
) -> Path:
    """Write a changed sequence: without what is between ``cut``, and texts that stand there once are replaced."""
    text = source.read_text()
    if cut[0]:
        text = text[: text.index(cut[0])] + text[text.index(cut[1]) :]
    path = folder / f"{name}.yaml"
    path.write_text(reworded(text, *changes, once=True))
    return path


CLOSING = ("  - for: temperature                       # closing", "# The bench is left")
ONE_CHANNEL = (
    ("{numbers: [1, 2], kind: gyro", "{numbers: 1, kind: gyro"),
    ("  - {numbers: 7, kind: accelerometer, levels: accel_levels}\n", ""),
)


def tiny_plan(folder: Path, *changes: tuple[str, str]) -> Plan:
    """Return scale_factor_short cut down to one channel at one temperature: 15 records in 2,250 s."""
    cuts = (
        ("sequence: scale_factor_short", "sequence: tiny"),
        ("duration: 10350 s\nrecords: 105", "duration: 2250 s\nrecords: 15"),
        ("slot: 3600 s", f"slot: {SOAK_s} s"),
        ("in: [23 degC, 25 degC]", "in: [25 degC]"),
        *ONE_CHANNEL,
    )
    plan = compiled(shortened(SHORT_SEQUENCE, folder, "tiny", *cuts, *changes, cut=CLOSING))
    assert check_plan(plan) == []
    return plan


def compiled(path: Path) -> Plan:
    """Return the plan of a sequence with the calibrator's common gain off."""
    return compile_sequence(path, None, {"world.calibrator_gain": "off"})


@dataclass
class Crashes:
    """Copies of a session by the step that was about to begin, and the session of the run that went on to its end.

    A copy of the folder while the run goes on is what a killed process leaves: the files as they are then.
    """

    plan: Plan
    folder: Path
    whole: Path

    def at(self, number: int) -> Path:
        """Return the session as it was when the step of this number was about to begin."""
        return self.folder / f"step{number}" / self.whole.name


def kinds(plan: Plan) -> dict[str, int]:
    """Return steps before which the tiny campaign is killed: one of each sort of place."""
    records = [step.number for step in plan.phase("campaign") if step.kind == "record"]
    return {
        "prompt": 3,
        "power": 10,
        "wiring": plan.phase("prepare")[-3].number,
        "soak": next(step.number for step in plan.phase("campaign") if step.kind == "soak"),
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
    """Run a plan, copied where the steps of these numbers are about to begin, undisturbed to its end."""

    def copy(_: World, step: Step) -> None:
        if step.number in places:
            (session,) = (folder / "out").iterdir()
            shutil.copytree(session, folder / f"step{step.number}" / session.name)

    run = rehearsed(folder / "out", plan, act=copy).run
    assert run.outcome.error is None
    return Crashes(plan, folder, run.folder)


def go_on(
    folder: Path, watched: Watched | None = None, away_s: float = 0.0, utc_back_s: float = 0.0, **options: Any
) -> Conducted:
    """Do what ``bench resume`` does on a simulated bench, watched; UTC may have gone back meanwhile."""
    stopped = read_stopped(folder)
    clock = VirtualClock(VIRTUAL_START_UTC_NS - round(utc_back_s * NS))
    clock.sleep_until_ns(stopped.last_ns + round(away_s * NS))
    resumed = resumption(stopped, clock.utc_ns())
    return rehearsed(folder.parent, stopped.plan, clock=clock, watched=watched, resumed=resumed, **options).run


def nobody() -> Watched:
    """Return a listener who does nothing."""
    return Watched()


def nobody_in(monkeypatch: pytest.MonkeyPatch) -> Watched:
    """Return one who notes the worlds of every run of a test."""
    watch_worlds(monkeypatch, watched := nobody())
    return watched


def copied(crashes: Crashes, place: str, tmp_path: Path) -> Path:
    """Return a copy of the tiny campaign, killed at a place, that a test may write into."""
    source = crashes.at(kinds(crashes.plan)[place])
    return writable_copy(source, tmp_path / source.name)


def recorded(factory: pytest.TempPathFactory, name: str, record: Callable[[Path], object]) -> Path:
    """Return the folder that ``record`` filled, once for all workers of a test run; nobody may write into it."""
    place = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        place = place.parent
    folder = place / name
    with (place / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / DONE).exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a worker in which it failed
            folder.mkdir()
            record(folder)
            (folder / DONE).touch()
            for path in folder.rglob("*"):
                path.chmod(path.stat().st_mode & ~0o222)
    return folder


def writable_copy(source: Path, target: Path) -> Path:
    """Return ``target``, a copy of a recorded folder that a test may write into."""
    shutil.copytree(source, target)
    for path in (target, *target.rglob("*")):
        path.chmod(path.stat().st_mode | 0o200)
    return target


def record_short(out: Path) -> None:
    """Run the short campaign with the calibrator's common gain off, and keep what the command said beside it."""
    words = ["run", "scale_factor_short", "--truth", "--seed", str(SEED), "--out", str(out)]
    done = bench(*words, "--set", "world.calibrator_gain=off")
    (out / SAID).write_text(json.dumps(vars(done)))


def record_ramp(out: Path) -> None:
    """Run the short bias campaign; its verdicts may fail."""
    done = bench("run", "bias_ramp_short", "--seed", str(SEED), "--out", str(out))
    assert done.returncode in (0, 1), done.stderr


def record_golden(out: Path) -> None:
    """Run the smallest campaign with an analysis, two channels."""
    from bench.commands import run as command
    from bench.commands.requests import RunRequest

    command.run(RunRequest(GOLDEN_SEQUENCE, clock="virtual", seed=3, out=out))
