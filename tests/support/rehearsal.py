"""What system tests run: one short campaign, a tiny one, and a listener that reaches into the simulated world."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.plan import Plan, Step, check_plan, compile_sequence
from bench.run.session import Conducted
from sim_instruments.worlds.common.world import World

ROOT = Path(__file__).resolve().parents[2]
SEED = 11
NAME = "20000101T000000Z_scale_factor_short_SIM-1"
Act = Callable[[World, Step], None]


def bench(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command as a process of its own."""
    command = [sys.executable, "-m", "bench", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, stdin=subprocess.DEVNULL)


def run_short(out: Path, seed: int = SEED) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """The short campaign with the calibrator's common gain off; its folder and what the command said."""
    words = ["run", "scale_factor_short", "--truth", "--seed", str(seed), "--out", str(out)]
    return out / NAME, bench(*words, "--set", "world.calibrator_gain=off")


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


def tiny_plan(folder: Path, *changes: tuple[str, str]) -> Plan:
    """scale_factor_short cut down to one channel at one temperature: 15 records in 4,050 s."""
    text = (ROOT / "sequences" / "scale_factor_short.yaml").read_text()
    closing = text.index("  - for: temperature                       # closing")
    cuts = [
        ("sequence: scale_factor_short", "sequence: tiny"),
        ("duration: 10350 s\nrecords: 105", "duration: 4050 s\nrecords: 15"),
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
    plan = compile_sequence(path, None, {"world.calibrator_gain": "off"})
    assert check_plan(plan) == []
    return plan
