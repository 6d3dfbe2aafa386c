"""Cost of the study of the time offset: 400 lanes of 60 s and 500 s, a focused target, two Dask workers against none.

Lanes: 4 offsets x 2 filters x 50 runs, with everything simulated and filtered. Each part runs in a process of its own,
so that its greatest memory is its own. Two workers against one process without Dask: flights of 200 s with images,
three times in turn, wall clock with the start of the workers, results compared byte by byte; CPU time in two parts,
since workers whose memory the system clears again and again show there on a machine that is not quiet, too.

Run: python -m benchmarks.time_sync [short|long|target|workers]...
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from hashlib import sha256
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np

from bench.commands.cluster import THREADS, run_on_cluster
from bench.systems.time_sync.estimators.sar.response import impulse_response
from bench.systems.time_sync.study.study import (
    Group,
    LONG_s,
    QUICK_LONG_s,
    SHORT_s,
    StudyOptions,
    Task,
    image_tasks,
)
from bench.systems.time_sync.study.tasks import run_task, scene_of, simulated

HERE = "--here"
RUNS = 50
OFFSETS_ms = (0.0, 10.0, 20.0, 30.0)
TARGETS = 5
OPENS_s = 490.0
REPEATS = 3
TIMES = ("wall_s", "user_s", "system_s")


def lanes(manoeuvre: str, duration_s: float) -> str:
    """One flight with all its lanes."""
    groups = tuple(Group(offset_ms, state) for offset_ms in OFFSETS_ms for state in (False, True))
    began_s = process_time()
    run_task(Task("flight", manoeuvre, duration_s, groups, RUNS, 1))
    cpu_s = process_time() - began_s
    return f"{len(groups) * RUNS} lanes x {duration_s:.0f} s ({manoeuvre}): {cpu_s:.1f} s CPU, {_memory_MB():.0f} MB"


def _memory_MB() -> float:
    """Greatest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def target() -> str:
    """Both cuts and their figures of one target, with a navigation solution off by a metre."""
    scene = scene_of(simulated("flight.path").manoeuvre("sar"), OPENS_s)
    track_m = scene.true_m + 1.0
    impulse_response(scene.one, track_m, scene.target_m)  # everything is imported
    began_s = process_time()
    for _ in range(TARGETS):
        impulse_response(scene.one, track_m, scene.target_m)
    return f"one focused target: {(process_time() - began_s) / TARGETS:.2f} s CPU"


class _Silent:
    """Nobody is told what is done."""

    def done(self, task: Task, result: Any) -> Any:
        return result

    def said(self, text: str) -> None:
        sys.stderr.write(f"{text}\n")


def workers() -> str:
    """Wall clock and CPU time of flights with images in this process and on two workers."""
    tasks = image_tasks(StudyOptions(runs=RUNS, quick=True))
    alone, shared = [], []
    for _ in range(REPEATS):
        alone.append(_cost(lambda: [run_task(task) for task in tasks], resource.RUSAGE_SELF))
        shared.append(_cost(lambda: run_on_cluster("local:2", tasks, run_task, _Silent()), resource.RUSAGE_CHILDREN))
    same = "the same bytes" if len({cost.sha256 for cost in (*alone, *shared)}) == 1 else "NOT the same bytes"
    ratio = median(one.wall_s / two.wall_s for one, two in zip(alone, shared, strict=True))
    told = f"{_said('in one process', alone)}, {_said('on 2 workers', shared)}"
    return f"flights of {QUICK_LONG_s:.0f} s with images: {told}: {ratio:.2f} x, {same}"


@dataclass(frozen=True)
class _Cost:
    """Wall clock and CPU time of one way, and the hash of what it gave."""

    wall_s: float
    user_s: float
    system_s: float
    sha256: str


def _cost(computed: Callable[[], list[Any]], whose: int) -> _Cost:
    before, began_s = resource.getrusage(whose), perf_counter()
    results = computed()
    wall_s, after = perf_counter() - began_s, resource.getrusage(whose)
    user_s, system_s = after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime
    return _Cost(wall_s, user_s, system_s, sha256(b"".join(map(_bytes_of, results))).hexdigest())


def _bytes_of(value: Any) -> bytes:
    """Return every number of a result: what was sent is the same although its pickle is not."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if is_dataclass(value):
        return b"".join(_bytes_of(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, dict):
        return b"".join(_bytes_of(part) for part in value.values())
    return b"".join(map(_bytes_of, value)) if isinstance(value, tuple | list) else repr(value).encode()


def _said(where: str, costs: list[_Cost]) -> str:
    wall_s, user_s, system_s = (median(getattr(cost, name) for cost in costs) for name in TIMES)
    return f"{where} {wall_s:.0f} s (CPU {user_s:.0f} s of its own and {system_s:.0f} s of the system)"


PARTS = {
    "short": lambda: lanes("turn", SHORT_s),
    "long": lambda: lanes("sar", LONG_s),
    "target": target,
    "workers": workers,
}


def main() -> int:
    """Print a line for each part; each in a process of its own, with one thread for linear algebra."""
    if sys.argv[1:2] == [HERE]:
        sys.stdout.write(f"{PARTS[sys.argv[2]]()}\n")
        return 0
    command, one_thread = [sys.executable, "-m", "benchmarks.time_sync", HERE], dict.fromkeys(THREADS, "1")
    parts = sys.argv[1:] or list(PARTS)
    return max(subprocess.run([*command, one], check=False, env=os.environ | one_thread).returncode for one in parts)


if __name__ == "__main__":
    sys.exit(main())
