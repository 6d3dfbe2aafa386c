"""Cost of comparing many units: CPU time and memory of ``bench batch`` over 25, 50, 100 and 200 sessions.

Run: python -m benchmarks.batch [SESSIONS]. The sessions are unit tests of one module each, made by virtual runs first.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

from bench.commands.batch import batch
from bench.commands.requests import RunRequest
from bench.commands.run import run

SEQUENCE = "gnc_unit_test"
MOST = 200


def make_session(out: Path, number: int) -> None:
    """A unit test of a module of its own."""
    settings = [f"units=GNC-{number:03d}", f"batch=B-{number:03d}"]
    run(RunRequest(SEQUENCE, settings=settings, clock="virtual", seed=number, out=out))


@contextmanager
def quiet() -> Iterator[None]:
    """What the commands print is not of interest here."""
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        yield


def measured(sessions: list[Path], out: Path) -> tuple[float, float]:
    """CPU and wall-clock seconds of one batch."""
    cpu_s, wall_s = process_time(), perf_counter()
    with quiet():
        batch(sessions, out, as_json=False)
    return process_time() - cpu_s, perf_counter() - wall_s


def main() -> int:
    """Print a line for each number of sessions."""
    most = int(sys.argv[1]) if len(sys.argv) > 1 else MOST
    with TemporaryDirectory() as folder:
        began_s = process_time()
        with quiet():
            for number in range(1, most + 1):
                make_session(Path(folder, "in"), number)
        sessions = sorted(path for path in Path(folder, "in").iterdir() if path.is_dir())
        sys.stdout.write(f"{len(sessions)} sessions of {SEQUENCE} made in {process_time() - began_s:.0f} s CPU\n")
        measured(sessions[:2], Path(folder, "out"))  # everything is imported
        sys.stdout.write("sessions   CPU s    wall s   ms/session   against the first   greatest memory\n")
        first = 0.0
        for count in (most // 8, most // 4, most // 2, most):
            cpu_s, wall_s = measured(sessions[:count], Path(folder, "out"))
            first = first or cpu_s / count
            memory_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            each = f"{1e3 * cpu_s / count:12.1f} {cpu_s / count / first:19.3f}"
            sys.stdout.write(f"{count:8d} {cpu_s:7.2f} {wall_s:9.2f} {each} {memory_MB:13.0f} MB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
