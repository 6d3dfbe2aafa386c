"""Certificates and benches by what all units do: one wrong certificate, one bench that is off, units that drift."""

from __future__ import annotations

import shutil
from datetime import date
from pathlib import Path

import charts_sample
import numpy as np
import pytest
from charts_sample import Documents
from store_database import new_history

from bench.store import Filters, StoreError
from bench.store.charts import chart_certificates, chart_station, freeze

SEED = 23
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
        history = charts_sample.unit(f"U{number}", days, SEED + number, gains, off, **more)
        for place, (_, manifest) in enumerate(history):
            manifest["station"] = f"bench_{1 + (place + number) % 2}"
        histories.append(history)
    return histories


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a history in which nothing is wrong."""
    url = new_history("sqlite", tmp_path_factory.mktemp("good"))
    charts_sample.written(url, *population())
    return url


def test_the_wrong_certificate_is_the_one_that_signals(tmp_path: Path) -> None:
    url = new_history("sqlite", tmp_path)
    charts_sample.written(url, *population(wrong_ppm=60.0))
    subject = chart_certificates(url, Filters())
    assert [series.parameter.quantity for series in subject.series] == ["dsf_n", "dsf_p"]
    for series in subject.series:
        assert [name.rsplit(" ", 1)[-1] for name in series.names] == [f"C-{year}" for year in range(YEARS)]
        (signal, place, change), *others = series.signals
        assert {at for _, at, _ in others} <= {YEARS - 2, YEARS - 1}  # its EWMA and CUSUM, and still a year later
        assert (signal.kind, place) == ("shewhart", YEARS - 2)
        assert change is not None
        assert abs(change.size - 60.0) < 35.0  # and what this certificate and those before it are off by chance
        assert series.scatter_std == pytest.approx(2.0, rel=0.25)


def test_certificates_that_hold_give_no_signal_and_simulated_units_stay_out(good: str, tmp_path: Path) -> None:
    url = new_history("sqlite", tmp_path)
    shutil.copy(good.removeprefix("sqlite:///"), tmp_path)
    simulated = charts_sample.unit("S1", np.arange(0.0, 1800.0, 100.0), 1, np.full(YEARS, 500.0), simulated=True)
    charts_sample.written(url, simulated)
    subject = chart_certificates(url, Filters(None, None, "dsf_n"))
    assert not any(series.signals for series in subject.series)
    assert not subject.simulated
    assert len(subject.shown) == 1
    assert "1 units that are only simulated are left out" in subject.notes


def test_one_unit_with_one_certificate_judges_nothing_and_says_so(tmp_path: Path) -> None:
    url = new_history("sqlite", tmp_path)
    charts_sample.written(url, population()[0][:2])
    subject = chart_certificates(url, Filters())
    assert not any(np.isfinite(series.score).any() for series in subject.series)
    assert "2 of 2 quantities judge no certificate" in subject.notes[-1]
    assert [entry["scatter_std"] for entry in subject.as_json()["series"]] == [None, None]


def test_a_bench_that_is_off_is_found_by_all_units_on_it(tmp_path: Path) -> None:
    url = new_history("sqlite", tmp_path)
    charts_sample.written(url, *population(bench_ppm=60.0))
    off, good = (chart_station(url, name, Filters(None, None, "dsf_n")) for name in ("bench_1", "bench_2"))
    assert off.shown[0].signals
    assert off.shown[0].first < len(off.shown[0].names)
    year = off.shown[0].t_year[off.shown[0].signals[0][1]] - off.shown[0].t_year[0]
    assert 3.4 < year < 5.0
    assert [series.parameter.quantity for series in off.series] == ["bias", "dsf_n", "dsf_p"]
    signs = {np.sign(signal.statistic) for signal, _, _ in off.shown[0].signals}
    assert signs == {1.0}
    change = off.shown[0].signals[0][2]
    assert change is not None
    assert abs(change.size - 60.0) < change.expanded
    assert good.shown[0].signals[0][0].statistic < 0.0  # two benches alone do not tell which of them is off


def test_benches_in_control_scatter_as_their_first_phase_did(good: str) -> None:
    """The scores themselves are counted in tests/unit/maths/control: here is one history of 95 of them."""
    subjects = [chart_station(good, name, Filters()) for name in ("bench_1", "bench_2")]
    scores = [series.score[series.first :] for subject in subjects for series in subject.series]
    assert [series.parameter.quantity for series in subjects[0].series] == ["bias", "dsf_n", "dsf_p"]
    assert abs(np.concatenate(scores).mean()) < 0.5
    assert 0.7 < np.concatenate(scores).std() < 1.5
    with pytest.raises(StoreError) as caught:
        chart_station(good, "bench_3", Filters())
    assert caught.value.code == "B-STORE-009"


def test_a_bench_with_few_calibrations_has_no_chart_unless_its_first_phase_is_stated(tmp_path: Path) -> None:
    url = new_history("sqlite", tmp_path)
    charts_sample.written(url, charts_sample.unit("A1", 30.0 * np.arange(20), SEED, np.zeros(2)))
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
