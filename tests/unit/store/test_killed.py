"""Killed while writing: nothing is half written, and writing again completes the history."""

from __future__ import annotations

import multiprocessing
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import func, select
from store_database import BACKENDS, new_history
from store_writer import every_document, write

from bench.store import Filters, StoreError, list_calibrations, record_calibration, show_calibration
from bench.store.database import reading
from bench.store.tables import calibrations, estimates, quality_counts, report_revisions, result_sets

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
        assert shown.estimates == wanted
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


@pytest.mark.parametrize(("backend", "number"), [(BACKENDS[number % 2], number) for number in range(4)])
def test_killed_at_a_random_instant(backend: str, number: int, tmp_path: Path) -> None:
    """A few of the fifty of the sweep; the instants inside a transaction are those of the next test but one."""
    kill_and_complete(new_history(backend, tmp_path), number)


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
