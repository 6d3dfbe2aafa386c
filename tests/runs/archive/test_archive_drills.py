"""Refits that are stopped in every way: nothing is lost, nothing doubled, and the outcome has the same bytes."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from bench.archive.trial import OUTCOME, Asked, Refitted, refit_sessions
from bench.archive.work import Compute, computed_here
from bench.model.errors import InputError, RunError
from bench.store import Selection, list_sessions, read_trial

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


def refit(
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
def whole(recorded_archive: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the outcome of a refit that nothing stopped."""
    folder = tmp_path_factory.mktemp("whole")
    url = f"sqlite:///{folder / 'history.sqlite'}"
    rows = list_sessions(f"sqlite:///{recorded_archive / 'history.sqlite'}", Selection())[-FEW:]
    refit_sessions(url, rows, ASKED, folder, computed_here, Silent())
    return (folder / OUTCOME).read_bytes()


def backwards(tasks: Sequence[Any], run_task: Callable[[Any], Any]) -> Iterator[tuple[Any, Any, str]]:
    yield from computed_here(tasks[::-1], run_task)


def test_the_order_changes_no_byte_and_a_second_time_changes_nothing(
    archive: Path, tmp_path: Path, whole: bytes
) -> None:
    done = refit(archive, tmp_path / "trial", backwards)
    assert (tmp_path / "trial" / OUTCOME).read_bytes() == whole
    rows = rows_in(archive)
    assert len(rows) == done.rows == FEW * 10
    again = refit(archive, tmp_path / "trial", unreachable)
    assert (again.before, again.rows) == (FEW, done.rows)
    assert rows_in(archive) == rows
    assert (tmp_path / "trial" / OUTCOME).read_bytes() == whole
    assert read_trial(f"sqlite:///{archive / 'history.sqlite'}", done.trial.name).state == "done"


def unreachable(tasks: Sequence[Any], run_task: Callable[[Any], Any]) -> Iterator[tuple[Any, Any, str]]:
    assert not tasks
    yield from ()


def test_storage_that_fails_for_a_while_is_no_result(archive: Path, tmp_path: Path, whole: bytes) -> None:
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
        refit(archive, tmp_path / "t", compute)
    assert caught.value.code == "B-ARC-007"
    assert "Input/output error" in caught.value.message
    assert rows_in(archive) == []
    assert refit(archive, tmp_path / "t").before == FEW - 1
    assert (tmp_path / "t" / OUTCOME).read_bytes() == whole


def test_another_refit_needs_another_folder(archive: Path, tmp_path: Path) -> None:
    refit(archive, tmp_path / "t")
    url = f"sqlite:///{archive / 'history.sqlite'}"
    rows = list_sessions(url, Selection())[:1]
    with pytest.raises(InputError, match="of another refit"):
        refit_sessions(url, rows, ASKED, tmp_path / "t", computed_here, Silent())


def test_copies_are_one_session_and_the_whole_one_is_read(archive: Path, tmp_path: Path, whole: bytes) -> None:
    url = f"sqlite:///{archive / 'history.sqlite'}"
    rows = list_sessions(url, Selection())[-FEW:]
    damaged = [{**row, "location": f"/0/{row['session']}", "code": "B-REC-011"} for row in rows]
    done = refit_sessions(url, [*damaged, *rows], ASKED, tmp_path / "t", computed_here, Silent())
    assert done.trial.sessions == FEW
    assert (tmp_path / "t" / OUTCOME).read_bytes() == whole
