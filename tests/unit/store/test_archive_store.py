"""The archive's tables: what is entered comes back, filters find it by indexes, an older history gets them."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import select
from store_sample import BACKENDS, calibrations, new_history

from bench.model.clock import NS, VirtualClock
from bench.store import (
    ArchivedSession,
    Filters,
    Issued,
    Selection,
    StoreError,
    Trial,
    Unit,
    UsedStandard,
    begin_trial,
    dependents,
    enter_certificate,
    enter_sessions,
    enter_trial_rows,
    list_calibrations,
    list_sessions,
    places_known,
    read_trial,
    record_calibration,
)
from bench.store import database as opened
from bench.store.tables import (
    ARCHIVE,
    archived_sessions,
    archived_standards,
    archived_units,
    certificates,
    trial_rows,
)

DAY_NS = 86_400 * NS
CLOCK = VirtualClock()


def session(number: int, **changes: object) -> ArchivedSession:
    """A session of a hundred units on ten benches, one a day."""
    made = ArchivedSession(
        location=f"/archive/{number:06d}",
        fingerprint=f"f{number}",
        bytes=1000,
        session=f"s{number:06d}",
        session_sha256=f"{number:064x}",
        campaign=("scale_factor", "bias_ramp")[number % 2],
        station=f"bench-{number % 10}",
        started_utc_ns=number * DAY_NS,
        frame_sha256="ab" * 32,
        software="bench 1",
        method="gls",
        verdict=("pass", "fail")[number % 3 == 0],
        quality="sound",
        units=(Unit("NGU", f"U-{number % 100}"), Unit("CS", f"CS-{number % 10}", check_standard=True)),
        standards=(UsedStandard("calibrator", "5720A", f"CAL-{number % 10}", f"C-{number % 10}-{number // 365}"),),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def issued(number: int, **changes: object) -> Issued:
    made = Issued(
        number=f"N-{number}", certificate_sha256=f"c{number}", session=f"s{number:06d}",
        session_sha256=f"{number:064x}", results_sha256="r", report_sha256=None, uut_model="NGU",
        uut_serial=f"U-{number % 100}", customer="A. Customer", issued="2026-01-01", specimen=False, replaces=None,
        software="bench 1", method="gls",
        standards=(UsedStandard("calibrator", "5720A", f"CAL-{number % 10}", f"C-{number % 10}-0"),),
    )  # fmt: skip
    return replace(made, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_is_entered_is_found_by_every_filter(backend: str, tmp_path: Path) -> None:
    url = new_history(backend, tmp_path)
    made = [session(number) for number in range(40)]
    enter_sessions(url, made, "test", CLOCK)
    assert {place: row["fingerprint"] for place, row in places_known(url).items()} == {
        each.location: each.fingerprint for each in made
    }
    for selection, rule in (
        (Selection(uut="U-7"), lambda n: n % 100 == 7),
        (Selection(uut="CS CS-3"), lambda n: n % 10 == 3),
        (Selection(campaign="bias_ramp", station="bench-1"), lambda n: n % 10 == 1),
        (Selection(verdict="fail", since_utc_ns=5 * DAY_NS, until_utc_ns=16 * DAY_NS), lambda n: n in (6, 9, 12, 15)),
        (Selection(standard="CAL-4"), lambda n: n % 10 == 4),
        (Selection(certificate="C-2-0"), lambda n: n % 10 == 2),
        (Selection(), lambda n: True),
    ):  # fmt: skip
        rows = list_sessions(url, selection)
        assert [row["session"] for row in rows] == [f"s{n:06d}" for n in range(40) if rule(n)]
    assert [unit["serial"] for unit in rows[1]["units"]] == ["U-1", "CS-1"]  # the unit under test first
    with pytest.raises(StoreError, match="B-STORE-009"):
        list_sessions(url, Selection(uut="U-77x"))
    assert list_sessions(url, Selection(uut="U-7", campaign="scale_factor")) == []


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_same_place_again_replaces_and_damage_keeps_what_is_known(backend: str, tmp_path: Path) -> None:
    url = new_history(backend, tmp_path)
    enter_sessions(url, [session(1)], "test", CLOCK)
    enter_sessions(url, [session(1, fingerprint="new", method="ols")], "test", CLOCK)
    enter_sessions(
        url, [ArchivedSession("/archive/000001", "bad", 5, "x", code="B-REC-011", fault="torn")], "test", CLOCK
    )
    (row,) = list_sessions(url, Selection())
    assert (row["code"], row["fault"], row["fingerprint"], row["bytes"]) == ("B-REC-011", "torn", "bad", 1000)
    assert (row["session"], row["method"], row["session_sha256"]) == ("s000001", "ols", f"{1:064x}")
    assert len(row["units"]) == 2
    enter_sessions(url, [session(1)], "test", CLOCK)  # mended
    assert [row["code"] for row in list_sessions(url, Selection())] == [""]


@pytest.mark.parametrize("backend", BACKENDS)
def test_where(backend: str, tmp_path: Path) -> None:
    url = new_history(backend, tmp_path)
    with pytest.raises(StoreError, match="no history yet"):
        enter_certificate(url, issued(3))
    enter_sessions(url, [session(number, certificates=(issued(number),)) for number in range(1, 12)], "test", CLOCK)
    enter_certificate(url, issued(500, replaces="N-3"), CLOCK)
    enter_certificate(url, issued(500, replaces="N-3"), CLOCK)  # known
    every = list(range(1, 12))
    for word, kind, sessions, numbers in (
        ("U-3", "unit", [3], [3]),
        ("CAL-2", "standard", [2], [2]),
        ("C-1-0", "certificate of a standard", [1, 11], [1, 11]),
        ("abab" * 3, "frame", every, every),
        ("bench 1", "software", every, [*every, 500]),
        ("N-3", "certificate", [], [3]),
    ):
        found = dependents(url, word)
        assert found.kinds == (kind,)
        assert [int(row["session"][1:]) for row in found.sessions] == sessions
        assert sorted(int(row["number"][2:]) for row in found.certificates) == numbers
    assert dependents(url, "N-3").certificates[0]["replaced_by"] == ["N-500"]
    with pytest.raises(StoreError, match="B-STORE-009"):
        dependents(url, "nothing")


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_trial_is_whole_and_never_doubled(backend: str, tmp_path: Path) -> None:
    url = new_history(backend, tmp_path)
    trial = Trial("0123456789abcdef", "bench 2", "", {"C": {"serial": "1"}}, {"uut": "U-1"}, 2)
    empty = {column.name: "" for column in trial_rows.c} | {"value": None, "expanded_uncertainty": None}
    empty |= {"released_value": None, "released_expanded_uncertainty": None}
    good = {
        **empty,
        "session_sha256": "a",
        "quantity": "dsf_n",
        "unit": "ppm",
        "conditions": '{"channel": 1}',
        "value": 1.5,
    }
    failed = {**empty, "session_sha256": "b", "quantity": "", "conditions": "", "code": "B-FIT-009"}
    for _ in range(2):
        begin_trial(url, trial, CLOCK)
        enter_trial_rows(url, trial, [[good, good]], last=False)
        assert read_trial(url, "0123").state == "running"
    enter_trial_rows(url, trial, [[failed]], last=True)
    stored = read_trial(url, trial.name)
    assert (stored.state, stored.trial) == ("done", trial)
    assert [row["code"] for row in stored.rows] == ["", "", "B-FIT-009"]
    assert (stored.rows[0]["value"], stored.rows[0]["conditions"]) == (1.5, {"channel": 1})
    with pytest.raises(StoreError, match="B-STORE-009"):
        read_trial(url, "ffff")


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_history_of_version_3_gets_the_tables(backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    url = new_history(backend, tmp_path)
    document, manifest = calibrations(1, 30.0, 1)[0]
    record_calibration(url, document, manifest, None)
    with opened.writing(url, "") as connection:  # as the release before left it
        for table in reversed(ARCHIVE):
            table.drop(connection)
        connection.exec_driver_sql("UPDATE history SET version = 3")
    assert places_known(url) == {}
    assert len(list_calibrations(url, Filters())) == 1
    with opened.reading(url) as connection:
        assert connection.execute(select(certificates)).all() == []


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_filter_reads_an_index_and_not_every_row(backend: str, tmp_path: Path) -> None:
    """What makes 100,000 sessions quick; the sweep measures it."""
    if backend == "postgresql":
        pytest.skip("its planner reads small tables whole; the sweep looks at large ones")
    url = new_history(backend, tmp_path)
    enter_sessions(url, [session(number) for number in range(3)], "test", CLOCK)
    with opened.reading(url) as connection:
        columns = archived_sessions.c
        query = select(columns.id).where(columns.campaign == "x", columns.station == "y", columns.verdict == "fail")
        text = str(query.compile(connection, compile_kwargs={"literal_binds": True}))
        plan = " ".join(str(row) for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {text}"))
    assert "USING COVERING INDEX archived_by_time" in plan or "USING INDEX archived_by_time" in plan


@pytest.mark.sweep
@pytest.mark.parametrize("backend", BACKENDS)
def test_three_filters_over_100_000_sessions_take_half_a_second(backend: str, tmp_path: Path) -> None:
    """The best of three, as the machine does other things too."""
    url = new_history(backend, tmp_path)
    for first in range(0, 100_000, 10_000):
        write_at_once(url, range(first, first + 10_000))
    for selection in (
        Selection(uut="U-31", campaign="bias_ramp", verdict="fail"),
        Selection(standard="CAL-3", since_utc_ns=1000 * DAY_NS, until_utc_ns=9000 * DAY_NS),
        Selection(campaign="bias_ramp", station="bench-3", certificate="C-3-20"),
    ):
        took_s, cpu_s = [], []
        for _ in range(3):
            began_s, began_cpu_s = time.perf_counter(), time.process_time()
            rows = list_sessions(url, selection)
            took_s.append(time.perf_counter() - began_s)
            cpu_s.append(time.process_time() - began_cpu_s)
            assert rows
        print(f"{backend}: {len(rows)} of 100,000 in {min(took_s):.3f} s, {min(cpu_s):.3f} s CPU here")
        assert min(took_s) < 0.5


def write_at_once(url: str, numbers: range) -> None:
    """Write sessions as ``enter_sessions`` does, many with each statement."""
    some = [(number + 1, session(number)) for number in numbers]
    with opened.writing(url, "test") as connection:
        rows = [{"id": key, **made.row, "verified_utc_ns": 0} for key, made in some]
        connection.execute(archived_sessions.insert(), rows)
        for table, part in ((archived_units, "units"), (archived_standards, "standards")):
            parts = [{"archived_id": key, **vars(entry)} for key, made in some for entry in getattr(made, part)]
            connection.execute(table.insert(), parts)
