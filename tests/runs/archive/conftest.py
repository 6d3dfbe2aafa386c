"""The archive that the tests of this folder share."""

import sqlite3
from contextlib import closing
from pathlib import Path

import archive_sample
import pytest
from rehearsal import recorded, writable_copy

from bench.archive.index import add
from bench.archive.work import computed_here


def _record(out: Path) -> None:
    archive_sample.record(archive_sample.small(), out)
    add(f"sqlite:///{out / 'history.sqlite'}", [str(out)], computed_here, lambda _: None)


@pytest.fixture(scope="session")
def recorded_archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the sessions of ``archive_sample.small`` with their history, in which they are entered; read only."""
    return recorded(tmp_path_factory, "archive", _record)


@pytest.fixture
def archive(recorded_archive: Path, tmp_path: Path) -> Path:
    """Return a copy of these sessions, with a history of their own that can be written and knows them there."""
    folder = writable_copy(recorded_archive, tmp_path / "archive")
    with closing(sqlite3.connect(folder / "history.sqlite")) as history:
        moved = (str(recorded_archive), str(folder))
        history.execute("UPDATE archived_sessions SET location = replace(location, ?, ?)", moved)
        history.commit()
    return folder
