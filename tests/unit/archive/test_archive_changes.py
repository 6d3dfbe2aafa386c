"""What would change, counted by hand: changes in U, flips, certificates; and how rows of both sides meet."""

from __future__ import annotations

from typing import Any

import pytest

from bench.archive.changes import change_in_u, changes_of, is_changed, is_flip
from bench.archive.page import changes_html
from bench.archive.refit import rows_of
from bench.model.errors import InputError
from bench.store import StoredTrial, Trial, selection_of

NS = 10**9


def row(sha256: str, value: float | None, verdict: str = "pass", **changes: Any) -> dict[str, Any]:
    """An estimate released as 10 +- 2."""
    made = {
        "session_sha256": sha256, "uut_model": "NGU", "uut_serial": "1", "quantity": "dsf_n", "unit": "ppm",
        "conditions": {"channel": 1}, "value": value, "expanded_uncertainty": None if value is None else 2.0,
        "verdict": verdict, "quality": "sound", "method": "gls", "released_value": 10.0,
        "released_expanded_uncertainty": 2.0, "released_verdict": "pass", "released_quality": "sound",
        "released_method": "gls", "released_software": "bench 1", "code": "", "fault": "",
    }  # fmt: skip
    return made | changes


def certificate(number: str, sha256: str) -> dict[str, Any]:
    return {
        "number": number, "specimen": False, "customer": "A", "session": f"s-{sha256}", "issued": "2026-01-01",
        "uut_model": "NGU", "uut_serial": "1", "software": "bench 1", "method": "gls", "session_sha256": sha256,
        "replaced_by": [],
    }  # fmt: skip


def test_a_change_is_in_units_of_the_released_uncertainty() -> None:
    assert change_in_u(row("a", 13.0)) == 1.5
    assert change_in_u(row("a", None)) is None
    assert change_in_u(row("a", 13.0, released_expanded_uncertainty=None)) is None
    assert change_in_u(row("a", 13.0, released_expanded_uncertainty=0.0)) is None


def test_what_is_a_change_and_what_is_a_flip() -> None:
    assert not is_changed(row("a", 10.0 * (1 + 1e-12)))
    assert is_changed(row("a", 10.0 + 1e-7))
    assert is_changed(row("a", 10.0, expanded_uncertainty=2.1))
    assert is_changed(row("a", None))
    assert not is_changed(row("a", 0.0, released_value=0.0))
    assert not is_changed(row("a", 1e-12, released_value=0.0))  # far below its uncertainty
    assert is_flip(row("a", 10.0, "fail"))
    assert is_flip(row("a", 10.0, quality="doubtful"))
    assert is_flip(row("a", None, "", quality=""))  # gone
    assert not is_flip(row("a", 10.0, "fail", released_quality="", released_verdict=""))  # new
    assert not is_flip(row("a", None, "", quality="", code="B-FIT-009"))


def test_the_report_counts_what_it_should() -> None:
    rows = [
        row("a", 10.0),
        row("b", 13.0),
        row("b", 9.0, "fail", quantity="bias"),
        row("c", None, "", quality="", quantity="", code="B-PKG-005", fault="not installed", released_quality=""),
        row("d", 10.0),
    ]
    trial = Trial("t" * 16, "bench 2", "", {}, {}, 4)
    certificates = [certificate(f"N-{name}", name) for name in "abcd"]
    sessions = {name: {"session": f"s-{name}", "campaign": "scale_factor", "simulated": False} for name in "abcd"}
    report = changes_of(StoredTrial(trial, "done", "2026", rows, certificates), sessions, [])
    bias, dsf_n = report.quantities
    assert (dsf_n.compared, dsf_n.changed, dsf_n.above_one) == (3, 1, 1)
    assert dsf_n.percentiles == pytest.approx((0.0, 0.0, 0.0, 1.35, 1.5))  # linear between the ranks
    assert (bias.compared, bias.percentiles[2]) == (1, -0.5)
    assert [(flip.session, flip.quantity, flip.verdict) for flip in report.flips] == [("s-b", "bias", "fail")]
    assert [(entry.number, entry.code, entry.largest) for entry in report.certificates] == [
        ("N-c", "B-PKG-005", None),
        ("N-b", "", 1.5),
    ]
    assert report.failed == {"B-PKG-005": 1}
    page = changes_html(report)
    assert page == changes_html(report)
    assert page.index("N-c") < page.index("N-b")
    assert all(text in page for text in ("not installed", "decided by people", "+1.500", "bench 1 → bench 2"))
    assert "사람이 결정합니다" in changes_html(report, "ko")
    assert report.as_json()["certificates"][1]["released_software"] == "bench 1"


def results(*estimates: tuple[str, int, float], method: str = "gls") -> dict[str, Any]:
    entries = [
        {
            "quantity": quantity, "unit": "ppm", "value": value, "std_uncertainty": 1.0, "coverage_factor": 2.0,
            "expanded_uncertainty": 2.0, "n": 3, "verdict": "none", "quality": "sound",
            "conditions": {"channel": channel, "unit_temperature_degC": 23.0 + value},
        }
        for quantity, channel, value in estimates
    ]  # fmt: skip
    return {
        "session": "s", "method": method, "uut": {"model": "NGU", "serial": "1"}, "estimates": entries,
        "provenance": {"software": "bench 1", "session_sha256": "a"},
    }  # fmt: skip


def test_rows_meet_by_quantity_and_conditions_without_what_was_measured() -> None:
    released, now = results(("dsf_n", 1, 1.0), ("dsf_p", 1, 2.0)), results(("dsf_n", 2, 5.0), ("dsf_n", 1, 1.5))
    rows = list(rows_of(released, now, {"campaign": {}}))
    said = [(entry["quantity"], entry["conditions"], entry.get("released_value"), entry.get("value")) for entry in rows]
    assert said == [
        ("dsf_n", '{"channel": 1}', 1.0, 1.5),
        ("dsf_p", '{"channel": 1}', 2.0, None),
        ("dsf_n", '{"channel": 2}', None, 5.0),
    ]
    assert rows[1]["quality"] == rows[2]["released_quality"] == ""


def test_two_estimates_of_one_name_stay_two() -> None:
    twice = results(("dsf_n", 1, 1.0), ("dsf_n", 1, 2.0))
    assert [entry["value"] for entry in rows_of(twice, twice, {"campaign": {}})] == [1.0, 2.0]


def test_selections() -> None:
    selection = selection_of(["uut=U-1", "since=2001-01-01", "until=2001-01-31"])
    assert selection.uut == "U-1"
    assert selection.since_utc_ns == 978_307_200 * NS
    assert selection.until_utc_ns == (978_307_200 + 31 * 86_400) * NS  # that day is among them


@pytest.mark.parametrize("words", [["bench=1"], ["uut"], ["uut="], ["uut=1", "uut=2"], ["since=yesterday"]])
def test_what_selects_nothing_b_arc_001(words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        selection_of(words)
    assert caught.value.code == "B-ARC-001"
    assert caught.value.next_step
