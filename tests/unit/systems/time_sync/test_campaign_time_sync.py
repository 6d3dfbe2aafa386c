"""Time offset of two units from recordings of the direct simulation: value, interval, clocks of any epoch, losses."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from spoken import english_left
from time_sync_material import Pair

from bench.analysis import Analysis, analyse, with_uncertainty
from bench.analysis.doubt import stated, weigh
from bench.report.plots.graphs import analysis_pictures
from bench.systems.time_sync import analysis as time_sync_analysis
from bench.systems.time_sync import filtering as time_sync_filter
from bench.systems.time_sync import report as time_sync_tables
from bench.systems.time_sync.analysis import METHODS
from bench.systems.time_sync.filtering import COMPENSATED
from bench.systems.time_sync.records import Clocks, recording
from bench.systems.time_sync.samples import Prepared, prepared
from sim_instruments.worlds.time_sync.flight.imu import ImuErrors
from sim_instruments.worlds.time_sync.flight.path import FlightPath

TURN_s = 16.5


def short_turn() -> FlightPath:
    """A turn of 90 deg in 6 s, 5 s of straight flight on both sides."""
    return FlightPath(((0.0, 0.0, 0.0), (5.0, 0.0, 15.0), (11.0, 0.0, 0.0)), speed_m_s=100.0)


FILTERED: dict[Any, time_sync_filter.Filtered] = {}


@pytest.fixture(autouse=True)
def filtered_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was filtered once is not filtered again."""
    monkeypatch.setattr(time_sync_analysis, "filtered", remembered)


def remembered(ready: Prepared, clocks: Clocks, *rest: Any) -> time_sync_filter.Filtered:
    """Return what the filters give, from before if all that they look at is the same."""
    arrays = (ready.imu.t_s, ready.imu.dv, ready.imu.dtheta, ready.egi.t_s, ready.egi.p, ready.egi.v, ready.egi.C)
    difference = clocks.difference
    key = (*(column.tobytes() for column in arrays), clocks.coarse_s, difference.drift, difference.drift_std, *rest)
    if key not in FILTERED:
        FILTERED[key] = time_sync_filter.filtered(ready, clocks, *rest)
    return FILTERED[key]


def value(found: Analysis, quantity: str, **conditions: Any) -> dict[str, Any]:
    """The one estimate of a quantity with these conditions."""
    fits = [
        one
        for one in found.estimates
        if one["quantity"] == quantity and conditions.items() <= one["conditions"].items()
    ]
    assert len(fits) == 1, (quantity, conditions, fits)
    return fits[0]


def turn(**kinds: Any) -> Pair:
    """The short turn with other clocks or links."""
    return Pair(**({"path": short_turn(), "duration_s": TURN_s} | kinds))


@cache
def analysed(**kinds: Any) -> Analysis:
    """Result of one of these recordings."""
    return analyse(turn(**kinds).material())


def test_offset_clocks_and_verdicts() -> None:
    pair, found = turn(), analysed()
    for method in METHODS:
        one = value(found, "time_offset", method=method)
        assert abs(one["value"] - pair.offset_s) < 3.0 * one["std_uncertainty"]
        assert one["std_uncertainty"] < 2e-3
        assert one["conditions"]["observable"] is True
    stamps, drift = value(found, "time_offset_from_stamps"), value(found, "time_offset_drift")
    assert stamps["value"] == pytest.approx(pair.offset_s, abs=2e-4)  # latencies are as stated
    assert stamps["std_uncertainty"] == pytest.approx(np.sqrt(2.0) * 1e-3, rel=0.02)
    assert drift["value"] == pytest.approx(pair.drift_ppm, abs=3.0 * drift["std_uncertainty"])
    assert drift["std_uncertainty"] < 10.0
    rate = value(found, "clock_rate", link="imu")
    assert rate["value"] == pytest.approx(pair.imu_ppm, abs=3.0 * rate["std_uncertainty"])
    assert value(found, "stamps_difference")["verdict"] == "pass"
    assert value(found, "time_offset_uncertainty", method=METHODS[0])["limit"] == 2e-3
    assert value(found, "time_offset_uncertainty", method=METHODS[1])["verdict"] == "none"
    assert found.missing == []


@pytest.mark.parametrize("offset_s", [-0.0213, pytest.param(0.42, marks=pytest.mark.sweep)])
def test_sound_recording_gives_the_offset_to_a_tenth_of_a_millisecond(offset_s: float) -> None:
    """Without errors nothing but the arithmetic is left: geodesy, ticks, drift, filter; a fraction of a sample old."""
    found = analyse(turn(noise=False, tag_noise_s=0.0, offset_s=offset_s, poll_ns=0, jitter_s=1e-6).material())
    for method in METHODS:
        limit_s = 5e-5 if method == "augmented_tight" and offset_s > 0.1 else 1e-4
        assert value(found, "time_offset", method=method)["value"] == pytest.approx(offset_s, abs=limit_s)


def test_clocks_of_any_epoch() -> None:
    """One clock passes through 2^64, the other began a day before: the same offset, on top of the day."""
    day_s = 86_400.0
    found = analysed(first_tick=2**64 - 100_000_000, egi_epoch_s=day_s)
    near = value(analysed(), "time_offset", method="augmented_tight")
    far = value(found, "time_offset", method="augmented_tight")
    assert far["value"] - day_s == pytest.approx(near["value"], abs=1e-4)
    assert value(found, "time_offset_from_stamps")["value"] == pytest.approx(day_s + 0.0137, abs=2e-4)
    assert any("began" in note for note in found.notes)


def test_lost_frames_change_less_than_the_interval() -> None:
    whole, holed = (value(one, "time_offset", method=METHODS[0]) for one in (analysed(), analysed(loss=0.01)))
    assert holed["value"] != whole["value"]
    assert abs(holed["value"] - whole["value"]) < 0.25 * whole["expanded_uncertainty"]
    assert holed["dropped"] > 0


@pytest.mark.slow
def test_straight_flight_and_rest_are_no_result() -> None:
    """An offset that the motion does not show keeps the interval of what was assumed, and says so."""
    for manoeuvre, path in (("linear", FlightPath(((0.0, 0.0, 0.0),), speed_m_s=100.0)), ("stationary", None)):
        found = analyse(Pair(manoeuvre, path=path, duration_s=15.5).material())
        for method in METHODS:
            one = value(found, "time_offset", method=method)
            assert one["conditions"]["observable"] is False
            assert one["std_uncertainty"] >= 0.03
            assert value(found, "observability", method=method, of="variance of the offset")["value"] > 0.5
        assert value(found, "time_offset_uncertainty", method=METHODS[0])["verdict"] == "fail"
        assert not [one for one in found.estimates if one["quantity"] == "stamps_difference"]
        against = weigh(found.evidence).against
        stated_as = {one["conditions"]["method"]: stated(one, against) for one in offsets(found)}
        for method in METHODS:
            assert stated_as[method]["value"] is None
            assert [reason["code"] for reason in stated_as[method]["reasons"]] == ["not_observable"]
        assert found.tables[0].rows[0][1:] == ["not observable", "interval alone judged"]


def offsets(found: Analysis) -> list[Any]:
    """The time offset by every method."""
    return [one for one in found.estimates if one["quantity"] == "time_offset"]


def test_an_offset_that_the_motion_shows_is_stated() -> None:
    against = weigh(analysed().evidence).against
    assert [stated(one, against)["quality"] for one in offsets(analysed())] == ["sound", "sound"]
    assert analysed().tables[0].rows[0][2] == "judged"


def test_an_offset_that_the_motion_does_not_show_keeps_no_limit() -> None:
    wide = {"limits": {"time_offset_uncertainty": {"value": 1.0, "unit": "s"}}}
    path = FlightPath(((0.0, 0.0, 0.0),), speed_m_s=100.0)
    found = analyse(Pair("linear", path=path, duration_s=15.5).material(**wide))
    assert value(found, "time_offset_uncertainty", method=METHODS[0])["verdict"] == "none"
    assert found.tables[0].rows[0][1:] == ["not observable", "not judged"]


def test_a_steady_turn_from_begin_to_end_is_no_confident_result() -> None:
    """A late solution in it looks like another heading at the begin: whoever is sure of that one is sure of zero."""
    path = FlightPath(((-20.0, 0.0, 9.0),), speed_m_s=100.0)
    found = analyse(turn(path=path, duration_s=15.5).material())
    for method in METHODS:
        one = value(found, "time_offset", method=method)
        assert abs(one["value"] - 0.0137) < 2.0 * one["std_uncertainty"]
    assert value(found, "time_offset", method=METHODS[0])["conditions"]["observable"] is False


def test_table_says_the_interval_of_the_estimates() -> None:
    found = analysed()
    for method, row in zip(METHODS, found.tables[0].rows, strict=False):
        one = value(found, "time_offset", method=method)
        assert row[1] == with_uncertainty(1e3 * one["value"], 1e3 * one["expanded_uncertainty"])


@pytest.mark.parametrize("beforehand_s", [0.0, 86_400.0])
def test_shift_that_is_due_is_that_of_the_offset_left_in_the_tags(beforehand_s: float) -> None:
    """Clocks that began a day apart do not shift an image by the way of a day: that is out of the tags of both."""
    left = SimpleNamespace(offsets={COMPENSATED: SimpleNamespace(offset_s=beforehand_s + 0.01)}, shift_s=beforehand_s)
    image: Any = SimpleNamespace(compensated=[], plain=[], pulses=9000, speed_m_s=250.0, shifts_m=np.zeros(0))
    result: Any = SimpleNamespace(found=left, image=image, chosen=SimpleNamespace(offset_s=beforehand_s + 0.01))
    assert "-2.500 m" in time_sync_tables._image(image, result).caption


def test_joints_hold_no_frame_twice() -> None:
    for records in (1, 4):
        taken = recording(turn(records=records).material())
        assert np.array_equal(np.diff(taken.imu.counter), np.ones(len(taken.imu) - 1))
        assert np.array_equal(np.diff(taken.egi.counter), np.ones(len(taken.egi) - 1))


def test_lost_increments_are_filled_and_told() -> None:
    ready = prepared(recording(turn(loss=0.01).material()))
    sound = prepared(recording(turn().material()))
    assert ready.filled == np.count_nonzero(ready.imu.filled) == ready.lost_imu > 20
    assert ready.imu.t_s.size == sound.imu.t_s.size
    assert np.abs(ready.imu.t_s - sound.imu.t_s).max() < 2e-6
    assert np.abs(ready.imu.dtheta - sound.imu.dtheta).max() < 2e-4  # a sample of the turn's ramp


def test_without_latencies_the_stamps_tell_the_drift_only() -> None:
    material = turn().material(latency=None)
    found = analyse(material)
    assert not [one for one in found.estimates if one["quantity"] in ("time_offset_from_stamps", "stamps_difference")]
    assert value(found, "time_offset_drift")["n"] > 800
    assert any("No latencies are stated" in note for note in found.notes)


def test_a_wrong_latency_is_told() -> None:
    """The stamps know nothing of motion, the filter nothing of latencies: one of them is wrong."""
    found = analyse(turn().material(latency={"egi_s": 0.020, "imu_s": 0.0008, "std_s": 2e-4}))
    assert value(found, "stamps_difference")["value"] == pytest.approx(-0.012, abs=2e-3)
    assert value(found, "stamps_difference")["verdict"] == "fail"
    assert any("apart" in note for note in found.notes)


def test_the_same_recording_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_sync_analysis, "filtered", time_sync_filter.filtered)
    first, again = analysed(), analyse(turn().material())
    assert first.estimates == again.estimates
    assert first.tables == again.tables


def test_report_draws_everything() -> None:
    found = analysed()
    assert english_left(found) == set()
    pictures = analysis_pictures(found.figures)
    assert len(pictures) == 6
    assert all("nan" not in picture.svg.lower() for picture in pictures)
    assert found.tables[0].lead is True
    assert all(len(row) == len(table.headers) for table in found.tables for row in table.rows)


OFFSETS_s = (-0.02, 0.0, 0.01, 0.0137, 0.02, 0.03)


@pytest.mark.sweep
def test_offsets_are_recovered_and_intervals_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight seeds for each offset, other clocks each time: mean, RMS, and what the stated intervals of 95 % cover."""
    monkeypatch.setattr(time_sync_analysis, "filtered", time_sync_filter.filtered)
    within: dict[str, list[bool]] = {}
    for k, offset_s in enumerate(OFFSETS_s):
        off_s: dict[str, list[float]] = {method: [] for method in METHODS}
        for seed in range(2000 + 8 * k, 2008 + 8 * k):
            rng = np.random.default_rng(seed)
            pair = turn(offset_s=offset_s, drift_ppm=rng.uniform(-5, 5), imu_ppm=rng.uniform(-20, 20), seed=seed)
            found, errors = analyse(pair.material()), ImuErrors(seed, 0)
            due = [(value(found, "time_offset", method=method), offset_s) for method in METHODS]
            for method, (one, _) in zip(METHODS, due, strict=True):
                off_s[method].append(one["value"] - offset_s)
            due.append((value(found, "time_offset_from_stamps"), offset_s))
            due.append((value(found, "time_offset_drift"), pair.drift_ppm))
            for axis, accel, gyro in zip("xyz", errors.accel_bias / 9.80665e-6, errors.gyro_bias, strict=True):
                due.append((value(found, "accel_bias", axis=axis), accel))
                due.append((value(found, "gyro_bias", axis=axis), np.degrees(gyro) * 3600.0))
            for one, truth in due:
                inside = abs(one["value"] - truth) <= one["expanded_uncertainty"]
                within.setdefault(one["quantity"], []).append(inside)
        for method in METHODS:
            assert abs(np.mean(off_s[method])) < 5e-4
            assert np.sqrt(np.mean(np.square(off_s[method]))) < 1e-3
    assert {name: np.mean(found) for name, found in within.items() if np.mean(found) < 0.9} == {}
