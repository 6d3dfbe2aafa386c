"""Rows 23 and 24: virtual hours with mixed faults; memory, descriptors and threads stay what they were.

The campaign of 38 hours is soaked by ``make soak CAMPAIGN=scale_factor_38h``, with the same judgement.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import soak_hourly
from soak_hourly import ALLOCATOR, Hour, grown


def soaked(sequence: str, seed: int, folder: Path, *words: str) -> dict[str, Any]:
    """One campaign in a fresh process: what earlier tests left in memory would hide or feign a growth."""
    command = [sys.executable, str(soak_hourly.__file__), sequence, str(seed), str(folder), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **ALLOCATOR})
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def judge(found: dict[str, Any], hours: float) -> None:
    assert found["violations"] == []
    assert found["ended"] == "done"
    assert found["hours"][-1]["hour"] >= hours


@pytest.mark.slow
def test_two_hours(tmp_path: Path) -> None:
    judge(soaked("scale_factor_short", 1, tmp_path), 2.0)


@pytest.mark.sweep
def test_what_is_held_for_38_hours(tmp_path: Path) -> None:
    judge(soaked("scale_factor_38h", 0, tmp_path, "held"), 38.0)


@pytest.mark.parametrize(
    ("name", "last", "told"),
    [
        ("resident_MiB", 104.0, "resident memory grew by 4.00 MiB"),
        ("held_MiB", 52.0, "held memory grew by 2.00 MiB"),
        ("threads", 3, "threads: "),
        ("descriptors", 90, "descriptors: "),
    ],
)
def test_what_grows_is_told(name: str, last: float, told: str) -> None:
    steady = {"resident_MiB": 100.0, "held_MiB": 50.0, "descriptors": 12, "threads": 2}
    seen = [Hour(float(hour), **(steady | ({name: last} if hour > 14 else {}))) for hour in range(1, 21)]  # type: ignore[arg-type]
    assert [text for text in grown(seen) if not text.startswith(told)] == []
    assert len(grown(seen)) == 1
    assert grown([Hour(float(hour), **steady) for hour in range(1, 21)]) == []  # type: ignore[arg-type]
