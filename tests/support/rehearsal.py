"""What system tests run: one short campaign, a tiny one, and a listener that reaches into the simulated world."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from bench import cli
from bench.model.clock import VirtualClock
from bench.plan import Plan, Step, check_plan, compile_sequence
from bench.run.control.operator import SimulatedOperator
from bench.run.session import Beside, Conducted, conduct
from sim_instruments.worlds import simulation
from sim_instruments.worlds.common.world import World

ROOT = Path(__file__).resolve().parents[2]
SEED = 11
SOAK_s = 1800  # of the tiny campaign: the unit is within 1 degC of 25 degC after 20 minutes
NAME = "20000101T000000Z_scale_factor_short_SIM-1"
SAID = "said.json"
GOLDEN_SEQUENCE = str(ROOT / "tests" / "golden" / "sessions" / "golden.yaml")  # the smallest with an analysis
Act = Callable[[World, Step], None]
Inside = Callable[..., subprocess.CompletedProcess[str]]


def bench(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command as a process of its own."""
    command = [sys.executable, "-m", "bench", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, stdin=subprocess.DEVNULL)


def main_of(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Run the command in this process and return its exit status."""
    monkeypatch.setattr(sys, "argv", ["bench", *words])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    return int(caught.value.code or 0)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a session, by its name."""
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def run_short(out: Path, seed: int = SEED) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """The short campaign with the calibrator's common gain off; its folder and what the command said."""
    words = ["run", "scale_factor_short", "--truth", "--seed", str(seed), "--out", str(out)]
    return out / NAME, bench(*words, "--set", "world.calibrator_gain=off")


def record_short(out: Path) -> None:
    """Run the short campaign and keep what the command said beside it."""
    _, done = run_short(out)
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


@dataclass
class Watched:
    """Listener of a run that reaches into the simulated world at the beginning of each step."""

    act: Act
    worlds: list[World] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)

    def step(self, step: Step, at_s: float) -> None:
        self.steps.append(step)
        self.act(self.worlds[-1], step)

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
    beside: Sequence[Beside] = (),
) -> Rehearsal:  # fmt: skip
    """Run a plan; ``arrange`` changes the world before anything is opened, ``act`` at each step."""
    watched = Watched(act or (lambda world, step: None))
    plain = simulation.open_world

    def open_world(*words: Any, **options: Any) -> World:
        world = plain(*words, **options)
        watched.worlds.append(world)
        if arrange is not None:
            arrange(world)
        return world

    kinds = ("retake", "error", "end", "safe", "late", "slip", "record", "reading")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, "open_world", open_world)
        run = conduct(
            plan, clock=VirtualClock(), seed=seed, out=out, operator=SimulatedOperator(), listener=watched,
            keep_events=kinds, beside=beside,
        )  # fmt: skip
    return Rehearsal(run, watched)


def tiny_plan(folder: Path, *changes: tuple[str, str]) -> Plan:
    """Return scale_factor_short cut down to one channel at one temperature: 15 records in 2,250 s."""
    text = (ROOT / "sequences" / "scale_factor_short.yaml").read_text()
    closing = text.index("  - for: temperature                       # closing")
    cuts = [
        ("sequence: scale_factor_short", "sequence: tiny"),
        ("duration: 10350 s\nrecords: 105", "duration: 2250 s\nrecords: 15"),
        ("slot: 3600 s", f"slot: {SOAK_s} s"),
        ("{numbers: [1, 2], kind: gyro", "{numbers: 1, kind: gyro"),
        ("  - {numbers: 7, kind: accelerometer, levels: accel_levels}\n", ""),
        ("in: [23 degC, 25 degC]", "in: [25 degC]"),
        (text[closing : text.index("# The bench is left")], ""),
    ]
    for old, new in (*cuts, *changes):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "tiny.yaml"
    path.write_text(text)
    plan = compiled(path)
    assert check_plan(plan) == []
    return plan


def compiled(path: Path) -> Plan:
    """Return the plan of a sequence with the calibrator's common gain off."""
    return compile_sequence(path, None, {"world.calibrator_gain": "off"})
