"""A history that is missing, locked, damaged, of another version, or killed while written: one error, nothing half."""

import multiprocessing
import signal
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import store_sample
from sqlalchemy import Connection, func, select
from store_sample import BACKENDS, every_document, new_history, write

from bench.analysis import documents
from bench.model.errors import ExitStatus
from bench.session.history import chosen_url
from bench.store import (
    Filters,
    StoreError,
    compare_unit,
    export_history,
    list_calibrations,
    record_calibration,
    show_calibration,
)
from bench.store import database as opened
from bench.store.database import reading
from bench.store.errors import masked
from bench.store.tables import calibrations, estimates, quality_counts, report_revisions, result_sets


def record(url: str) -> str:
    """Record a calibration; the code of the error, "" if there was none."""
    document, manifest = store_sample.calibrations(1, 30.0, 1)[0]
    try:
        record_calibration(url, document, manifest, "r")
    except StoreError as error:
        said = error
    else:
        return ""
    assert said.exit_status == ExitStatus.BAD_INPUT
    assert said.next_step
    assert "\n" not in str(said)
    return said.code


def read(url: str) -> str:
    """List the history; the code of the error, "" if there was none."""
    try:
        list_calibrations(url, Filters())
    except StoreError as error:
        return error.code
    return ""


def test_where_the_history_is(tmp_path: Path) -> None:
    assert chosen_url(None, Path("sessions"), {}) == "sqlite:///sessions/history.sqlite"
    assert chosen_url(None, tmp_path, {"BENCH_HISTORY": "sqlite:///a"}) == "sqlite:///a"
    assert chosen_url("sqlite:///b", tmp_path, {"BENCH_HISTORY": "sqlite:///a"}) == "sqlite:///b"


@pytest.mark.parametrize("url", ["", "history.sqlite", "mysql://somewhere/x", "sqlite://", "sqlite:///:memory:", "a b"])
def test_no_address(url: str) -> None:
    assert record(url) == read(url) == "B-STORE-001"


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://me:secret@host/x",
        "postgresql://me:sec/ret@host/x",
        "postgresql://me:s@secret@host:5432/x",
        "postgresql://host/x?user=me&password=secret",
        "postgresql://me@host/x?sslmode=require&sslpassword=secret&a=b",
        "host=h password=secret user=me",
        "host=h password = 'my secret' user=me",
        "mysql://me:secret@host/x",
        "postgresql://me:secret@host:port/x",
        "post gresql://me:secret@host/x",
    ],
)
def test_a_password_is_in_no_message_in_whatever_form_it_was_given(url: str) -> None:
    for said in (masked(url), masked(f"cannot open {url}")):
        assert "secret" not in said
        assert "sec/ret" not in said
        assert "***" in said
    with pytest.raises(StoreError) as caught:
        record_calibration(url, {}, {}, None)
    assert "secret" not in str(caught.value)
    assert "sec/ret" not in str(caught.value)


def test_what_holds_no_password_stays_as_it_is() -> None:
    for url in ("sqlite:////srv/a:b@c/history.sqlite", "postgresql://me@host:5432/x", "postgresql://[::1]:5432/x"):
        assert masked(url) == url


def test_a_driver_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.store.database.find_spec", lambda name: None)
    with pytest.raises(StoreError, match=r"inertial-bench\[postgresql\]") as caught:
        list_calibrations("postgresql://me:secret@127.0.0.1/x", Filters())
    assert caught.value.code == "B-STORE-001"
    assert "secret" not in str(caught.value)


def test_a_server_or_a_folder_that_is_not_there(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    assert record("postgresql://me@127.0.0.1:1/x") == read("postgresql://me@127.0.0.1:1/x") == "B-STORE-002"
    (tmp_path / "file").write_text("")
    assert record(f"sqlite:///{tmp_path}/file/history.sqlite") == "B-STORE-002"
    assert record(f"sqlite:///{tmp_path}") == "B-STORE-002"  # a folder where a file is due


@pytest.mark.parametrize("backend", BACKENDS)
def test_another_program_holds_it(backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opened, "WAIT_S", 1)
    url = new_history(backend, tmp_path)
    assert record(url) == ""
    with opened.writing(url, ""):
        assert record(url) == "B-STORE-003"
        assert read(url) == ""  # one that is being written can still be read
    assert record(url) == ""


def test_damaged_files_and_other_databases(tmp_path: Path) -> None:
    path = tmp_path / "history.sqlite"
    url = f"sqlite:///{path}"
    path.write_bytes(b"not a database, but long enough to look like one" * 100)
    assert record(url) == read(url) == "B-STORE-004"
    path.unlink()
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE addresses (name TEXT)")
    connection.close()
    assert record(url) == read(url) == "B-STORE-004"
    path.unlink()
    assert record(url) == ""
    whole = path.read_bytes()
    path.write_bytes(whole[:4096] + b"\xff" * 4096 * 8 + whole[4096 * 9 :])
    assert record(url) == "B-STORE-004"
    path.write_bytes(whole)
    with sqlite3.connect(path) as connection:
        connection.execute("DELETE FROM history")
    connection.close()
    assert record(url) == read(url) == "B-STORE-004"


def test_an_empty_file_is_filled_and_a_missing_one_is_said(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "history.sqlite"
    url = f"sqlite:///{path}"
    assert read(url) == "B-STORE-007"
    assert not path.parent.exists()
    assert record(url) == ""
    path.write_bytes(b"")
    assert read(url) == "B-STORE-007"
    assert record(url) == read(url) == ""


@pytest.mark.parametrize("backend", BACKENDS)
def test_tables_of_another_version(backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = new_history(backend, tmp_path)
    assert record(url) == ""
    now = opened.VERSION
    monkeypatch.setattr(opened, "VERSION", now + 1)
    assert record(url) == read(url) == "B-STORE-005"  # nobody has written the step to it
    steps: list[int] = []

    def step(connection: Connection) -> None:
        steps.append(1)
        connection.exec_driver_sql("ALTER TABLE calibrations ADD COLUMN remark TEXT")

    upgrades: dict[int, Callable[[Connection], None]] = {now: step}
    monkeypatch.setattr(opened, "UPGRADES", upgrades)
    assert read(url) == record(url) == ""
    assert steps == [1]
    monkeypatch.setattr(opened, "VERSION", now)
    assert record(url) == read(url) == "B-STORE-005"  # written by a later release


def test_a_history_that_is_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a full or write-protected disk, which also stops root."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "history.sqlite"
    assert record(f"sqlite:///{path}") == ""
    address = f"sqlite:///file:{path}?mode=ro&uri=true"
    document, manifest = store_sample.calibrations(2, 30.0, 1)[1]
    with pytest.raises(StoreError, match="B-STORE-006"):
        record_calibration(address, document, manifest, None)
    assert len(list_calibrations(f"sqlite:///{path}", Filters())) == 1
    assert not (tmp_path / "file:").exists(), "the folder of the file is meant, not one named after the scheme"


def test_an_empty_history_has_nothing_to_compare(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'history.sqlite'}"
    with opened.writing(url, ""):
        pass
    assert list_calibrations(url, Filters()) == []
    for ask in (lambda: compare_unit(url, Filters()), lambda: show_calibration(url, "x")):
        with pytest.raises(StoreError, match=r"B-STORE-009: .*import"):
            ask()


def test_exports_that_are_not_possible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"sqlite:///{tmp_path / 'history.sqlite'}"
    assert record(url) == ""
    monkeypatch.setattr("bench.store.rows.find_spec", lambda name: None)
    for name, said in (("x.parquet", r"inertial-bench\[parquet\]"), ("x.xlsx", "neither .csv nor .parquet")):
        with pytest.raises(StoreError, match=f"B-STORE-012: .*{said}"):
            export_history(url, Filters(), tmp_path / name)
        assert not (tmp_path / name).exists()


def test_what_nobody_foresaw_does_not_end_a_run_either(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"sqlite:///{tmp_path / 'history.sqlite'}"
    assert record(url) == ""
    monkeypatch.setattr("bench.store.recording._new_calibration", lambda *_: 1 / 0)
    document, manifest = store_sample.calibrations(2, 30.0, 1)[1]
    with pytest.raises(StoreError, match=r"B-STORE-014: .*ZeroDivisionError"):
        record_calibration(url, document, manifest, None)
    assert len(list_calibrations(url, Filters())) == 1


SEED, COUNT = 5, 5
LONGEST_s = 0.5
STATEMENTS = (3, 20, 33, 38, 44, 61, 70)  # of the creation, of the first session, of later ones


PROCESSES = multiprocessing.get_context("forkserver")
PROCESSES.set_forkserver_preload(["bench.store"])  # which takes longer to import than everything to be written


def killed_after(url: str, wait_s: float) -> int | None:
    """Let the writer write for a while, kill it; its exit status."""
    ready, told = PROCESSES.Pipe(duplex=False)
    process = PROCESSES.Process(target=write, args=(url, SEED, COUNT, 0, told))
    process.start()
    assert ready.recv() == "ready"
    time.sleep(wait_s)
    process.kill()
    process.join()
    return process.exitcode


def sessions_in(url: str) -> int:
    """Number of calibrations; asserts that every one of them is whole."""
    known = {}
    for document, _, report in every_document(SEED, COUNT):
        known[document["provenance"]["session_sha256"], document["method"]] = (document["estimates"], report)
    try:
        rows = list_calibrations(url, Filters())
    except StoreError as error:
        if error.code == "B-STORE-007":  # killed before there were tables
            return 0
        raise
    for row in rows:
        wanted, report = known[row["session_sha256"], row["method"]]
        shown = show_calibration(url, row["session_sha256"])
        assert documents(shown.estimates) == wanted
        assert shown.revisions[-1]["report_sha256"] == report
        assert len(shown.standards) == 1
        assert len(shown.shared) == 2
        assert len(shown.quality) == 6
    nothing_is_left_over(url)
    return len(rows)


def nothing_is_left_over(url: str) -> None:
    """Every result set has its estimates, every calibration a revision."""
    with reading(url) as connection:
        has = dict(
            connection.execute(
                select(estimates.c.result_set_id, func.count()).group_by(estimates.c.result_set_id)
            ).all()
        )
        stated = dict(connection.execute(select(result_sets.c.id, result_sets.c.estimates)).all())
        assert has == stated
        assert set(connection.execute(select(quality_counts.c.result_set_id)).scalars()) == set(stated)
        assert set(connection.execute(select(report_revisions.c.result_set_id)).scalars()) == set(stated)
        revised = set(connection.execute(select(report_revisions.c.calibration_id)).scalars())
        assert revised == set(connection.execute(select(calibrations.c.id)).scalars())
        if connection.dialect.name == "sqlite":
            assert connection.exec_driver_sql("PRAGMA integrity_check").scalar_one() == "ok"
            assert connection.exec_driver_sql("PRAGMA foreign_key_check").all() == []


def completed(url: str) -> None:
    """Write everything again; what was there is unchanged, the rest is added."""
    before = sessions_in(url)
    outcomes = [record_calibration(url, *words).outcome for words in every_document(SEED, COUNT)]
    assert outcomes.count("new") == COUNT - before
    assert sessions_in(url) == COUNT
    with reading(url) as connection:
        assert connection.execute(select(func.count()).select_from(result_sets)).scalar_one() == len(outcomes)


@pytest.mark.sweep
@pytest.mark.parametrize("backend", BACKENDS)
def test_killed_at_50_random_instants(backend: str, tmp_path: Path) -> None:
    for number in range(50):
        folder = tmp_path / str(number)
        folder.mkdir()
        kill_and_complete(new_history(backend, folder), 1000 + number)


def kill_and_complete(url: str, seed: int) -> None:
    wait_s = float(np.random.default_rng(seed).uniform(0.0, LONGEST_s))
    status = killed_after(url, wait_s)
    assert status in (-signal.SIGKILL, 0)
    print(f"seed {seed}: killed {wait_s:.3f} s after the first write, {sessions_in(url)} of {COUNT} sessions written")
    completed(url)


@pytest.mark.parametrize(
    ("backend", "statement"), [("sqlite", one) for one in STATEMENTS] + [("postgresql", one) for one in STATEMENTS[-2:]]
)
def test_killed_before_a_statement(backend: str, statement: int, tmp_path: Path) -> None:
    """The instants that count lie inside the transaction, so they are not left to chance."""
    url = new_history(backend, tmp_path)
    process = PROCESSES.Process(target=write, args=(url, SEED, COUNT, statement))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    print(f"killed before statement {statement}: {sessions_in(url)} sessions")
    completed(url)
