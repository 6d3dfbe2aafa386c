"""Campaigns that are recorded once per test run, whichever worker needs them first, and then only read."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

DONE = "recorded.done"


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
