"""Charts of a unit: a step is found, an adjustment is none, later calibrations move nothing, people begin phases."""

from __future__ import annotations

import copy
from datetime import date
from pathlib import Path

import charts_sample
import numpy as np
import pytest
from charts_sample import Documents
from sqlalchemy import create_engine
from store_database import BACKENDS, new_history
from store_sample import OWN_ppm

from bench.store import Filters, StoreError, list_calibrations, record_calibration, show_calibration, state_calibration
from bench.store.charts import ChartedSubject, chart_unit, freeze

SEED = 23
DAYS = 30.0 * np.arange(22)
GAINS_ppm = np.array([3.0, -8.0])


@pytest.fixture
def url(tmp_path: Path) -> str:
    return new_history("sqlite", tmp_path)


@pytest.fixture(params=BACKENDS)
def any_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return new_history(request.param, tmp_path)


def stepped(size_ppm: float, at: int = 17) -> Documents:
    return charts_sample.unit("A1", DAYS, SEED, GAINS_ppm, np.where(np.arange(DAYS.size) >= at, size_ppm, 0.0))


def signalled(subject: ChartedSubject) -> set[str]:
    return {series.parameter.quantity for series in subject.series if series.signals}


def test_a_unit_in_control_gives_no_signal_and_a_new_certificate_none_either(url: str) -> None:
    charts_sample.written(url, stepped(0.0))
    subject = chart_unit(url, Filters())
    assert (subject.kind, subject.name, subject.simulated, subject.run_length) == ("unit", "NGU A1", False, 200.0)
    assert [series.parameter.quantity for series in subject.series] == ["dsf_n", "dsf_p", "bias"]
    assert {series.limits.run_length for series in subject.series} == {200.0 * 9}
    assert signalled(subject) == set()
    (bias,) = (series for series in subject.series if series.parameter.quantity == "bias")
    assert bias.first == 12
    assert bias.scatter_std == pytest.approx(2e-10, rel=0.6)


def test_a_step_is_signalled_with_date_and_size(url: str) -> None:
    ordered = charts_sample.written(url, stepped(40.0 * OWN_ppm))
    subject = chart_unit(url, Filters(None, None, "dsf_n"))
    assert len(subject.series) == 3
    assert [series.parameter.quantity for series in subject.shown] == ["dsf_n"]
    assert signalled(subject) == {"dsf_n", "dsf_p"}
    said = subject.shown[0].as_json()["signals"][0]
    assert said["name"] == said["since"] == ordered[17][0]["session"]
    assert abs(said["size"] - 40.0 * OWN_ppm) < said["size_expanded_uncertainty"] < 25.0


def test_later_calibrations_move_neither_limits_nor_points(url: str) -> None:
    history = stepped(0.0)
    charts_sample.written(url, history[:16])
    before = chart_unit(url, Filters())
    charts_sample.written(url, history[16:])
    after = chart_unit(url, Filters())
    for early, late in zip(before.series, after.series, strict=True):
        assert early.limits == late.limits
        np.testing.assert_allclose(late.score[2:16], early.score[2:], rtol=1e-7)
        assert late.score.size == 22


def test_an_adjustment_is_no_signal_and_its_calibrations_say_so(any_url: str) -> None:
    ordered = charts_sample.written(any_url, stepped(40.0 * OWN_ppm))
    found, left = (ordered[place][0]["session"] for place in (16, 17))
    assert signalled(chart_unit(any_url, Filters()))
    state_calibration(any_url, found, "as_found", "gain resistor", "A. Meyer")
    state_calibration(any_url, left, "as_left", "gain resistor", "A. Meyer")
    subject = chart_unit(any_url, Filters())
    assert signalled(subject) == set()
    assert all(np.isnan(series.score[17]) and np.isfinite(series.score[18]) for series in subject.series)
    assert [row["state"] for row in list_calibrations(any_url, Filters())][15:19] == [None, "as_found", "as_left", None]
    told = show_calibration(any_url, left).adjustment
    assert told is not None
    assert (told["state"], told["what"], told["stated_by"]) == ("as_left", "gain resistor", "A. Meyer")


def test_a_person_begins_a_phase_and_it_stays(any_url: str) -> None:
    charts_sample.written(any_url, stepped(40.0 * OWN_ppm, 10))
    with pytest.raises(StoreError, match="of at least 8") as caught:
        freeze(any_url, ("unit", "A1"), (date(2014, 5, 1), date(2014, 6, 30)), 100.0, "A. Meyer", "too short")
    assert caught.value.code == "B-STORE-041"
    done = freeze(any_url, ("unit", "A1"), (None, date(2015, 2, 20)), 100.0, "A. Meyer", "before the repair")
    assert done["calibrations"] == 10
    subject = chart_unit(any_url, Filters())
    assert subject.run_length == 100.0
    assert {series.first for series in subject.series} == {10}
    assert signalled(subject) == {"dsf_n", "dsf_p"}
    freeze(
        any_url, ("unit", None), (date(2015, 3, 1), date(2015, 11, 30)), 300.0, "B. Kim", "new phase after the repair"
    )
    later = chart_unit(any_url, Filters())
    assert later.phase is not None
    assert (later.phase["stated_by"], later.run_length) == ("B. Kim", 300.0)
    assert {(series.first, series.score.size) for series in later.series} == {(9, 12)}
    assert signalled(later) == set()


def test_what_is_no_first_phase(url: str) -> None:
    charts_sample.written(url, stepped(0.0))
    wrong = (
        ((None, date(2999, 1, 1)), 100.0, "A", "r", "not over"),
        ((date(2015, 1, 1), date(2014, 1, 1)), 100.0, "A", "r", "ends before"),
        ((None, date(2015, 1, 1)), 1.0, "A", "r", "run length"),
        ((None, date(2015, 1, 1)), 100.0, " ", "r", "nobody"),
    )
    for days, run_length, by, reason, said in wrong:
        with pytest.raises(StoreError, match=said) as caught:
            freeze(url, ("unit", "A1"), days, run_length, by, reason)
        assert caught.value.code == "B-STORE-041"
    with pytest.raises(StoreError) as caught:
        freeze(url, ("station", "bench_7"), (None, date(2015, 1, 1)), 100.0, "A", "r")
    assert caught.value.code == "B-STORE-009"


def test_doubtful_estimates_and_simulated_calibrations_never_enter(url: str) -> None:
    history = stepped(0.0)
    history[15][0]["estimates"][0] |= {"value": 1e6, "quality": "doubtful", "reasons": [], "verdict": "indeterminate"}
    simulated = [copy.deepcopy(entry) for entry in history[:3]]
    for document, _ in simulated:
        document["provenance"] |= {"simulated": True, "session_sha256": document["provenance"]["session_sha256"][::-1]}
        document["estimates"][2]["value"] = 1.0
    charts_sample.written(url, history, simulated)
    subject = chart_unit(url, Filters())
    sizes = {series.parameter.quantity: series.score.size for series in subject.series}
    assert sizes == {"dsf_n": 21, "dsf_p": 22, "bias": 22}
    assert signalled(subject) == set()
    assert any("simulated" in note for note in subject.notes)


def test_an_odd_calibration_in_the_first_phase_is_named(url: str) -> None:
    history = stepped(0.0)
    history[7][0]["estimates"][0]["value"] += 100.0 * OWN_ppm
    charts_sample.written(url, history)
    (note,) = chart_unit(url, Filters()).notes
    assert note.startswith(f"dsf_n (channel 1, 20 degC): {history[7][0]['session']} does not belong")


def test_a_history_of_the_version_before_is_brought_up_to_date(url: str) -> None:
    charts_sample.written(url, stepped(0.0)[:8])
    engine = create_engine(url)
    with engine.begin() as connection:
        for statement in ("DROP TABLE states", "DROP TABLE phases", "UPDATE history SET version = 2"):
            connection.exec_driver_sql(statement)
    engine.dispose()
    assert [row["state"] for row in list_calibrations(url, Filters())] == [None] * 8
    assert freeze(url, ("unit", None), (None, date(2015, 1, 1)), 50.0, "A. Meyer", "all of it")["calibrations"] == 8


def test_too_few_calibrations_have_no_chart_and_it_is_said(url: str) -> None:
    charts_sample.written(url, stepped(0.0)[:11])
    subject = chart_unit(url, Filters())
    assert subject.series == []
    assert "3 of 3 parameters have no chart" in subject.notes[-1]


def test_an_adjustment_needs_what_and_who(url: str) -> None:
    session = charts_sample.written(url, stepped(0.0)[:1])[0][0]["session"]
    for state, what, by in (("as_bought", "x", "A"), ("as_left", " ", "A"), ("as_left", "x", "")):
        with pytest.raises(StoreError) as caught:
            state_calibration(url, session, state, what, by)
        assert caught.value.code == "B-STORE-040"


def test_the_laboratory_states_it_with_the_session(url: str) -> None:
    document, manifest = stepped(0.0)[0]
    record_calibration(url, document, manifest, None, adjustment=("as_left", "gain resistor", "A. Meyer"))
    record_calibration(url, document, manifest, None, adjustment=("as_left", "gain resistor", "A. Meyer"))
    assert [row["state"] for row in list_calibrations(url, Filters())] == ["as_left"]
