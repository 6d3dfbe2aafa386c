"""Charts of units, certificates and benches: what signals and what does not; drift never across an adjustment."""

import copy
import math
import shutil
from datetime import date
from pathlib import Path

import numpy as np
import pytest
import store_sample
from report_sample import unsound
from store_sample import BACKENDS, Documents, OWN_ppm, new_history

from bench.maths.drift import NO_STANDARD, fit_drift_line
from bench.store import (
    Filters,
    StoreError,
    compare_pair,
    compare_unit,
    list_calibrations,
    places_known,
    record_calibration,
    show_calibration,
    state_calibration,
)
from bench.store.charts import ChartedSubject, chart_certificates, chart_station, chart_unit, freeze
from bench.store.database import writing
from bench.store.tables import ARCHIVE, STATED

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
    return store_sample.unit("A1", DAYS, SEED, GAINS_ppm, np.where(np.arange(DAYS.size) >= at, size_ppm, 0.0))


def signalled(subject: ChartedSubject) -> set[str]:
    return {series.parameter.quantity for series in subject.series if series.signals}


def test_a_unit_in_control_gives_no_signal_and_a_new_certificate_none_either(url: str) -> None:
    store_sample.written(url, stepped(0.0))
    subject = chart_unit(url, Filters())
    assert (subject.kind, subject.name, subject.simulated, subject.run_length) == ("unit", "NGU A1", False, 200.0)
    assert [series.parameter.quantity for series in subject.series] == ["dsf_n", "dsf_p", "bias"]
    assert {series.limits.run_length for series in subject.series} == {200.0 * 9}
    assert signalled(subject) == set()
    (bias,) = (series for series in subject.series if series.parameter.quantity == "bias")
    assert bias.first == 12
    assert bias.scatter_std == pytest.approx(2e-10, rel=0.6)


def test_a_step_is_signalled_with_date_and_size(url: str) -> None:
    ordered = store_sample.written(url, stepped(40.0 * OWN_ppm))
    subject = chart_unit(url, Filters(None, None, "dsf_n"))
    assert len(subject.series) == 3
    assert [series.parameter.quantity for series in subject.shown] == ["dsf_n"]
    assert signalled(subject) == {"dsf_n", "dsf_p"}
    said = subject.shown[0].as_json()["signals"][0]
    assert said["name"] == said["since"] == ordered[17][0]["session"]
    assert abs(said["size"] - 40.0 * OWN_ppm) < said["size_expanded_uncertainty"] < 25.0


def test_an_adjustment_is_no_signal_and_its_calibrations_say_so(any_url: str) -> None:
    ordered = store_sample.written(any_url, stepped(40.0 * OWN_ppm))
    found, left = (ordered[place][0]["session"] for place in (16, 17))
    assert signalled(chart_unit(any_url, Filters()))
    state_calibration(any_url, found, "as_found", "gain resistor", "A. Meyer")
    state_calibration(any_url, left, "as_left", "gain resistor", "A. Meyer")
    subject = chart_unit(any_url, Filters())
    assert signalled(subject) == set()
    assert all(np.isnan(series.score[17]) and np.isfinite(series.score[18]) for series in subject.series)
    assert [row["state"] for row in list_calibrations(any_url, Filters())][15:19] == [None, "as_found", "as_left", None]
    told = show_calibration(any_url, left).adjustment
    assert (told["state"], told["what"], told["stated_by"]) == ("as_left", "gain resistor", "A. Meyer")


def test_a_person_begins_a_phase_and_it_stays(any_url: str) -> None:
    store_sample.written(any_url, stepped(40.0 * OWN_ppm, 10))
    with pytest.raises(StoreError, match=r"B-STORE-041: .*of at least 8"):
        freeze(any_url, ("unit", "A1"), (date(2014, 5, 1), date(2014, 6, 30)), 100.0, "A. Meyer", "too short")
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
    assert (later.phase["stated_by"], later.run_length) == ("B. Kim", 300.0)
    assert {(series.first, series.score.size) for series in later.series} == {(9, 12)}
    assert signalled(later) == set()


def test_what_is_no_first_phase(url: str) -> None:
    store_sample.written(url, stepped(0.0))
    wrong = (
        ((None, date(2999, 1, 1)), 100.0, "A", "r", "not over"),
        ((date(2015, 1, 1), date(2014, 1, 1)), 100.0, "A", "r", "ends before"),
        ((None, date(2015, 1, 1)), 1.0, "A", "r", "run length"),
        ((None, date(2015, 1, 1)), 100.0, " ", "r", "nobody"),
    )
    for days, run_length, by, reason, said in wrong:
        with pytest.raises(StoreError, match=f"B-STORE-041: .*{said}"):
            freeze(url, ("unit", "A1"), days, run_length, by, reason)
    with pytest.raises(StoreError, match="B-STORE-009"):
        freeze(url, ("station", "bench_7"), (None, date(2015, 1, 1)), 100.0, "A", "r")


def test_doubtful_estimates_and_simulated_calibrations_never_enter(url: str) -> None:
    history = stepped(0.0)
    entry = history[15][0]["estimates"][0]
    entry |= unsound(entry) | {"value": 1e6}
    simulated = [copy.deepcopy(entry) for entry in history[:3]]
    for document, _ in simulated:
        document["provenance"] |= {"simulated": True, "session_sha256": document["provenance"]["session_sha256"][::-1]}
        document["estimates"][2]["value"] = 1.0
    store_sample.written(url, history, simulated)
    subject = chart_unit(url, Filters())
    sizes = {series.parameter.quantity: series.score.size for series in subject.series}
    assert sizes == {"dsf_n": 21, "dsf_p": 22, "bias": 22}
    assert signalled(subject) == set()
    assert any("simulated" in note for note in subject.notes)


def test_an_odd_calibration_in_the_first_phase_is_named(url: str) -> None:
    history = stepped(0.0)
    history[7][0]["estimates"][0]["value"] += 100.0 * OWN_ppm
    store_sample.written(url, history)
    (note,) = chart_unit(url, Filters()).notes
    assert note.startswith(f"dsf_n (channel 1, 20 degC): {history[7][0]['session']} does not belong")


def test_a_history_of_an_older_version_is_brought_up_to_date(any_url: str) -> None:
    url = any_url
    store_sample.written(url, stepped(0.0)[:8])
    with writing(url, "") as connection:
        for table in reversed((*STATED, *ARCHIVE)):
            table.drop(connection)
        connection.exec_driver_sql("UPDATE history SET version = 2")
    assert places_known(url) == {}
    assert [row["state"] for row in list_calibrations(url, Filters())] == [None] * 8
    assert freeze(url, ("unit", None), (None, date(2015, 1, 1)), 50.0, "A. Meyer", "all of it")["calibrations"] == 8


def test_too_few_calibrations_have_no_chart_and_it_is_said(url: str) -> None:
    store_sample.written(url, stepped(0.0)[:11])
    subject = chart_unit(url, Filters())
    assert subject.series == []
    assert "3 of 3 parameters have no chart" in subject.notes[-1]


def test_an_adjustment_needs_what_and_who_and_comes_with_its_session(url: str) -> None:
    session = store_sample.written(url, stepped(0.0)[:1])[0][0]["session"]
    for state, what, by in (("as_bought", "x", "A"), ("as_left", " ", "A"), ("as_left", "x", "")):
        with pytest.raises(StoreError, match="B-STORE-040"):
            state_calibration(url, session, state, what, by)
    document, manifest = stepped(0.0)[0]
    record_calibration(url, document, manifest, None, adjustment=("as_left", "gain resistor", "A. Meyer"))
    record_calibration(url, document, manifest, None, adjustment=("as_left", "gain resistor", "A. Meyer"))
    assert [row["state"] for row in list_calibrations(url, Filters())] == ["as_left"]


YEARS = 5


def population(wrong_ppm: float = 0.0, bench_ppm: float = 0.0, units: int = 8, **more: bool) -> list[Documents]:
    """Units on two benches by turns, over five years; the certificate of the last but one may be off, or a bench."""
    rng = np.random.default_rng(SEED)
    gains = rng.normal(0.0, 10.0, YEARS)
    gains[YEARS - 2] = wrong_ppm or gains[YEARS - 2]
    histories = []
    for number in range(units):
        days = np.sort(rng.uniform(0.0, 365.0 * YEARS, 10))
        off = np.where((days > 3.8 * 365.0) & (np.arange(10) % 2 == number % 2), bench_ppm, 0.0)
        history = store_sample.unit(f"U{number}", days, SEED + number, gains, off, **more)
        for place, (_, manifest) in enumerate(history):
            manifest["station"] = f"bench_{1 + (place + number) % 2}"
        histories.append(history)
    return histories


@pytest.fixture(scope="module")
def good_history(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a history in which nothing is wrong."""
    url = new_history("sqlite", tmp_path_factory.mktemp("good"))
    store_sample.written(url, *population())
    return url


def test_the_wrong_certificate_is_the_one_that_signals(url: str) -> None:
    store_sample.written(url, *population(wrong_ppm=60.0))
    subject = chart_certificates(url, Filters())
    assert [series.parameter.quantity for series in subject.series] == ["dsf_n", "dsf_p"]
    for series in subject.series:
        assert [name.rsplit(" ", 1)[-1] for name in series.names] == [f"C-{year}" for year in range(YEARS)]
        (signal, place, change), *others = series.signals
        assert {at for _, at, _ in others} <= {YEARS - 2, YEARS - 1}  # its EWMA and CUSUM, and still a year later
        assert (signal.kind, place) == ("shewhart", YEARS - 2)
        assert abs(change.size - 60.0) < 35.0  # and what this certificate and those before it are off by chance
        assert series.scatter_std == pytest.approx(2.0, rel=0.25)
    until = date(2019, 12, 31)
    for subject_of, count in ((("unit", "U3"), 10), (("station", "bench_1"), 40)):  # its own, and nobody else's
        assert freeze(url, subject_of, (None, until), 100.0, "A. Meyer", "all")["calibrations"] == count


def test_certificates_that_hold_and_simulated_units_give_no_signal(good_history: str, url: str, tmp_path: Path) -> None:
    shutil.copy(good_history.removeprefix("sqlite:///"), tmp_path)
    simulated = store_sample.unit("S1", np.arange(0.0, 1800.0, 100.0), 1, np.full(YEARS, 500.0), simulated=True)
    store_sample.written(url, simulated)
    subject = chart_certificates(url, Filters(None, None, "dsf_n"))
    assert not any(series.signals for series in subject.series)
    assert not subject.simulated
    assert len(subject.shown) == 1
    assert "1 units that are only simulated are left out" in subject.notes


def test_one_unit_with_one_certificate_judges_nothing_and_says_so(url: str) -> None:
    store_sample.written(url, population()[0][:2])
    subject = chart_certificates(url, Filters())
    assert not any(np.isfinite(series.score).any() for series in subject.series)
    assert "2 of 2 quantities judge no certificate" in subject.notes[-1]
    assert [entry["scatter_std"] for entry in subject.as_json()["series"]] == [None, None]


def test_a_bench_that_is_off_is_found_by_all_units_on_it(url: str) -> None:
    store_sample.written(url, *population(bench_ppm=60.0))
    off, good_history = (chart_station(url, name, Filters(None, None, "dsf_n")) for name in ("bench_1", "bench_2"))
    assert off.shown[0].signals
    assert off.shown[0].first < len(off.shown[0].names)
    year = off.shown[0].t_year[off.shown[0].signals[0][1]] - off.shown[0].t_year[0]
    assert 3.4 < year < 5.0
    assert [series.parameter.quantity for series in off.series] == ["bias", "dsf_n", "dsf_p"]
    signs = {np.sign(signal.statistic) for signal, _, _ in off.shown[0].signals}
    assert signs == {1.0}
    change = off.shown[0].signals[0][2]
    assert abs(change.size - 60.0) < change.expanded
    assert good_history.shown[0].signals[0][0].statistic < 0.0  # two benches alone do not tell which of them is off


def test_a_bench_with_few_calibrations_has_no_chart_unless_its_first_phase_is_stated(url: str) -> None:
    store_sample.written(url, store_sample.unit("A1", 30.0 * np.arange(20), SEED, np.zeros(2)))
    subject = chart_station(url, "bench_1", Filters())
    assert (subject.series, "3 of 3 quantities have no chart" in subject.notes[-1]) == ([], True)
    freeze(url, ("station", "bench_1"), (None, date(2015, 7, 1)), 50.0, "A. Meyer", "as good as new")
    subject = chart_station(url, "bench_1", Filters())
    assert (subject.run_length, {series.first for series in subject.series}) == (50.0, {14})
    assert not any(series.signals for series in subject.series)
    freeze(url, ("station", "bench_1"), (date(2014, 8, 1), date(2015, 10, 1)), 50.0, "A. Meyer", "after the repair")
    later = chart_station(url, "bench_1", Filters())
    assert {len(series.names) for series in subject.series} == {20}
    assert {len(series.names) for series in later.series} == {17}  # three were before August


def adjusted_history(url: str, states: dict[int, str], other: dict[int, str] | None = None) -> Documents:
    """Twelve calibrations each quarter, adjusted by 500 ppm before the seventh."""
    days = 91.0 * np.arange(12)
    steps = np.where(np.arange(12) >= 6, 500.0, 0.0)
    ordered = store_sample.written(url, store_sample.unit("A1", days, SEED, np.zeros(4), steps))
    if other is not None:
        second = store_sample.unit("A1", days + 1.0, SEED + 1, np.zeros(4), steps)
        for document, _ in second:
            document["campaign"] = "another"
        store_sample.written(url, second)
        for place, state in other.items():
            state_calibration(url, second[place][0]["session"], state, "gain", "A. Meyer")
    for place, state in states.items():
        state_calibration(url, ordered[place][0]["session"], state, "gain", "A. Meyer")
    return ordered


@pytest.mark.parametrize("states", [{5: "as_found", 6: "as_left"}, {5: "as_found"}, {6: "as_left"}])
def test_no_drift_and_no_agreement_across_an_adjustment(url: str, states: dict[int, str]) -> None:
    ordered = adjusted_history(url, states)
    comparison = compare_unit(url, Filters(None, None, "dsf_n"))
    assert comparison.series.level.tolist() == [0] * 6 + [1] * 6
    (parameter,) = comparison.parameters
    assert abs(parameter.line.rate) < 60.0  # 500 ppm within 91 days would be 2,000 a year
    assert np.isnan(parameter.en[[0, 6]]).all()
    assert np.nanmax(np.abs(parameter.en)) < 2.0
    assert parameter.line.mean == pytest.approx(parameter.value[6:].mean(), abs=25.0)
    pair = compare_pair(url, ordered[5][0]["session"], ordered[6][0]["session"])
    assert any("adjusted between them" in note for note in pair["notes"])


def test_two_campaigns_see_one_adjustment(url: str, tmp_path: Path) -> None:
    adjusted_history(url, {5: "as_found", 6: "as_left"}, {5: "as_found", 6: "as_left"})
    level = compare_unit(url, Filters()).series.level
    assert level.tolist() == [0] * 12 + [1] * 12
    again = new_history("sqlite", tmp_path / "again")
    adjusted_history(again, {4: "as_left", 8: "as_left"}, {4: "as_left"})
    assert compare_unit(again, Filters()).series.level.tolist() == [0] * 8 + [1] * 8 + [2] * 8


def test_a_unit_adjusted_between_any_two_has_no_drift(url: str) -> None:
    adjusted_history(url, dict.fromkeys(range(12), "as_left"))
    comparison = compare_unit(url, Filters(None, None, "bias"))
    assert comparison.parameters[0].line is None
    assert comparison.parameters[0].as_json(comparison.series)["change"] is None


def test_the_rate_of_two_levels_is_that_of_the_pooled_slopes() -> None:
    """Parallel lines, Draper and Smith, Applied Regression Analysis: slope = sum of Sxy / sum of Sxx within groups."""
    rng = np.random.default_rng(SEED)
    t, level = np.arange(10.0), (np.arange(10) >= 4).astype(np.int64)
    value = 3.0 * t + 100.0 * level + rng.normal(0.0, 0.1, 10)
    line = fit_drift_line(t, value, np.full(10, 0.1), np.zeros(10), np.full(10, NO_STANDARD), level)
    parts = [(t[level == label] - t[level == label].mean(), value[level == label]) for label in (0, 1)]
    squares = sum(float(at @ at) for at, _ in parts)
    assert line.rate == pytest.approx(sum(float(at @ y) for at, y in parts) / squares, rel=1e-9)
    factor = math.hypot(0.1, line.between_std)
    assert line.rate_std == pytest.approx(factor / math.sqrt(squares), rel=1e-6)
    assert line.dof == 7
