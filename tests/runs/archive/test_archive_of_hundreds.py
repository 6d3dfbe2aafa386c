"""Two hundred archived sessions, one damaged since: a refit that is killed, or loses a worker, the scheduler, the disk.

Part of ``make sweep``. Each refit is a command of its own; what is stopped goes on with the same command, and has the
bytes of the one that nothing stopped.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import archive_sample
import pytest

from bench.archive.index import add
from bench.archive.journal import JOURNAL
from bench.archive.trial import OUTCOME
from bench.archive.work import computed_here
from bench.commands.cluster import THREADS
from bench.model.clock import NS, WallClock
from bench.model.errors import ExitStatus
from bench.store import read_trial

pytestmark = pytest.mark.sweep
COUNT, DAMAGED, AT = 200, 77, 60  # sessions; which one is damaged; how many are done when something happens
LONGEST_S = 600.0
CLOCK = WallClock()


@pytest.fixture(scope="module")
def hundreds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the sessions and their history; one byte of a session is another one since it was added."""
    out = tmp_path_factory.mktemp("hundreds")
    campaigns = archive_sample.many(COUNT)
    archive_sample.record(campaigns, out)
    add(f"sqlite:///{out / 'history.sqlite'}", [str(out)], computed_here, lambda _: None)
    segment = next((out / campaigns[DAMAGED].name).glob("session.*.mcap"))
    content = bytearray(segment.read_bytes())
    content[len(content) // 2] ^= 0xFF
    segment.write_bytes(content)
    return out


class Refit:
    """``bench archive refit`` of all sessions, with a history of its own."""

    def __init__(self, hundreds: Path, folder: Path) -> None:
        self.trial, self._history = folder / "trial", folder / "history.sqlite"
        shutil.copy(hundreds / "history.sqlite", self._history)

    @property
    def url(self) -> str:
        return f"sqlite:///{self._history}"

    def start(self, *dask: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-m", "bench", "archive", "refit", "--to", str(self.trial), "--history", self.url]
        return subprocess.Popen([*words, *dask], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def done(self, *dask: str) -> bytes:
        """Do all that is left; returns the outcome. One session gave no values: exit status 1."""
        process = self.start(*dask)
        _, said = process.communicate(timeout=LONGEST_S)
        assert process.returncode == ExitStatus.VERDICT_FAIL, said
        return (self.trial / OUTCOME).read_bytes()

    def sessions(self) -> list[str]:
        """Return the sessions that are done, as they stand in the journal."""
        path = self.trial / JOURNAL
        lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
        return [json.loads(line)["session_sha256"] for line in lines if line.endswith(b"\n")]

    def wait(self, process: subprocess.Popen[str]) -> None:
        """Wait until ``AT`` sessions are done and the process goes on."""
        began_ns = CLOCK.now_ns()
        while len(self.sessions()) < AT:
            assert process.poll() is None, process.communicate()
            assert (CLOCK.now_ns() - began_ns) / NS < LONGEST_S
            CLOCK.sleep(0.2)


@pytest.fixture(scope="module")
def whole(hundreds: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return Refit(hundreds, tmp_path_factory.mktemp("whole")).done()


@pytest.fixture
def refit(hundreds: Path, tmp_path: Path) -> Refit:
    return Refit(hundreds, tmp_path)


def nothing_lost(refit: Refit, outcome: bytes, whole: bytes) -> None:
    """The same bytes; each session once in the journal; rows of the damaged one are one, with its code."""
    assert outcome == whole
    done = refit.sessions()
    assert len(done) == len(set(done)) == COUNT
    trial = read_trial(refit.url, json.loads((refit.trial / "trial.json").read_text())["name"])
    assert (trial.state, trial.trial.sessions, len(trial.rows)) == ("done", COUNT, 10 * (COUNT - 1) + 1)
    lines = (refit.trial / JOURNAL).read_text().splitlines()
    wrong = [rows[0] for rows in (json.loads(line)["rows"] for line in lines) if rows[0]["code"]]
    assert [(row["session"], row["code"]) for row in wrong] == [(archive_sample.many(COUNT)[DAMAGED].name, "B-REC-011")]


def test_killed(refit: Refit, whole: bytes) -> None:
    process = refit.start()
    refit.wait(process)
    process.kill()
    process.communicate()
    assert AT <= len(refit.sessions()) < COUNT
    nothing_lost(refit, refit.done(), whole)


def test_a_full_disk(refit: Refit, whole: bytes) -> None:
    """No file may become larger any more than the journal and one session more."""
    process = refit.start()
    refit.wait(process)
    most = (refit.trial / JOURNAL).stat().st_size + 10_000
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, most))
    _, said = process.communicate(timeout=LONGEST_S)
    assert process.returncode == ExitStatus.BAD_INPUT
    assert "error B-" in said
    assert "Traceback" not in said
    nothing_lost(refit, refit.done(), whole)


@contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers, each a process of its own; yields the address, the scheduler and the workers."""
    environment = {**os.environ, **dict.fromkeys(THREADS, "1")}
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    place = folder / "scheduler.json"
    place.unlink(missing_ok=True)
    words = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler = subprocess.Popen([*words, "--no-dashboard", "--scheduler-file", str(place)], **quiet)
    while not place.exists():
        CLOCK.sleep(0.1)
    address = json.loads(place.read_text())["address"]
    words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]
    workers = [subprocess.Popen([*words, "--no-nanny", "--local-directory", str(folder)], **quiet) for _ in range(2)]
    try:
        yield address, scheduler, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def test_a_killed_worker(refit: Refit, whole: bytes, tmp_path: Path) -> None:
    with cluster(tmp_path) as (address, _, workers):
        process = refit.start("--dask", address)
        refit.wait(process)
        workers[0].kill()
        _, said = process.communicate(timeout=LONGEST_S)
        assert process.returncode == ExitStatus.VERDICT_FAIL, said
    nothing_lost(refit, (refit.trial / OUTCOME).read_bytes(), whole)


def test_a_killed_scheduler(refit: Refit, whole: bytes, tmp_path: Path) -> None:
    """The refit ends with one error instead of waiting for ever; with another scheduler the same command goes on."""
    with cluster(tmp_path) as (address, scheduler, _):
        process = refit.start("--dask", address)
        refit.wait(process)
        scheduler.kill()
        killed_ns = CLOCK.now_ns()
        _, said = process.communicate(timeout=LONGEST_S)
        print(f"ended {(CLOCK.now_ns() - killed_ns) / NS:.0f} s behind it: {said.splitlines()[-1]}")
    assert "error B-ARC-007" in said
    assert "Traceback" not in said
    assert AT <= len(refit.sessions()) < COUNT
    with cluster(tmp_path) as (address, *_):
        nothing_lost(refit, refit.done("--dask", address), whole)
