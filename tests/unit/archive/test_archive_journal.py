"""The journal of a refit: what was written before anything stopped it is there once, and nothing else."""

from __future__ import annotations

import json
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.archive.journal import HEAD, JOURNAL, TrialJournal
from bench.model.errors import InputError

NAME = {"name": "0123456789abcdef"}


def filled(folder: Path, *keys: str) -> TrialJournal:
    journal = TrialJournal(folder, NAME)
    for key in keys:
        journal.add(key, [{"session_sha256": key, "value": 1.5}])
    return journal


def test_it_goes_on_and_gives_the_sessions_in_their_order(tmp_path: Path) -> None:
    filled(tmp_path, "b", "a")
    journal = filled(tmp_path, "c")
    assert journal.done == {"a", "b", "c"}
    assert [rows[0]["session_sha256"] for rows in journal.sessions()] == ["a", "b", "c"]


@pytest.mark.parametrize("cut", range(1, 47))
def test_a_line_that_was_being_written_is_written_again(tmp_path: Path, cut: int) -> None:
    """Stopped at every byte of the last line."""
    filled(tmp_path, "b", "a")
    path = tmp_path / JOURNAL
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    journal = TrialJournal(tmp_path, NAME)
    assert journal.done == {"b"}
    journal.add("a", [{"session_sha256": "a", "value": 1.5}])
    assert path.read_bytes() == whole


def test_a_folder_of_another_refit_b_arc_006(tmp_path: Path) -> None:
    filled(tmp_path, "a")
    with pytest.raises(InputError, match="is of another refit") as caught:
        TrialJournal(tmp_path, {"name": "f" * 16})
    assert caught.value.code == "B-ARC-006"
    (tmp_path / HEAD).write_text("{")
    with pytest.raises(InputError, match="is no head of a refit"):
        TrialJournal(tmp_path, NAME)
    assert (tmp_path / JOURNAL).read_text().count("\n") == 1


@pytest.fixture
def no_signal() -> Iterator[None]:
    """Have a write beyond the limit fail, as on a full disk, and not end the process."""
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGXFSZ, before)


def test_a_full_disk_leaves_whole_lines(tmp_path: Path, no_signal: None) -> None:
    journal = filled(tmp_path, "a")
    path = tmp_path / JOURNAL
    size = path.stat().st_size
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, before[1]))
    try:
        with pytest.raises(InputError) as caught:
            journal.add("b", [{"session_sha256": "b", "fault": "x" * 10_000}])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.code == "B-CLI-007"
    assert path.stat().st_size == size
    journal.add("b", [{"session_sha256": "b"}])
    assert [json.loads(line)["session_sha256"] for line in path.read_text().splitlines()] == ["a", "b"]
