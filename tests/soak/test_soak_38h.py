"""Rows 23 and 24: 38 virtual hours with mixed faults; memory, descriptors and threads stay what they were."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

import pytest

from bench.record.writer import RETIRED_FILES  # finished segments are open until the next sync

HERE = Path(__file__).resolve().parent
SEEDS = 10
MOST_MiB = 1.0  # growth of what is held, after the first hours
MOST_RESIDENT_MiB = 2.5  # of the whole process, with the simulator's large blocks and the gaps they leave
SHARE = 6  # hours at either end
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": "65536"}  # what is freed goes back to the system, so that resident means needed


def soaked(sequence: str, seed: int, folder: Path, *words: str) -> dict[str, Any]:
    """One campaign in a fresh process: what earlier tests left in memory would hide or feign a growth."""
    command = [sys.executable, str(HERE.parent / "support" / "soak_38h.py"), sequence, str(seed), str(folder), *words]
    environment = {**os.environ, **ALLOCATOR}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=HERE.parents[1], env=environment)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def growth_of(values: list[float]) -> float:
    """From the first hours to the last ones; what waits for the decoder comes and goes within a megabyte."""
    share = min(SHARE, len(values) // 2)
    return median(values[-share:]) - median(values[:share])


def judge(found: dict[str, Any], seed: int, hours: float) -> None:
    seen = found["hours"]
    first = seen[0]
    resident_MiB, held_MiB = (growth_of([one[name] for one in seen]) for name in ("resident_MiB", "held_MiB"))
    print(
        f"seed {seed}: {found['ended']} after {seen[-1]['hour']:.0f} h with {found['faults']} faults, "
        f"{found['estimates']} estimates held against the truth ({found['flagged']} flagged); "
        f"resident {resident_MiB:+.2f} MiB, held {held_MiB:+.2f} MiB"
    )
    assert found["violations"] == []
    assert found["ended"] == "done"
    assert seen[-1]["hour"] >= hours
    assert held_MiB <= MOST_MiB
    assert resident_MiB <= MOST_RESIDENT_MiB
    assert {one["threads"] for one in seen} == {first["threads"]}
    assert all(one["descriptors"] <= first["descriptors"] + RETIRED_FILES for one in seen)
    assert len({one["descriptors"] for one in seen if one["hour"] > RETIRED_FILES + 1}) <= 1


@pytest.mark.slow
def test_two_hours(tmp_path: Path) -> None:
    judge(soaked("scale_factor_short", 1, tmp_path), 1, 2.0)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(SEEDS))
def test_38_hours(seed: int, tmp_path: Path) -> None:
    judge(soaked("scale_factor_38h", seed, tmp_path), seed, 38.0)


@pytest.mark.sweep
def test_what_is_held_for_38_hours(tmp_path: Path) -> None:
    found = soaked("scale_factor_38h", 0, tmp_path, "held")
    for one in found["hours"]:
        one["resident_MiB"] = one["held_MiB"]  # the tracing itself needs room
    judge(found, 0, 38.0)
