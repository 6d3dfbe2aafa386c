"""An archive of years, refitted in this process, on one worker and on two: the same bytes, time, memory, the recall.

The sessions are those of the tests: fifty units on two benches, one calibrator certificate wrong by 60 ppm from a date
on, a specimen of a certificate for every tenth session. They are recorded into FOLDER, where those that are there stay.

The ratio of one worker to two is the median of three pairs, by the wall clock.

Run: python -m benchmarks.archive [sessions] [FOLDER]; ``make archive-drill N=1000``.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from statistics import median
from time import perf_counter

SUPPORT = Path(__file__).resolve().parents[1] / "tests" / "support"
LABORATORY = Path(__file__).resolve().parents[1] / "docs" / "laboratory.yaml"
SESSIONS, FOLDER = 100, Path("build/archive-drill")
WAYS = {"here": [], "1 worker": ["--dask", "local:1"], "2 workers": ["--dask", "local:2"]}
PAIRS = 3


def main(words: Sequence[str]) -> int:
    """Print a table; exit status 1 if a byte differs or another certificate is recalled than those concerned."""
    count = int(words[0]) if words else SESSIONS
    folder = Path(words[1]) if len(words) > 1 else FOLDER
    sys.path.append(str(SUPPORT))
    import archive_sample

    campaigns = archive_sample.many(count)
    sessions = folder / "sessions"
    sessions.mkdir(parents=True, exist_ok=True)
    archive_sample.record(campaigns, sessions)
    register = archive_sample.corrected(folder / "corrected.yaml")
    certified = campaigns[::10]
    _certify([sessions / campaign.name for campaign in certified])
    history = ["--history", f"sqlite:///{sessions / 'history.sqlite'}"]
    _say("add", *_measured("add", str(sessions), *history))
    outcomes, walls_s = set(), {name: list[float]() for name in WAYS}
    for name in ("here", *("1 worker", "2 workers") * PAIRS):
        trial = folder / name.replace(" ", "-")
        for path in trial.glob("*"):
            path.unlink()
        refit = ("refit", "--with-standards", str(register), "--to", str(trial), *WAYS[name], *history)
        measured = _measured(*refit)
        _say(name, *measured)
        walls_s[name].append(measured[0])
        outcomes.add((trial / "refit.parquet").read_bytes())
    ratios = [one / two for one, two in zip(walls_s["1 worker"], walls_s["2 workers"], strict=True)]
    sys.stdout.write(f"one worker to two: {median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})\n")
    recalled = _recalled(folder / "here", history)
    due = archive_sample.concerned(certified)
    same = len(outcomes) == 1
    sys.stdout.write(f"the same bytes: {same}; certificates recalled: {len(recalled)}, due: {len(due)}\n")
    return 0 if same and recalled == due else 1


def _certify(folders: Sequence[Path]) -> None:
    from bench.commands.certificate import certificate
    from bench.commands.requests import CertificateRequest

    for folder in folders:
        if not (folder / "certificate.specimen.xml").exists():
            with redirect_stdout(StringIO()):
                certificate(CertificateRequest(folder, LABORATORY, specimen=True))


def _measured(*words: str) -> tuple[float, float, float]:
    """Run ``bench archive``; seconds of wall time, CPU seconds of all its processes, the largest of them in MB."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = perf_counter()
    command = [sys.executable, "-m", "bench", "archive", *words]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=dict(os.environ))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return perf_counter() - began, cpu_s, after.ru_maxrss / 1024.0


def _say(name: str, wall_s: float, cpu_s: float, peak_mb: float) -> None:
    sys.stdout.write(f"{name:<10} {wall_s:8.1f} s wall {cpu_s:8.1f} s CPU, largest process so far {peak_mb:6.0f} MB\n")
    sys.stdout.flush()


def _recalled(trial: Path, history: Sequence[str]) -> set[str]:
    command = [sys.executable, "-m", "bench", "archive", "changes", str(trial), "--json", *history]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return {entry["session"] for entry in json.loads(done.stdout)["certificates"]}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
