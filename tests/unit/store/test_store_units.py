"""A session of several units: each is entered under its own serial number."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import store_sample
from store_database import new_history

from bench.store import (
    Filters,
    StoreError,
    compare_unit,
    dues_of,
    list_calibrations,
    record_calibration,
    show_calibration,
)

SESSION = "20260401T080000Z_gnc_unit_test_BATCH-1"


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
def url(tmp_path: Path) -> str:
    found = new_history("sqlite", tmp_path)
    assert record_calibration(found, batch(), manifest(), "r").outcome == "new"
    return found


def test_each_unit_is_a_calibration_under_its_own_serial_number(url: str) -> None:
    rows = list_calibrations(url, Filters())
    assert [(row["session"], row["uut_serial"]) for row in rows] == [
        (f"{SESSION}:GNC-01", "GNC-01"),
        (f"{SESSION}:GNC-02", "GNC-02"),
    ]
    shown = show_calibration(url, f"{SESSION}:GNC-02")
    assert [(one["quantity"], one["conditions"], one["value"]) for one in shown.estimates] == [
        ("memory_wrong", {"source": "5 V"}, 2.0),
        ("ad_volts", {"source": "5 V"}, 7.0),
    ]


def test_the_session_of_several_units_is_named_with_the_choices(url: str) -> None:
    for name in (SESSION, "abababab"):
        with pytest.raises(StoreError, match=r"GNC-01.*GNC-02") as caught:
            show_calibration(url, name)
        assert caught.value.code == "B-STORE-009"


def test_the_same_session_changes_nothing_and_other_results_are_a_revision_of_that_unit(url: str) -> None:
    assert record_calibration(url, batch(), manifest(), "r").outcome == "unchanged"
    again = record_calibration(url, batch(wrong=1.0), manifest(), None)
    assert (again.outcome, again.revision) == ("revised", 2)
    assert [row["revision"] for row in list_calibrations(url, Filters())] == [1, 2]


def test_a_unit_is_compared_over_the_batches_it_was_in(url: str) -> None:
    later = batch("20270401T080000Z_gnc_unit_test_BATCH-7", "cd" * 32, wrong=0.0)
    record_calibration(url, later, manifest(), "r")
    found = {one.parameter.quantity: one.value.tolist() for one in compare_unit(url, Filters("GNC-02")).parameters}
    assert found == {"memory_wrong": [2.0, 0.0], "ad_volts": [7.0, 7.0]}


@pytest.mark.parametrize(("unit", "days"), [("GNC-01", 365), ("GNC-02", 0)])
def test_a_count_of_nothing_wrong_is_not_due_at_once(url: str, unit: str, days: int) -> None:
    (due,) = dues_of(compare_unit(url, Filters(unit)), 365)
    assert (due.due_utc_ns - due.last_utc_ns) // 86_400_000_000_000 == days


def test_estimates_that_name_no_unit_leave_the_session_whole(tmp_path: Path) -> None:
    url, document = new_history("sqlite", tmp_path), copy.deepcopy(batch())
    del document["estimates"][0]["conditions"]["unit"]
    record_calibration(url, document, manifest(), "r")
    assert [row["session"] for row in list_calibrations(url, Filters())] == [SESSION]
