"""Analysis imu_strapdown: simulated logs with known drift, wrong rates, bursts, counts; other people's recordings."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spoken import english_left
from test_imu_logs import log
from test_rest_drift import GYRO_NOISE, RATE, TURNS, noisy, poses

from bench.analysis import Analysis, Material, with_uncertainty
from bench.analysis.doubt import weigh
from bench.model.errors import FitError
from bench.systems.gnc.estimators.rest_drift import NAMES
from bench.systems.gnc.estimators.static_intervals import find_rests
from bench.systems.gnc.logs import strapdown as imu_strapdown

FOLDER = Path(os.environ.get("BENCH_REAL_DATA", Path(__file__).parents[5] / "shared" / "data"))
MANY: list[tuple[str, float]] = [*TURNS, ("z", -90.0), ("x", 120.0), ("y", 90.0), ("z", 80.0), ("x", -100.0)]


def turned_log(turns: list[tuple[str, float]] = TURNS, rest_s: float = 9.0, **more: Any) -> Material:
    """A unit turned from rest to rest: 0.03 deg/s and 10 mm/s^2 of scatter a sample, and a bias."""
    accel, gyro = noisy(*poses(turns, rest_s)[:2])
    t_s = np.arange(len(accel)) / RATE
    return log(accel, np.degrees(gyro) + np.array([0.4, -0.2, 0.1]), t_s, [], **more)


def value(analysis: Analysis, quantity: str, **conditions: Any) -> float:
    (found,) = [
        one
        for one in analysis.estimates
        if one["quantity"] == quantity and conditions.items() <= one["conditions"].items()
    ]
    return float(found["value"])


def code(material: Material, method: str = "indicated") -> str:
    with pytest.raises(FitError) as caught:
        imu_strapdown.analyse(material, method)
    return str(caught.value.code)


def test_a_turned_log_gives_drift_class_and_errors_between_rests() -> None:
    analysis = imu_strapdown.analyse(turned_log())
    assert analysis.missing == []
    assert english_left(analysis) == set()
    walk = np.degrees(GYRO_NOISE / np.sqrt(RATE))  # deg/sqrt(s)
    assert value(analysis, "angle_random_walk") == pytest.approx(60.0 * walk, rel=0.25)
    assert value(analysis, "rest_drift_attitude", horizon_s=3.0) == pytest.approx(walk * np.sqrt(6.0), rel=0.5)
    assert value(analysis, "level_error") < 0.1
    assert value(analysis, "velocity_error") < 0.1
    assert value(analysis, "turn_scale") == pytest.approx(1.0, abs=0.01)
    drift = next(one for one in analysis.estimates if one["quantity"] == "gyro_drift")
    assert drift["conditions"]["sensor_class"] in NAMES
    assert drift["conditions"]["horizon_s"] == 3.0  # no rest is longer than twice 10 s
    assert any("of such horizons" in one for one in analysis.notes)
    assert any("of the class industrial" in one for one in analysis.notes)  # 0.24 deg/sqrt(h)


def test_a_long_rest_gives_every_horizon_and_nothing_between() -> None:
    analysis = imu_strapdown.analyse(turned_log([], 200.0))
    horizons = [
        one["conditions"]["horizon_s"] for one in analysis.estimates if one["quantity"] == "rest_drift_horizontal"
    ]
    assert horizons == [3.0, 10.0, 30.0, 60.0]
    assert analysis.missing == []
    (table,) = (one for one in analysis.tables if one.title == "Class of the sensors")
    drift = next(one for one in analysis.estimates if one["quantity"] == "gyro_drift")
    (shown,) = (row[2] for row in table.rows if row[0] == "gyro drift")
    assert shown == with_uncertainty(drift["value"], drift["expanded_uncertainty"])
    assert {one["quantity"] for one in analysis.estimates}.isdisjoint({"level_error", "turn_scale"})


def test_a_single_turn_says_nothing_of_the_errors_between_rests() -> None:
    """With one degree of freedom an interval of 95 % is nine times the value: t / sqrt(2) for t = 12.706."""
    analysis = imu_strapdown.analyse(turned_log([("x", 90.0)]))
    (entry,) = [one for one in analysis.estimates if one["quantity"] == "level_error"]
    assert entry["expanded_uncertainty"] / entry["value"] == pytest.approx(12.706 / np.sqrt(2.0), rel=1e-4)
    doubts = {one.quantities: one.code for one in weigh(analysis.evidence).against}
    assert doubts == {("level_error",): "too_few_motions", ("velocity_error",): "too_few_motions"}
    assert weigh(imu_strapdown.analyse(turned_log()).evidence).against == []


def test_a_wrong_rate_is_refused_with_the_rate_that_fits() -> None:
    """Trap: a log of 50 Hz said to be of 100 Hz turns by half of each angle."""
    wrong = turned_log()
    wrong.series["t_s"] /= 2.0  # type: ignore[index]
    with pytest.raises(FitError, match=r"multiplied by 2 .*100 samples a second.*\(50 Hz would fit\)") as caught:
        imu_strapdown.analyse(wrong)
    assert caught.value.code == "B-FIT-142"


def test_stamps_in_bursts_are_told_and_change_nothing() -> None:
    even, bursty = turned_log(), turned_log()
    stamps = bursty.series["t_s"]
    stamps[:-1] = np.floor(stamps[:-1] * RATE / 10.0) * 10.0 / RATE
    analysis = imu_strapdown.analyse(bursty)
    assert any("come in bursts" in one for one in analysis.notes)
    assert not any("come in bursts" in one for one in imu_strapdown.analyse(even).notes)
    for quantity in ("level_error", "angle_random_walk"):
        assert value(analysis, quantity) == pytest.approx(value(imu_strapdown.analyse(even), quantity), rel=1e-3)


def test_nothing_is_integrated_across_a_gap() -> None:
    material = turned_log()
    begin = round(9.5 * RATE)  # in the middle of the first turn
    for name, column in material.series.items():
        material.series[name] = np.delete(column, slice(begin, begin + 40))  # type: ignore[index]
    analysis = imu_strapdown.analyse(material)
    (entry,) = [one for one in analysis.estimates if one["quantity"] == "level_error"]
    assert entry["n"] == len(TURNS) - 1
    assert entry["value"] < 0.1
    assert any("40 samples are missing in 1 gaps" in one for one in analysis.notes)


def test_raw_counts_are_fitted_first_without_a_rough_scale() -> None:
    accel, gyro = noisy(*poses(MANY, 9.0)[:2])
    t_s = np.arange(len(accel)) / RATE
    counts = log(accel * 414.0 + 33000.0, np.degrees(gyro) * 83.4 + 32700.0, t_s, [], counts=True, gravity=9.80620)
    analysis = imu_strapdown.analyse(counts)
    assert analysis.method == "calibrated"
    assert value(analysis, "angle_random_walk") == pytest.approx(
        60.0 * np.degrees(GYRO_NOISE / np.sqrt(RATE)), rel=0.25
    )
    assert value(analysis, "level_error") < 0.1
    in_units = imu_strapdown.analyse(turned_log(MANY, gravity=9.80620), "calibrated")
    for quantity in ("level_error", "gyro_drift"):
        assert value(analysis, quantity) == pytest.approx(value(in_units, quantity), rel=0.02)


def test_what_a_log_does_not_tell_is_missing_or_refused() -> None:
    short = imu_strapdown.analyse(turned_log(rest_s=4.0))
    assert any("B-FIT-140" in one for one in short.missing)
    assert value(short, "level_error") < 0.1
    assert code(turned_log(), "as read") == "B-FIT-004"
    assert code(turned_log([], 20.0), "calibrated") == "B-FIT-085"  # one pose
    no_gyro = log(*noisy(*poses(TURNS)[:2]), np.arange(10.0), [])
    no_gyro.campaign["columns"][:] = no_gyro.campaign["columns"][:3]  # type: ignore[index]
    no_gyro.series["t_s"] = np.arange(len(no_gyro.series["accel_x_m_s2"])) / RATE  # type: ignore[index]
    assert code(no_gyro) == "B-GNC-006"
    same = turned_log()
    same.series["t_s"][:] = 1.0
    assert code(same) == "B-GNC-006"


# What makers say of the sensors: VN-100 industrial, angle random walk 0.0035 deg/s/sqrt(Hz) = 0.21 deg/sqrt(h); the
# Xsens unit 0.05 deg/s/sqrt(Hz) = 3 deg/sqrt(h) at the most; the sensor of imucal is one for the body of a runner.
def real_log(name: str) -> Material:
    if name == "imucal":
        rows = np.loadtxt(FOLDER / "imucal/imucal_example_ferraris_session.csv", delimiter=",", skiprows=1)
        return log(rows[:, 4:], rows[:, 1:4], rows[:, 0] / 102.4, [], rate_Hz=102.4)
    if name == "imu_tk":
        accel, gyro = (np.loadtxt(FOLDER / f"imu_tk/xsens_{one}.mat") for one in ("acc", "gyro"))
        return log(accel[:, 1:], gyro[:, 1:], accel[:, 0], [], counts=True, gravity=9.81744)
    lines = (FOLDER / "vn100/F00379_B").read_text(encoding="ascii").splitlines()[1:]
    rows = np.array([[float(text) for text in line.split(",")[:-1]] for line in lines if line.count(",") == 29])
    return log(rows[:, 3:6], np.degrees(rows[:, 6:9]), np.arange(len(rows)) / 10.0, [], rate_Hz=10.0)


@pytest.mark.real
@pytest.mark.skipif(not (FOLDER / "vn100").exists(), reason=f"no recordings in {FOLDER}")
@pytest.mark.validates(
    "rests found and drift over rests, on three real recordings without any setting",
    against="the rests published with imu_tk (36 to 38); class and noise that the makers of the sensors state",
)
@pytest.mark.parametrize(
    ("name", "rests", "horizon_s", "worst", "walk"),
    [
        ("imucal", 13, 3.0, "consumer", (0.1, 0.5)),
        ("imu_tk", 38, 10.0, "consumer", (1.0, 3.0)),
        ("vn100", 23, 60.0, "industrial", (0.15, 0.27)),
    ],
)
def test_public_recordings_drift_within_the_class_of_their_sensor(
    name: str,
    rests: int,
    horizon_s: float,
    worst: str,
    walk: tuple[float, float],
    record_property: Callable[[str, object], None],
) -> None:
    """Nothing is set for a recording; the one known number of rests is 36 to 38 of imu_tk."""
    analysis = imu_strapdown.analyse(real_log(name))
    assert analysis.missing == []
    assert f"{rests} rests were found" in analysis.notes[0]
    rated = [one for one in analysis.estimates if "sensor_class" in one["conditions"]]
    assert len(rated) == 3
    for one in rated:
        assert NAMES.index(one["conditions"]["sensor_class"]) <= NAMES.index(worst)
        assert one["conditions"].get("horizon_s", horizon_s) == pytest.approx(horizon_s, abs=0.01)
    found = value(analysis, "angle_random_walk")
    record_property("obtained", f"{name}: {rests} rests, {found:.2f} deg/sqrt(h)")
    assert walk[0] < found < walk[1]


@pytest.mark.real
@pytest.mark.skipif(not (FOLDER / "imucal").exists(), reason=f"no recordings in {FOLDER}")
def test_a_public_recording_at_twice_its_rate_is_refused() -> None:
    material = real_log("imucal")
    material.series["t_s"] /= 2.0  # type: ignore[index]
    assert code(material) == "B-FIT-142"


@pytest.mark.real
@pytest.mark.skipif(not (FOLDER / "imucal").exists(), reason=f"no recordings in {FOLDER}")
def test_rests_of_a_public_recording_hold_what_its_authors_marked_as_rest() -> None:
    """The six positions that came with the recording: each lies in one rest that was found, but for half a window."""
    material = real_log("imucal")
    accel, gyro = (
        np.column_stack([material.series[f"{word}_{axis}_{unit}"] for axis in "xyz"])
        for word, unit in (("accel", "m_s2"), ("gyro", "deg_s"))
    )
    rests = find_rests(accel, gyro, 102.4, np.empty(0, np.int64))
    marked = json.loads((FOLDER / "imucal/imucal_example_ferraris_session_list.json").read_text(encoding="utf-8"))
    for name, span in marked.items():
        middle = (span["start"] + span["end"]) // 2
        inside = [k for k, (a, b) in enumerate(zip(rests.begin, rests.end, strict=True)) if a <= middle < b]
        assert len(inside) == (0 if name.endswith("rot") else 1), name
        for k in inside:
            assert rests.begin[k] <= span["start"] + 103
            assert rests.end[k] >= span["end"] - 103
