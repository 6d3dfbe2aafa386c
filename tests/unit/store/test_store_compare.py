"""Comparison of a unit's calibrations: drift found again, agreement, control, due dates, what stays out."""

import copy
import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import store_sample
from store_sample import BACKENDS, FACTOR, Drift, GAIN_ppm, OWN_ppm, new_history

from bench.store import Filters, StoreError, compare_pair, compare_unit, dues_of, export_history, record_calibration

SEED = 17
Documents = list[tuple[dict[str, Any], dict[str, Any]]]


@pytest.fixture(params=BACKENDS)
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return new_history(request.param, tmp_path)


def write(url: str, documents: Documents) -> Documents:
    for document, manifest in documents:
        record_calibration(url, document, manifest, None)
    return documents


def test_two_calibrations_with_and_without_the_same_certificate(url: str) -> None:
    documents = write(url, store_sample.calibrations(3, 200.0, SEED))
    names = [document["session"] for document, _ in documents]
    own, all_of_it = OWN_ppm, float(np.hypot(OWN_ppm, GAIN_ppm))
    for pair, single in (((0, 1), own), ((1, 2), all_of_it)):  # the certificate changes after a year
        found = compare_pair(url, names[pair[0]], names[pair[1]])
        assert found["sessions"] == [names[one] for one in pair]
        first = found["parameters"][0]
        values = [documents[one][0]["estimates"][0]["value"] for one in pair]
        assert first["quantity"] == "dsf_n"
        assert first["values"] == values
        assert first["change_expanded_uncertainty"] == pytest.approx(FACTOR * single * np.sqrt(2.0))
        assert first["en"] == pytest.approx((values[1] - values[0]) / (FACTOR * single * np.sqrt(2.0)))
        assert first["shared_standard"] is (single == own)
    backwards = compare_pair(url, names[1], names[0])["parameters"][0]
    assert backwards["en"] == pytest.approx(-compare_pair(url, names[0], names[1])["parameters"][0]["en"])


def test_the_labels_of_both_calibrations_say_what_they_share(url: str) -> None:
    """JCGM 100 equation (16): of 9.5 and 8 ppm in one error and 3 and -4 ppm in another, beside one of one alone."""
    documents = store_sample.calibrations(2, 200.0, SEED)
    parts = ({"gain": 9.5, "offset": 3.0, "own": 1.0}, {"gain": 8.0, "offset": -4.0})
    for (document, _), standards in zip(documents, parts, strict=True):
        document["estimates"][0]["common"] = {"standards": standards, "campaign": {"drift": 2.0}}
    names = [document["session"] for document, _ in write(url, documents)]
    first, second = compare_pair(url, *names)["parameters"][:2]
    variance = 2.0 * (OWN_ppm**2 + GAIN_ppm**2) - 2.0 * (9.5 * 8.0 - 3.0 * 4.0)
    assert first["change_expanded_uncertainty"] == pytest.approx(FACTOR * np.sqrt(variance))
    assert first["en"] == pytest.approx(first["change"] / first["change_expanded_uncertainty"])
    assert second["change_expanded_uncertainty"] == pytest.approx(FACTOR * OWN_ppm * np.sqrt(2.0))  # by the register


def test_what_cannot_be_compared(url: str) -> None:
    documents = write(url, store_sample.calibrations(2, 200.0, SEED))
    other = copy.deepcopy(documents[0][0]) | {"uut": {"model": "NGU", "serial": "B2"}}
    other["provenance"]["session_sha256"] = "e" * 64
    empty = store_sample.document("20260101T000000Z_scale_factor_38h_A1", "d" * 64, [])
    write(url, [(other, documents[0][1]), (empty, documents[0][1])])
    for wrong in ("e" * 12, empty["session"]):
        with pytest.raises(StoreError, match="B-STORE-011"):
            compare_pair(url, documents[1][0]["session"], wrong)
    with pytest.raises(StoreError, match=r"B-STORE-011: .*same calibration"):
        compare_pair(url, documents[1][0]["session"], documents[1][0]["provenance"]["session_sha256"])
    with pytest.raises(StoreError, match=r"B-STORE-009: .*say which.*Next: .*NGU B2"):
        compare_unit(url, Filters())


def test_a_jump_is_out_of_control(url: str) -> None:
    documents = store_sample.calibrations(20, 30.0, SEED)
    estimate = documents[11][0]["estimates"][2]
    estimate["value"] += 60.0 * OWN_ppm
    write(url, documents)
    comparison = compare_unit(url, Filters(None, None, "dsf_asymmetry"))
    flagged = [one for one in comparison.parameters if one.outside.size]
    place = {name: estimate["conditions"][name] for name in ("channel", "temperature_degC")}
    jumped = [one for one in flagged if place.items() <= one.parameter.conditions.items()]
    assert len(jumped) == 1
    shown = jumped[0].as_json(comparison.series)
    assert shown["out_of_control"] == [documents[11][0]["session"]]
    assert abs(shown["en_worst"]) > 10.0
    assert shown["reduced_chi2"] > 10.0
    assert len(flagged) < 6  # of 50


def test_few_calibrations_have_no_control_limits_and_one_has_no_drift(url: str) -> None:
    documents = write(url, store_sample.calibrations(1, 30.0, SEED))
    comparison = compare_unit(url, Filters())
    assert all(one.line is None and one.chart is None for one in comparison.parameters)
    (due,) = dues_of(comparison, 365)
    assert due.due_utc_ns - due.last_utc_ns == 365 * 86400 * 10**9
    assert due.governed_by == ""
    again = copy.deepcopy(documents[0][0])
    again["provenance"]["session_sha256"] = "c" * 64  # another seed of a simulated bench begins at the same time
    write(url, [(again, documents[0][1])])
    comparison = compare_unit(url, Filters())
    assert all(one.line is None and one.value.size == 2 for one in comparison.parameters)
    assert [one.as_json(comparison.series)["en"] for one in comparison.parameters] == [0.0] * 200


@pytest.mark.parametrize(("ppm_per_year", "most_days"), [(12.0, 365), (12.0, 3653), (150.0, 3653)])
def test_due_when_the_drift_reaches_the_stability_limit(tmp_path: Path, ppm_per_year: float, most_days: int) -> None:
    url = new_history("sqlite", tmp_path)
    write(url, store_sample.calibrations(16, 90.0, SEED, Drift(dsf_ppm=ppm_per_year)))
    (due,) = dues_of(compare_unit(url, Filters()), most_days)
    days = (due.due_utc_ns - due.last_utc_ns) / 86400e9
    # gyroscope channels have the narrower limit, 100 ppm; 20 ppm of it are uncertainty, a few more that of the rate
    latest, earliest = (100.0 - 20.0) / ppm_per_year * 365.25, (100.0 - 20.0) / (ppm_per_year + 8.0) * 365.25
    if latest > most_days:
        assert days == most_days
    else:
        assert 0.75 * earliest < days < latest
        assert due.governed_by.startswith(("dsf_n (channel", "dsf_p (channel"))


@pytest.mark.parametrize(("jump_ppm", "days"), [(0.0, 365), (60.0, 0)])
def test_a_check_within_the_week_makes_a_unit_due_only_by_a_drift(url: str, jump_ppm: float, days: int) -> None:
    """Of two calibrations 2 h apart the rate is hardly known; one that is not seen is not carried on for a year."""
    documents = store_sample.calibrations(2, 2 / 24, SEED, Drift(dsf_ppm=0.0, bias_A=0.0))
    for estimate in documents[1][0]["estimates"]:
        estimate["value"] += jump_ppm if estimate["quantity"] == "dsf_n" else 0.0
    write(url, documents)
    (due,) = dues_of(compare_unit(url, Filters(None, None, "dsf_n")), 365)
    assert (due.due_utc_ns - due.last_utc_ns) / 86400e9 == days


def test_two_months_apart_the_uncertainty_of_the_rate_counts(url: str) -> None:
    """With another certificate each, 10.2 ppm: +-28 ppm in 60 days leave about 200 days of the 100 ppm."""
    write(url, store_sample.calibrations(2, 60.0, SEED, Drift(dsf_ppm=0.0, bias_A=0.0, certificate_days=30)))
    (due,) = dues_of(compare_unit(url, Filters(None, None, "dsf_n")), 365)
    assert 50 < (due.due_utc_ns - due.last_utc_ns) / 86400e9 < 215


def test_a_calibration_without_any_result_is_due_again_at_once(url: str) -> None:
    documents = store_sample.calibrations(3, 90.0, SEED)
    documents[2][0]["estimates"] = []
    write(url, documents)
    (due,) = dues_of(compare_unit(url, Filters()), 365)
    assert due.due_utc_ns == due.last_utc_ns
    assert due.governed_by == "the last calibration has no result"


def test_the_newest_revision_counts_and_simulated_ones_stand_apart(url: str) -> None:
    documents = write(url, store_sample.calibrations(3, 30.0, SEED))
    revised = copy.deepcopy(documents[2])
    revised[0]["estimates"][0]["value"] = 1.0
    simulated = copy.deepcopy(documents[1])
    simulated[0]["provenance"] |= {"simulated": True, "session_sha256": "b" * 64}
    simulated[0]["estimates"][0]["value"] = 2.0
    write(url, [revised, simulated])
    comparison = compare_unit(url, Filters(None, None, "dsf_n"))
    assert [row["revision"] for row in comparison.series.calibrations] == [1, 1, 2]
    assert comparison.parameters[0].value[-1] == 1.0
    assert 2.0 not in comparison.parameters[0].value
    assert comparison.series.notes == ["1 simulated calibrations of this unit are left out"]


def test_a_parameter_that_some_calibrations_do_not_have(url: str) -> None:
    documents = store_sample.calibrations(4, 30.0, SEED)
    del documents[1][0]["estimates"][0], documents[3][0]["estimates"][3]
    documents[2][0]["estimates"][2] |= {"std_uncertainty": 0.0, "expanded_uncertainty": 0.0}
    write(url, documents)
    comparison = compare_unit(url, Filters())
    rows = {one.parameter.label: one for one in comparison.parameters}
    place = "(channel 1, -10 degC)"
    assert rows[f"dsf_n {place}"].rows.tolist() == [0, 2, 3]
    assert rows[f"bias {place}"].rows.tolist() == [0, 1, 2]
    assert rows[f"dsf_asymmetry {place}"].line is None  # one states no uncertainty: no weight, no line
    assert rows[f"dsf_p {place}"].line is not None
    assert dues_of(comparison, 365)[0].calibrations == 4


def test_limits_on_one_side_and_two_are_compared_and_exported(tmp_path: Path) -> None:
    """The limits of results.json come back: a number for both sides, ``limits`` for others."""
    url = new_history("sqlite", tmp_path)
    documents = store_sample.calibrations(2, 200.0, SEED)
    wanted = [(None, 500.0), (-200.0, None), (4.9, 5.1), (-2e-6, 2e-6)]
    for document, _ in documents:
        for place, (low, high) in enumerate(wanted[:3]):
            document["estimates"][place]["limits"] = {"low": low, "high": high}
        document["estimates"][3]["limit"] = 2e-6
    write(url, documents)
    comparison = compare_unit(url, Filters())
    told = {one.parameter.label: one.as_json(comparison.series) for one in comparison.parameters}
    place = "(channel 1, -10 degC)"
    for name, (low, high) in zip(("dsf_n", "dsf_p", "dsf_asymmetry", "bias"), wanted, strict=True):
        assert told[f"{name} {place}"]["limits"] == {"low": low, "high": high}
        assert told[f"{name} {place}"]["limit"] == (2e-6 if name == "bias" else None)
    path = tmp_path / "history.csv"
    export_history(url, Filters(), path)
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))[:5]
    assert [(row["limit"], row["low"], row["high"]) for row in rows] == [
        ("", "", "500.0"), ("", "-200.0", ""), ("", "4.9", "5.1"), ("2e-06", "-2e-06", "2e-06"), ("", "", ""),
    ]  # fmt: skip


def test_exports_hold_every_revision_exactly(url: str, tmp_path: Path) -> None:
    documents = write(url, store_sample.calibrations(2, 30.0, SEED))
    revised = copy.deepcopy(documents[1])
    revised[0]["estimates"][0]["value"] = 1 / 3
    write(url, [revised])
    path = tmp_path / "deep" / "history.csv"
    assert export_history(url, Filters(), path) == 600
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["newest"] for row in rows] == ["True"] * 200 + ["False"] * 200 + ["True"] * 200
    written = [one for document, _ in (*documents, revised) for one in document["estimates"]]
    for name in ("value", "std_uncertainty", "coverage_factor", "expanded_uncertainty"):
        assert [float(row[name]) for row in rows] == [one[name] for one in written]
    assert rows[0]["limit"] == ""
    assert (rows[0]["channel"], rows[0]["temperature_degC"]) == ("1", "-10.0")
    assert export_history(url, Filters(None, None, "bias"), path) == 150


def test_parquet_holds_the_same(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    url = new_history("sqlite", tmp_path)
    (document, _) = write(url, store_sample.calibrations(1, 30.0, SEED))[0]
    assert export_history(url, Filters(), tmp_path / "history.parquet") == 200
    rows = parquet.read_table(tmp_path / "history.parquet").to_pylist()
    assert [row["value"] for row in rows] == [one["value"] for one in document["estimates"]]
    assert rows[0]["limit"] is None
    assert rows[0]["channel"] == 1
