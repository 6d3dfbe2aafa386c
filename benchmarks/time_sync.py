"""Cost of the study of the time offset: 400 lanes of 60 s and 500 s, a focused target, two Dask workers against one.

Lanes: 4 offsets x 2 filters x 50 runs, with everything simulated and filtered. Each part runs in a process of its own,
so that its greatest memory is its own. Two workers against one: the flights of 500 s with their images, wall clock
with the start of the workers, results compared byte by byte.

Run: python -m benchmarks.time_sync [short|long|target|workers]...
"""

from __future__ import annotations

import os
import pickle
import resource
import subprocess
import sys
from time import perf_counter, process_time
from typing import Any

from bench.commands.cluster import THREADS, run_on_cluster
from bench.systems.time_sync.estimators.sar.response import impulse_response
from bench.systems.time_sync.study.flight import simulated
from bench.systems.time_sync.study.study import BASE, Group, LONG_s, SHORT_s, StudyOptions, Task, image_tasks
from bench.systems.time_sync.study.tasks import run_task, scene_of

HERE = "--here"
RUNS = 50
OFFSETS_s = (0.0, 0.010, 0.020, 0.030)
TARGETS = 5
OPENS_s = 490.0


def lanes(manoeuvre: str, duration_s: float) -> str:
    """One flight with all its lanes."""
    groups = tuple(Group(offset_s, state, BASE) for offset_s in OFFSETS_s for state in (False, True))
    began_s = process_time()
    run_task(Task("flight", manoeuvre, duration_s, groups, RUNS, 1))
    cpu_s = process_time() - began_s
    return f"{len(groups) * RUNS} lanes x {duration_s:.0f} s ({manoeuvre}): {cpu_s:.1f} s CPU, {_memory_MB():.0f} MB"


def _memory_MB() -> float:
    """Greatest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def target() -> str:
    """Both cuts and their figures of one target, with a navigation solution off by a metre."""
    scene = scene_of(simulated("flight.path").MANOEUVRES["sar"], OPENS_s)
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
    """Wall clock of the flights with images on one worker and on two."""
    tasks = image_tasks(StudyOptions())
    walls_s, gave = [], []
    for count in (1, 2):
        began_s = perf_counter()
        gave.append([pickle.dumps(one) for one in run_on_cluster(f"local:{count}", tasks, run_task, _Silent())])
        walls_s.append(perf_counter() - began_s)
    same = "the same bytes" if gave[0] == gave[1] else "NOT the same bytes"
    one_s, two_s = walls_s
    told = f"{one_s:.0f} s with 1 worker, {two_s:.0f} s with 2"
    return f"flights of 500 s with images: {told}: {one_s / two_s:.2f} x, {same}"


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
