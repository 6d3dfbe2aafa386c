"""Calibrations enter the history once, in one transaction; sessions of the archive are found in it."""

import copy
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import store_sample
from sqlalchemy import func, select
from store_sample import BACKENDS, new_history

from bench.analysis import documents
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
    approve,
    begin_trial,
    compare_unit,
    dependents,
    dues_of,
    enter_certificate,
    enter_sessions,
    enter_trial_rows,
    list_calibrations,
    list_sessions,
    places_known,
    read_trial,
    record_calibration,
    show_calibration,
)
from bench.store import database as opened
from bench.store.contents import shared_components
from bench.store.database import reading
from bench.store.tables import (
    archived_sessions,
    archived_standards,
    archived_units,
    estimates,
    parameters,
    trial_rows,
)

SEED = 3
AWKWARD = (0.1 + 0.2, 5e-324, -1.7976931348623157e308, 0.0, 1 / 3, 4.0000000000000001e-7, 2.0**-1074 * 3, 1e22)
SESSION = "20260401T080000Z_gnc_unit_test_BATCH-1"


@pytest.fixture(params=BACKENDS)
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return new_history(request.param, tmp_path)


def one() -> tuple[dict[str, Any], dict[str, Any]]:
    return store_sample.calibrations(1, 30.0, SEED)[0]


def code_of(caught: pytest.ExceptionInfo[StoreError]) -> str:
    assert str(caught.value).startswith(f"error {caught.value.code}: ")
    assert caught.value.next_step
    return caught.value.code


def test_every_number_comes_back_bit_by_bit(url: str) -> None:
    document, manifest = one()
    document["estimates"] = document["estimates"][: len(AWKWARD)]
    for estimate, value in zip(document["estimates"], AWKWARD, strict=True):
        estimate |= {"value": value, "std_uncertainty": abs(value), "conformance_probability": 0.975, "limit": 100.0}
    record_calibration(url, document, manifest, "r")
    shown = show_calibration(url, document["session"])
    assert documents(shown.estimates) == document["estimates"]
    for stored, value in zip(shown.estimates, AWKWARD, strict=True):
        assert stored.value.hex() == value.hex()
    assert shown.quality == document["quality"]
    assert shown.notes == document["notes"]
    assert shown.calibration["simulated"] is False
    assert shown.calibration["started_utc"] == "2014-05-13T16:53:20Z"
    assert shown.standards[0]["certificate"] == "C-0"


def test_the_same_session_again_changes_nothing(url: str) -> None:
    document, manifest = one()
    first = record_calibration(url, document, manifest, "r", clock=VirtualClock())
    before = show_calibration(url, document["session"])
    again = record_calibration(url, copy.deepcopy(document), manifest, "r")
    assert (first.outcome, again.outcome, again.revision) == ("new", "unchanged", 1)
    assert show_calibration(url, document["session"]) == before
    assert record_calibration(url, document, manifest, None).outcome == "unchanged"  # the report is not there any more


def test_other_results_and_other_reports_are_revisions_and_the_old_ones_stay(url: str) -> None:
    document, manifest = one()
    record_calibration(url, document, manifest, "r1")
    record_calibration(url, document, manifest, "r2")
    other = copy.deepcopy(document) | {"method": "paper"}
    other["estimates"][0]["value"] += 1.0
    record_calibration(url, other, manifest, "r2", reason="customer asked")
    assert record_calibration(url, document, manifest, "r2").revision == 4  # back to the first numbers
    shown = show_calibration(url, document["session"])
    assert documents(shown.estimates) == document["estimates"]
    assert [one["report_sha256"] for one in shown.revisions] == ["r1", "r2", "r2", "r2"]
    assert [one["method"] for one in shown.revisions] == ["gls", "gls", "paper", "gls"]
    reasons = [one["reason"] for one in shown.revisions]
    assert reasons[:3] == ["first results", "the report was written again", "customer asked"]
    with reading(url) as connection:
        assert connection.execute(select(func.count()).select_from(estimates)).scalar_one() == 2 * 200
        assert connection.execute(select(func.count()).select_from(parameters)).scalar_one() == 200
        old = select(estimates.c.value).where(estimates.c.position == 0).order_by(estimates.c.result_set_id)
        first = document["estimates"][0]["value"]
        assert connection.execute(old).scalars().all() == [first, first + 1.0]


def test_an_approval_belongs_to_one_revision(url: str) -> None:
    document, manifest = one()
    record_calibration(url, document, manifest, "r1")
    done = approve(url, document["session"][:-2] + "A1", " A. Meyer ", "released", "r1", clock=VirtualClock())
    assert (done.revision, done.report_sha256) == (1, "r1")
    assert list_calibrations(url, Filters())[0]["approved_by"] == ["A. Meyer"]
    record_calibration(url, document, manifest, "r2")
    assert list_calibrations(url, Filters())[0]["approved_by"] == []  # the new revision is not approved
    revisions = show_calibration(url, document["session"]).revisions
    expected = {"by": "A. Meyer", "statement": "released", "approved_utc": "2000-01-01T00:00:00Z"}
    assert revisions[0]["approvals"] == [expected]
    assert revisions[1]["approvals"] == []
    for by, statement, report in ((" ", "released", None), ("A. Meyer", "", None), ("A. Meyer", "released", "r1")):
        with pytest.raises(StoreError, match="B-STORE-010"):
            approve(url, document["session"], by, statement, report)


def test_sessions_are_found_by_name_and_by_hash_and_suggested(url: str) -> None:
    (first, manifest), (second, _) = store_sample.calibrations(2, 30.0, SEED)
    second["provenance"]["session_sha256"] = "abcdef" + "0" * 58
    for document in (first, second):
        record_calibration(url, document, manifest, None)
    assert show_calibration(url, "ABCDEF").calibration["session"] == second["session"]
    assert show_calibration(url, f"sessions/{first['session']}/").calibration["session"] == first["session"]
    with pytest.raises(StoreError) as caught:
        show_calibration(url, first["session"][:-1])
    assert code_of(caught) == "B-STORE-009"
    assert first["session"] in caught.value.next_step
    third = copy.deepcopy(first)
    third["provenance"]["session_sha256"] = "9" * 64  # a simulated bench gives one name to all its seeds
    record_calibration(url, third, manifest, None)
    with pytest.raises(StoreError, match=r"B-STORE-009: .*Next: .*999999"):
        show_calibration(url, first["session"])


def test_filters_leave_what_they_name(url: str) -> None:
    for document, manifest in store_sample.calibrations(3, 30.0, SEED):
        record_calibration(url, document, manifest, None)
    other = store_sample.document("20200101T000000Z_bias_B2", "f" * 64, [], campaign="bias_ramp")
    record_calibration(url, {**other, "uut": {"model": "NGU", "serial": "B2"}}, {"campaign": {}}, None)
    counts = [
        len(list_calibrations(url, filters))
        for filters in (Filters(), Filters("A1"), Filters("NGU A1"), Filters("NGU/B2"), Filters(None, "bias_ramp"),
                        Filters(None, None, "dsf_n"), Filters("B2", None, "dsf_n"))
    ]  # fmt: skip
    assert counts == [4, 3, 3, 1, 1, 3, 0]
    for wrong in (Filters("A2"), Filters(None, "scale"), Filters(None, None, "dsf_m")):
        with pytest.raises(StoreError, match="B-STORE-009"):
            list_calibrations(url, wrong)
    with pytest.raises(StoreError, match="dsf_n"):
        list_calibrations(url, Filters(None, None, "dsf_m"))


def test_documents_that_do_not_say_enough(url: str) -> None:
    document, manifest = one()
    for broken in ({**document, "session": "mine"}, {k: v for k, v in document.items() if k != "uut"}):
        with pytest.raises(StoreError, match="B-STORE-008"):
            record_calibration(url, broken, manifest, None)
    record_calibration(url, {**document, "session": "mine"}, manifest, None, started_utc_ns=0)
    assert show_calibration(url, "mine").calibration["started_utc"] == "1970-01-01T00:00:00Z"


def test_what_a_standard_shares_is_the_least_of_its_ranges() -> None:
    register = store_sample.standards("C-9")
    found = {one["quantity"]: one for one in shared_components(register, "scale_factor")}
    assert {name: one["std_uncertainty"] for name, one in found.items()} == {"dsf_n": 10.0, "dsf_p": 10.0}
    assert found["dsf_n"]["standard"] == "5720A 77 C-9"
    register["calibrator"]["traceability_relative"] = 3e-5  # 15 ppm standard
    assert shared_components(register, "scale_factor")[0]["std_uncertainty"] == pytest.approx(math.hypot(10.0, 15.0))
    assert shared_components(register, "bias_ramp") == []
    del register["calibrator"]["traceability_relative"]
    for line in register["calibrator"]["uncertainty"]:
        line |= {"certificate_U": 4e-5, "k": 2.0}  # 20 ppm of two ranges: their mean has 20 / sqrt(2)
    mean = shared_components(register, "scale_factor")[0]["std_uncertainty"]
    assert mean == pytest.approx(math.hypot(10.0, 20.0 / math.sqrt(2.0)))
    for line in register["calibrator"]["uncertainty"]:
        line |= {"common_with": "R 7"}
    assert shared_components(register, "scale_factor")[0]["std_uncertainty"] == pytest.approx(math.hypot(10.0, 20.0))
    generator = {"function_generator": {"model": "33250A", "serial": "1", "certificate": "F-1"}}
    (clock,) = shared_components(generator, "bias_ramp")
    assert clock["quantity"] == "master_clock_error"
    assert clock["std_uncertainty"] == pytest.approx(3.0 / math.sqrt(3.0))
    generator["function_generator"]["certificate"] = ""  # nobody knows whether it is the same
    assert shared_components(generator, "bias_ramp") == []


def estimate(quantity: str, value: float, unit: str, **more: Any) -> dict[str, Any]:
    return store_sample.estimate(quantity, "1", value, 0.0, {"unit": unit, "source": "5 V"}, **more)


def batch(session: str = SESSION, sha256: str = "ab" * 32, wrong: float = 2.0) -> dict[str, Any]:
    estimates = [
        estimate("memory_wrong", count, unit, limit=0.0, verdict="fail" if count else "pass")
        for unit, count in (("GNC-01", 0.0), ("GNC-02", wrong))
    ]
    estimates += [estimate("ad_volts", 5.0 + number, f"GNC-0{number}") for number in (1, 2)]
    uut = {"model": "GNC", "serial": "BATCH-1"}
    return store_sample.document(session, sha256, estimates, campaign="gnc_unit_test", uut=uut)


def manifest() -> dict[str, Any]:
    return store_sample.manifest() | {"campaign": {"analysis": "gnc_unit_test"}}


@pytest.fixture
def imported(tmp_path: Path) -> str:
    found = new_history("sqlite", tmp_path)
    assert record_calibration(found, batch(), manifest(), "r").outcome == "new"
    return found


def test_each_unit_is_a_calibration_under_its_own_serial_number(imported: str) -> None:
    rows = list_calibrations(imported, Filters())
    assert [(row["session"], row["uut_serial"]) for row in rows] == [
        (f"{SESSION}:GNC-01", "GNC-01"),
        (f"{SESSION}:GNC-02", "GNC-02"),
    ]
    shown = show_calibration(imported, f"{SESSION}:GNC-02")
    assert [(one.quantity, one.conditions, one.value) for one in shown.estimates] == [
        ("memory_wrong", {"source": "5 V"}, 2.0),
        ("ad_volts", {"source": "5 V"}, 7.0),
    ]


def test_the_session_of_several_units_is_named_with_the_choices(imported: str) -> None:
    for name in (SESSION, "abababab"):
        with pytest.raises(StoreError, match=r"B-STORE-009: .*GNC-01.*GNC-02"):
            show_calibration(imported, name)


def test_a_unit_is_compared_over_the_batches_it_was_in(imported: str) -> None:
    later = batch("20270401T080000Z_gnc_unit_test_BATCH-7", "cd" * 32, wrong=0.0)
    record_calibration(imported, later, manifest(), "r")
    found = {one.parameter.quantity: one.value.tolist() for one in compare_unit(imported, Filters("GNC-02")).parameters}
    assert found == {"memory_wrong": [2.0, 0.0], "ad_volts": [7.0, 7.0]}


@pytest.mark.parametrize(("unit", "days"), [("GNC-01", 365), ("GNC-02", 0)])
def test_a_count_of_nothing_wrong_is_not_due_at_once(imported: str, unit: str, days: int) -> None:
    (due,) = dues_of(compare_unit(imported, Filters(unit)), 365)
    assert (due.due_utc_ns - due.last_utc_ns) // 86_400_000_000_000 == days


def test_estimates_that_name_no_unit_leave_the_session_whole(tmp_path: Path) -> None:
    imported, document = new_history("sqlite", tmp_path), copy.deepcopy(batch())
    del document["estimates"][0]["conditions"]["unit"]
    record_calibration(imported, document, manifest(), "r")
    assert [row["session"] for row in list_calibrations(imported, Filters())] == [SESSION]


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
