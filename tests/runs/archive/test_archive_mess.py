"""Folders of 27 kinds of damage: each in one count, and refits that are stopped in every way give the same bytes.

Some tens of folders here, three hundred in ``make sweep``. Each refit is a command of its own; what is stopped goes on
with the same command.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import archive_sample
import pyarrow.parquet
import pytest
from archive_sample import ALTERED, COMPUTED, KINDS, LOCKED, SHORT, WRONG_KINDS
from fsspec.implementations.local import LocalFileSystem
from rehearsal import Inside
from waiting import until

from bench.archive.index import add
from bench.archive.journal import JOURNAL
from bench.archive.trial import OUTCOME
from bench.archive.work import computed_here
from bench.commands.cluster import THREADS
from bench.model.clock import NS, WallClock
from bench.model.errors import ExitStatus

LONGEST_S = 900.0
CLOCK = WallClock()
_LS = LocalFileSystem.ls


def _locked(self: Any, path: str, **options: Any) -> Any:
    if path.endswith(LOCKED):
        raise PermissionError(13, "Permission denied")
    return _LS(self, path, **options)


@dataclass(frozen=True)
class Mess:
    """``due``: the session and the kind of each folder by its name; ``at``: sessions done when a refit is stopped."""

    root: Path
    due: Mapping[str, tuple[str, str]]
    concerned: set[str]
    at: int

    @property
    def url(self) -> str:
        return f"sqlite:///{self.root.parent / 'history.sqlite'}"

    def kinds(self, **others: str) -> dict[str, str]:
        """Return what each folder is, in words of a row."""
        return {name: others.get(kind, KINDS[kind][1]) for name, (_, kind) in self.due.items()}

    def sessions(self) -> set[str]:
        """Return the sessions of which a folder has a whole recording with records."""
        whole = {kind for kind, (_, due) in KINDS.items() if due == "entered"} - {"done_without_results"}
        return {session for session, kind in self.due.values() if kind in whole or kind in COMPUTED}


@pytest.fixture(
    scope="module",
    params=[pytest.param((len(KINDS), 17), id="some"), pytest.param((300, 140), id="300", marks=pytest.mark.sweep)],
)
def mess(request: pytest.FixtureRequest, recorded_archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Mess:
    """Return the folders, with a history that knows them."""
    count, at = request.param
    root = tmp_path_factory.mktemp("mess") / "sessions"
    campaigns, source = archive_sample.small(), recorded_archive
    if count > len(KINDS):
        campaigns, source = archive_sample.many(60), tmp_path_factory.mktemp("recorded")
        archive_sample.record(campaigns, source)
    due = archive_sample.make(root, [source / campaign.name for campaign in campaigns], count)
    made = Mess(root, due, archive_sample.concerned(campaigns), at)
    add(made.url, [str(root)], computed_here, lambda _: None)
    return made


def _document(said: str) -> tuple[Counter[str], dict[str, str]]:
    """Return the counts of a document, and kind with code by the name of the folder."""
    document = json.loads(said)
    counts = Counter({name: count for name, count in document.items() if name not in ("bytes", "rows")})
    assert all(row["reason"] and row["next_step"] for row in document["rows"])
    return counts, {Path(row["location"]).name: f"{row['kind']} {row['code']}".strip() for row in document["rows"]}


def test_each_folder_stands_in_exactly_one_count(
    mess: Mess, inside: Inside, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BENCH_HISTORY", f"sqlite:///{tmp_path / 'history.sqlite'}")
    monkeypatch.setattr(LocalFileSystem, "ls", _locked)
    due = mess.kinds() | {"link": "link"}
    done = inside("archive", "add", str(mess.root), "--json")
    assert done.returncode == ExitStatus.SESSION_DAMAGED, done.stderr
    counts, rows = _document(done.stdout)
    assert rows == {name: kind for name, kind in due.items() if kind != "entered"}
    assert +counts == Counter(kind.partition(" ")[0] for kind in due.values())
    again = inside("archive", "add", str(mess.root), "--json")
    second, rows_again = _document(again.stdout)
    assert (again.returncode, rows_again) == (ExitStatus.SESSION_DAMAGED, rows)
    assert second == counts - Counter(entered=counts["entered"]) + Counter(unchanged=counts["entered"])
    words = inside("archive", "add", str(mess.root)).stdout.splitlines()
    told = ", ".join(f"{second[name]} {name.replace('_', ' ')}" for name in counts)
    assert (words[-1].split("read; ")[1], len(words)) == (told, len(rows) + 1)
    done = inside("archive", "verify", "--json")
    verified, named = _document(done.stdout)
    damaged = {name: kind for name, kind in mess.kinds(altered=ALTERED).items() if "damaged" in kind}
    assert (done.returncode, named) == (ExitStatus.SESSION_DAMAGED, damaged)
    assert verified.total() == counts["entered"] + counts["damaged"]
    print(f"{sum(counts.values())} folders: {dict(+counts)}; {dict(+verified)}")


class Refit:
    """``bench archive refit`` of all sessions, with a history of its own."""

    def __init__(self, mess: Mess, folder: Path) -> None:
        self._mess, self.trial, self._history = mess, folder / "trial", folder / "history.sqlite"
        shutil.copy(mess.root.parent / "history.sqlite", self._history)

    def start(self, *options: str) -> subprocess.Popen[str]:
        words = [sys.executable, "-m", "bench", "archive", "refit", "--to", str(self.trial)]
        words += ["--history", f"sqlite:///{self._history}", *options]
        return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def done(self, *options: str) -> bytes:
        """Do all that is left; returns the outcome. Some sessions gave no values: exit status 1."""
        return self.outcome(self.start(*options))

    def outcome(self, process: subprocess.Popen[str]) -> bytes:
        _, said = process.communicate(timeout=LONGEST_S)
        assert process.returncode == ExitStatus.VERDICT_FAIL, said
        done = self.sessions()
        assert len(done) == len(set(done)) == json.loads((self.trial / "trial.json").read_text())["sessions"]
        return (self.trial / OUTCOME).read_bytes()

    def rows(self) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = pyarrow.parquet.read_table(self.trial / OUTCOME).to_pylist()
        return rows

    def sessions(self) -> list[str]:
        """Return the sessions that are done, as they stand in the journal."""
        path = self.trial / JOURNAL
        lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
        return [json.loads(line)["session_sha256"] for line in lines if line.endswith(b"\n")]

    def started(self, *options: str) -> subprocess.Popen[str]:
        """Start it, and wait until some sessions are done."""
        process = self.start(*options)
        until(lambda: process.poll() is not None or len(self.sessions()) >= self._mess.at, limit_s=LONGEST_S)
        assert process.poll() is None, process.communicate()
        return process


@pytest.fixture(scope="module")
def whole(mess: Mess, tmp_path_factory: pytest.TempPathFactory) -> Refit:
    """Return a refit that nothing stopped."""
    refit = Refit(mess, tmp_path_factory.mktemp("whole"))
    refit.done()
    return refit


@pytest.fixture
def refit(mess: Mess, tmp_path: Path) -> Refit:
    return Refit(mess, tmp_path)


def same(refit: Refit, outcome: bytes, whole: Refit) -> bool:
    print(f"{len(refit.sessions())} sessions, each once, {len(outcome)} bytes")
    return outcome == (whole.trial / OUTCOME).read_bytes()


def test_a_refit_says_of_each_session_what_verify_said(mess: Mess, whole: Refit) -> None:
    lost = Counter(kind for kind in mess.kinds().values() if kind in (SHORT, WRONG_KINDS))
    failed = Counter(f"damaged {row['code']}" for row in whole.rows() if row["code"])
    assert {kind: failed[kind] for kind in lost} == lost
    assert {row["session"] for row in whole.rows() if not row["code"]} == mess.sessions()


def test_exactly_the_sessions_of_a_changed_certificate(mess: Mess, whole: Refit, refit: Refit, tmp_path: Path) -> None:
    refit.done("--with-standards", str(archive_sample.corrected(tmp_path / "corrected.yaml")))
    before, after = whole.rows(), refit.rows()
    pairs = [pair for pair in zip(before, after, strict=True) if pair[0]["value"] != pair[1]["value"]]
    assert {now["session"] for _, now in pairs} == mess.concerned & mess.sessions()
    print(f"{len(mess.concerned & mess.sessions())} of {len(mess.sessions())} sessions have other values")


def test_killed(refit: Refit, whole: Refit) -> None:
    process = refit.started()
    process.kill()
    process.communicate()
    assert same(refit, refit.done(), whole)


def test_a_full_disk(refit: Refit, whole: Refit) -> None:
    """No file may become larger any more than the journal and half a session more."""
    process = refit.started()
    most = (refit.trial / JOURNAL).stat().st_size + 2_000
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, most))
    _, said = process.communicate(timeout=LONGEST_S)
    assert process.returncode == ExitStatus.BAD_INPUT
    assert "error B-" in said
    assert "Traceback" not in said
    assert same(refit, refit.done(), whole)


@contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers, each a process of its own; yields the address, the scheduler and the workers."""
    environment = {**os.environ, **dict.fromkeys(THREADS, "1")}
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    place = folder / "scheduler.json"
    place.unlink(missing_ok=True)
    words = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler = subprocess.Popen([*words, "--no-dashboard", "--scheduler-file", str(place)], **quiet)
    until(place.exists, "the scheduler's address", LONGEST_S)
    address = json.loads(place.read_text())["address"]
    words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]
    workers = [subprocess.Popen([*words, "--no-nanny", "--local-directory", str(folder)], **quiet) for _ in range(2)]
    try:
        yield address, scheduler, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_worker_and_then_the_scheduler_killed(refit: Refit, whole: Refit, tmp_path: Path) -> None:
    """Without a worker it goes on; without a scheduler it ends with one error, and another one does what is left."""
    with cluster(tmp_path) as (address, scheduler, workers):
        process = refit.started("--dask", address)
        workers[0].kill()
        left = len(refit.sessions())
        until(lambda: len(refit.sessions()) != left or process.poll() is not None)  # the other worker does one more
        scheduler.kill()
        killed_ns = CLOCK.now_ns()
        _, said = process.communicate(timeout=LONGEST_S)
        print(f"ended {(CLOCK.now_ns() - killed_ns) / NS:.0f} s behind it: {said.splitlines()[-1]}")
    assert "error B-ARC-007" in said
    assert "Traceback" not in said
    with cluster(tmp_path) as (address, *_):
        assert same(refit, refit.done("--dask", address), whole)
