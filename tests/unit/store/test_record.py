"""Calibrations enter the history once, in one transaction; a session of several units is a calibration of each."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import pytest
import store_sample
from sqlalchemy import func, select
from store_sample import BACKENDS, new_history

from bench.analysis import documents
from bench.model.clock import VirtualClock
from bench.store import (
    Filters,
    StoreError,
    approve,
    compare_unit,
    dues_of,
    list_calibrations,
    record_calibration,
    show_calibration,
)
from bench.store.contents import shared_components
from bench.store.database import reading
from bench.store.tables import estimates, parameters

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
