"""Folders of 27 kinds of damage, each in one count; refits that are stopped in every way lose and double nothing."""

import json
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
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
from bench.archive.trial import OUTCOME, Asked, Refitted, refit_sessions
from bench.archive.work import Compute, computed_here
from bench.commands.cluster import THREADS
from bench.model.clock import NS, WallClock
from bench.model.errors import ExitStatus, InputError, RunError
from bench.store import Selection, list_sessions, read_trial

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
        return pyarrow.parquet.read_table(self.trial / OUTCOME).to_pylist()

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


def test_killed_and_then_on_a_full_disk(refit: Refit, whole: Refit) -> None:
    """No file may become larger any more than the journal and half a session more."""
    process = refit.started()
    process.kill()
    process.communicate()
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
    assert same(refit, refit.done(), whole)


ASKED = Asked(None, {}, {})
FEW = 4  # sessions; what stops a refit of many stops one of few


class Silent:
    """Nobody looks; ``act`` is done when the first session is."""

    def __init__(self, act: Callable[[], None] = lambda: None) -> None:
        self._act, self._count = act, 0

    def begin(self, total: int, done: int) -> None:
        return None

    def done(self, name: str) -> None:
        self._count += 1
        if self._count == 1:
            self._act()


def refitted(
    archive: Path, folder: Path, compute: Compute = computed_here, act: Callable[[], None] = lambda: None
) -> Refitted:
    """Compute the newest sessions of an archive again."""
    url = f"sqlite:///{archive / 'history.sqlite'}"
    return refit_sessions(url, list_sessions(url, Selection())[-FEW:], ASKED, folder, compute, Silent(act))


def rows_in(archive: Path) -> list[Any]:
    """All rows of trials, without the number of the trial."""
    with closing(sqlite3.connect(archive / "history.sqlite")) as history:
        columns = [row[1] for row in history.execute("PRAGMA table_info(trial_rows)") if row[1] != "trial_id"]
        return history.execute(f"SELECT {', '.join(columns)} FROM trial_rows ORDER BY 1, 2").fetchall()


@pytest.fixture(scope="module")
def whole_of(recorded_archive: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the outcome of a refit that nothing stopped."""
    folder = tmp_path_factory.mktemp("whole")
    url = f"sqlite:///{folder / 'history.sqlite'}"
    rows = list_sessions(f"sqlite:///{recorded_archive / 'history.sqlite'}", Selection())[-FEW:]
    refit_sessions(url, rows, ASKED, folder, computed_here, Silent())
    return (folder / OUTCOME).read_bytes()


def backwards(tasks: Sequence[Any], run_task: Callable[[Any], Any]) -> Iterator[tuple[Any, Any, str]]:
    yield from computed_here(tasks[::-1], run_task)


def test_the_order_changes_no_byte_and_a_second_time_changes_nothing(
    archive: Path, tmp_path: Path, whole_of: bytes
) -> None:
    done = refitted(archive, tmp_path / "trial", backwards)
    assert (tmp_path / "trial" / OUTCOME).read_bytes() == whole_of
    rows = rows_in(archive)
    assert len(rows) == done.rows == FEW * 10
    assert refitted(archive, tmp_path / "trial", unreachable).rows == done.rows
    assert rows_in(archive) == rows
    assert (tmp_path / "trial" / OUTCOME).read_bytes() == whole_of
    assert read_trial(f"sqlite:///{archive / 'history.sqlite'}", done.trial.name).state == "done"


def unreachable(tasks: Sequence[Any], run_task: Callable[[Any], Any]) -> Iterator[tuple[Any, Any, str]]:
    assert not tasks
    yield from ()


def test_storage_that_fails_for_a_while_is_no_result(archive: Path, tmp_path: Path, whole_of: bytes) -> None:
    """B-ARC-007: the session is not done, the others are; the same command does the rest."""
    tried: list[str] = []

    def failing(run_task: Callable[[Any], Any], task: Any) -> Any:
        tried.append(task.name)
        if len(tried) == 2:
            raise OSError(5, "Input/output error")
        return run_task(task)

    def compute(tasks: Sequence[Any], run_task: Callable[[Any], Any]) -> Iterator[tuple[Any, Any, str]]:
        return computed_here(tasks, partial(failing, run_task))

    with pytest.raises(RunError, match=f"1 of {FEW} sessions") as caught:
        refitted(archive, tmp_path / "t", compute)
    assert caught.value.code == "B-ARC-007"
    assert "Input/output error" in caught.value.message
    assert rows_in(archive) == []
    refitted(archive, tmp_path / "t", compute)
    assert len(tried) == FEW + 1
    assert (tmp_path / "t" / OUTCOME).read_bytes() == whole_of


def test_another_refit_needs_another_folder(archive: Path, tmp_path: Path) -> None:
    refitted(archive, tmp_path / "t")
    url = f"sqlite:///{archive / 'history.sqlite'}"
    rows = list_sessions(url, Selection())[:1]
    with pytest.raises(InputError, match="of another refit"):
        refit_sessions(url, rows, ASKED, tmp_path / "t", computed_here, Silent())


def test_copies_are_one_session_and_the_whole_one_is_read(archive: Path, tmp_path: Path, whole_of: bytes) -> None:
    url = f"sqlite:///{archive / 'history.sqlite'}"
    rows = list_sessions(url, Selection())[-FEW:]
    damaged = [{**row, "location": f"/0/{row['session']}", "code": "B-REC-011"} for row in rows]
    done = refit_sessions(url, [*damaged, *rows], ASKED, tmp_path / "t", computed_here, Silent())
    assert done.trial.sessions == FEW
    assert (tmp_path / "t" / OUTCOME).read_bytes() == whole_of
