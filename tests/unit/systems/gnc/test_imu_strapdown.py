"""Drift over rests and between them, against closed forms and scipy's rotations; analysis imu_strapdown."""

import json
import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from one_estimate import every, one, value
from scipy.spatial.transform import Rotation
from spoken import english_left
from test_imu_logs import log

from bench.analysis import Material, with_uncertainty
from bench.analysis.doubt import weigh
from bench.maths.stamps import sample_stamps
from bench.model.errors import FitError
from bench.systems.gnc.estimators import rest_drift
from bench.systems.gnc.estimators.between_rests import drift_between_rests, turn_scale
from bench.systems.gnc.estimators.static_intervals import StaticIntervals, find_rests
from bench.systems.gnc.logs import strapdown as imu_strapdown

FOLDER = Path(os.environ.get("BENCH_REAL_DATA", Path(__file__).parents[5] / "shared" / "data"))
Keep = Callable[[str, object], None]
SEED = 812
RATE = 50.0
GYRO_NOISE = 5e-4  # rad/s a sample: 0.24 deg/sqrt(h)
NONE = np.empty(0, np.int64)
G = 9.80619776931  # normal gravity at 45 degrees, closed form of GRS 80 and WGS-84 alike to 1e-7: 9.8061977693
Turn = tuple[str, float]  # axis and degrees
TURNS: list[Turn] = [("x", 90.0), ("y", -90.0), ("z", 120.0), ("x", 75.0), ("y", 100.0), ("x", -90.0), ("y", 60.0)]
MANY: list[Turn] = [*TURNS, ("z", -90.0), ("x", 120.0), ("y", 90.0), ("z", 80.0), ("x", -100.0)]


def whole(count: int) -> StaticIntervals:
    return StaticIntervals(np.array([0]), np.array([count]), 1.0, 1.0)


def poses(turns: list[Turn], rest_s: float = 6.0, turn_s: float = 3.0) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Exact specific force (m/s^2) and rate (rad/s) of a unit turned from rest to rest, mean over each interval."""
    still, moving = round(rest_s * RATE), round(turn_s * RATE)
    shape = np.diff(np.cumsum(np.sin(np.pi * np.linspace(0.0, 1.0, moving + 1)) ** 2))
    shape /= shape.sum()
    attitude, force, rate, begins = Rotation.from_euler("zyx", [20.0, 5.0, -8.0], degrees=True), [], [], [0]
    up = np.array([0.0, 0.0, G])
    for axis, angle in [*turns, ("x", 0.0)]:
        force.append(np.tile(attitude.inv().apply(up), (still, 1)))
        rate.append(np.zeros((still, 3)))
        if angle == 0.0:
            break
        turn = np.radians(angle) * np.eye(3)["xyz".index(axis)]
        middle = attitude * Rotation.from_rotvec((np.cumsum(shape) - shape / 2.0)[:, None] * turn)
        force.append(middle.inv().apply(up))
        rate.append(shape[:, None] * turn * RATE)
        attitude = attitude * Rotation.from_rotvec(turn)
        begins.append(begins[-1] + still + moving)
    return np.vstack(force), np.vstack(rate), begins


def noisy(force: np.ndarray, rate: np.ndarray, seed: int = SEED) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return force + rng.normal(0.0, 0.01, force.shape), rate + rng.normal(0.0, GYRO_NOISE, rate.shape)


def test_a_rate_that_ramps_drifts_by_the_closed_form() -> None:
    """Bias from the first T: its middle is 0.5 T away, so the angle is r T^2 and the distance g r T^4 / 8."""
    ramp, horizon = 1e-6, 10.0
    t_s = (np.arange(round(20 * RATE)) + 0.5) / RATE
    gyro = np.zeros((len(t_s), 3))
    gyro[:, 1] = 0.3 + ramp * t_s
    accel = np.tile([0.0, 0.0, -9.7], (len(t_s), 1))  # z down; the size of gravity comes from the rest
    (drift,) = rest_drift.drift_at_rest(accel, gyro, whole(len(t_s)), RATE, horizons_s=(horizon,))
    assert drift.windows == 1
    assert drift.attitude_deg[0] == pytest.approx([0.0, np.degrees(ramp * horizon**2), 0.0], abs=2e-6)
    distance = G * ramp * horizon**4 / 8.0
    assert np.hypot(*drift.position_m[0, :2]) == pytest.approx(distance, rel=3e-3)
    assert drift.horizontal_rms_m == pytest.approx(distance, rel=3e-3)
    assert np.hypot(*drift.velocity_m_s[0, :2]) == pytest.approx(5.0 / 12.0 * G * ramp * horizon**3, rel=3e-3)


def test_white_noise_drifts_as_theory_says() -> None:
    """Bias or level from T and drift over T: N sqrt(2 T) of attitude, K sqrt(2 T) of velocity, per axis."""
    rng = np.random.default_rng(SEED)
    walk, velocity_walk, count = 5e-5, 2e-3, round(900 * RATE)
    gyro = rng.normal([1e-3, -2e-3, 5e-4], walk * np.sqrt(RATE), (count, 3))
    accel = rng.normal([1.0, -2.0, 9.5], velocity_walk * np.sqrt(RATE), (count, 3))
    found = rest_drift.random_walk(gyro, whole(count), RATE)
    assert abs(found.value - walk) < 4.0 * found.std
    assert found.std < 0.05 * walk
    (drift,) = rest_drift.drift_at_rest(accel, gyro, whole(count), RATE, horizons_s=(3.0,))
    assert drift.windows == 150
    assert drift.attitude_rms_deg == pytest.approx(np.degrees(walk * np.sqrt(6.0)), rel=0.12)
    assert drift.white_deg == pytest.approx(np.degrees(walk * np.sqrt(6.0)), rel=0.05)
    assert drift.velocity_rms_m_s == pytest.approx(velocity_walk * np.sqrt(6.0), rel=0.15)
    with pytest.raises(FitError, match=r"B-FIT-140.*longest rest is 5 s long, 6 s are needed"):
        rest_drift.drift_at_rest(np.ones((250, 3)), np.zeros((250, 3)), whole(250), RATE)


def test_the_turning_earth_is_no_drift() -> None:
    """A perfect unit that stands still reads the Earth's rate in its own axes; no azimuth is known of it."""
    force, _, _ = poses([])
    for azimuth in (0.0, 140.0):
        body = Rotation.from_matrix(rest_drift.level(force[0])).inv() * Rotation.from_euler("z", azimuth, degrees=True)
        earth = 7.292115e-5 * np.array([np.cos(np.radians(45.0)), 0.0, -np.sin(np.radians(45.0))])
        gyro = np.tile(body.apply(earth), (2000, 1))
        accel = np.tile(force[0], (2000, 1))
        (drift,) = rest_drift.drift_at_rest(accel, gyro, whole(2000), RATE, 45.0, (20.0,))
        assert drift.attitude_rms_deg < 1e-3  # 20 s of a horizontal rate whose azimuth is off turn the level by this
        assert drift.horizontal_rms_m < 0.02


def test_a_turn_without_errors_ends_level_and_at_rest() -> None:
    force, rate, begins = poses(TURNS)
    rests = StaticIntervals(np.array(begins), np.array(begins) + 300, 1.0, 1.0)
    between = drift_between_rests(force, rate, rests, RATE, NONE)
    assert len(between.rest) == len(TURNS)
    assert between.level_error_deg.max() < 0.02  # 15 deg/h of the Earth over 3 s, in the wrong axes
    assert between.velocity_rms_m_s < 0.02
    assert between.tilted_deg.max() > 80.0
    vectors = np.random.default_rng(SEED).normal(size=(20, 3))
    vectors *= np.linspace(0.0, 3.0, 20)[:, None] / np.linalg.norm(vectors, axis=1)[:, None]
    assert rest_drift._rotation_vectors(Rotation.from_rotvec(vectors).as_matrix()) == pytest.approx(vectors, abs=1e-9)


def test_a_scale_error_of_a_gyro_is_the_level_error_it_makes() -> None:
    force, rate, begins = poses([("x", 90.0), ("y", 60.0)])
    rests = StaticIntervals(np.array(begins), np.array(begins) + 300, 1.0, 1.0)
    off = rate * [1.01, 1.0, 1.0]
    between = drift_between_rests(force, off, rests, RATE, NONE)
    assert between is not None
    axis = force[0] / np.linalg.norm(force[0])
    tipping = np.sqrt(1.0 - axis[0] ** 2)  # part of the turn about x that tips gravity
    assert between.level_error_deg[0] == pytest.approx(0.9 * tipping, abs=0.03)
    assert between.level_error_deg[1] < 0.03


def test_turns_tell_a_wrong_rate_and_the_scale_of_counts() -> None:
    accel, gyro = noisy(*poses(TURNS)[:2])
    rests = find_rests(accel, np.degrees(gyro), RATE, NONE)
    found = [turn_scale(accel, np.degrees(gyro) * unit, rests, rate) for unit, rate in
             ((1.0, RATE), (1.0, 2.0 * RATE), (437.0, RATE))]  # fmt: skip
    right, wrong, counts = (each.scale for each in found if each is not None)
    assert abs(right - 1.0) < 0.01
    assert (wrong, counts) == (pytest.approx(2.0 * right, rel=1e-4), pytest.approx(right / 437.0, rel=1e-4))
    assert turn_scale(accel[:900], gyro[:900], find_rests(accel[:900], gyro[:900], RATE, NONE), RATE) is None


def test_rests_are_found_whatever_unit_and_noise_the_log_has() -> None:
    force, rate, begins = poses(TURNS)
    accel, gyro = noisy(force, np.degrees(rate))
    rests = find_rests(accel, gyro, RATE, NONE)
    assert len(rests.begin) == len(begins)
    assert np.all(np.abs(rests.begin - begins) <= 55)  # a window of 2 s lies half outside
    assert np.all(np.abs(rests.end - np.array(begins) - 300) <= 55)
    counts = find_rests(accel * 417.0 + 32768.0, gyro * 83.0 + 32768.0, RATE, NONE, steady=np.inf)
    assert np.array_equal(counts.begin, rests.begin)
    rough = find_rests(force + 20.0 * (accel - force), np.degrees(rate) + 20.0 * (gyro - np.degrees(rate)), RATE, NONE)
    assert len(rough.begin) == len(begins)


def test_a_steady_turn_and_a_gap_are_no_rest() -> None:
    accel, gyro = noisy(*poses([]))
    accel, gyro = np.tile(accel, (4, 1)), np.degrees(np.tile(gyro, (4, 1)))
    gyro[600:1000, 2] += 10.0  # as quiet as rest
    rests = find_rests(accel, gyro, RATE, NONE)
    assert [(int(a), int(b)) for a, b in zip(rests.begin, rests.end, strict=True)] == [(50, 550), (1050, 1150)]
    cut = find_rests(accel, gyro, RATE, np.array([300]))
    assert cut.begin.tolist() == [50, 301, 1050]
    assert cut.end.tolist() == [300, 550, 1150]


@pytest.mark.parametrize("bias_deg_s", [-40.0, 4.0, 40.0])
def test_a_bias_of_any_size_is_no_turn(bias_deg_s: float) -> None:
    force, rate, begins = poses(TURNS)
    accel, gyro = noisy(force, np.degrees(rate))
    sound = find_rests(accel, gyro, RATE, NONE)
    biased = find_rests(accel, gyro + bias_deg_s, RATE, NONE)
    assert len(begins) == len(sound.begin)
    assert np.array_equal(biased.begin, sound.begin)
    assert np.array_equal(biased.end, sound.end)


@pytest.mark.parametrize(
    ("accel", "gyro", "why"),
    [
        (np.ones((500, 3)), np.ones((500, 3)), "does not change"),
        (np.zeros((20, 3)), np.zeros((20, 3)), "shorter than one window"),
    ],
)
def test_a_log_without_rest_is_refused(accel: np.ndarray, gyro: np.ndarray, why: str) -> None:
    with pytest.raises(FitError, match=f"B-FIT-084.*{why}"):
        find_rests(accel, gyro, RATE, NONE)


def test_stamps_with_gaps_and_in_bursts() -> None:
    gaps = sample_stamps(np.delete(np.arange(1000) / 102.4, [200, 201, 700]))
    assert (gaps.breaks.tolist(), gaps.missing) == ([200, 698], 3)
    bursts = sample_stamps(np.ceil(np.arange(1000) / 8) * 8 / 102.4)
    assert not len(bursts.breaks)
    mean_s = np.ceil(999 / 8) * 8 / 102.4 / 999  # first stamp 0, then eight at a time
    due_s = np.abs(np.ceil(np.arange(1000) / 8) * 8 / 102.4 - mean_s * np.arange(1000)).max()
    assert bursts.worst_s == pytest.approx(due_s)
    for stamps in (np.zeros(5), np.arange(2.0), np.empty(0)):
        with pytest.raises(FitError, match="B-FIT-141"):
            sample_stamps(stamps)


def test_classes_stand_in_order_and_a_unit_is_its_worst_sensor() -> None:
    for better, worse in pairwise(rest_drift.CLASSES):
        assert better.gyro_deg_h < worse.gyro_deg_h
        assert better.walk_deg_rt_h < worse.walk_deg_rt_h
        assert better.accel_mg < worse.accel_mg
    published = {"navigation": (0.01, 0.002, 0.1), "tactical": (10.0, 0.05, 5.0), "consumer": (360.0, 5.0, 1000.0)}
    bounds = {one.name: (one.gyro_deg_h, one.walk_deg_rt_h, one.accel_mg) for one in rest_drift.CLASSES}
    assert {name: bounds[name] for name in published} == published  # deg/h (0.1 deg/s), deg/sqrt(h), mg
    assert [rest_drift.class_of("gyro_deg_h", value) for value in (0.01, 0.02, 10.0, 11.0, 100.0, 400.0)] == [
        "navigation", "tactical", "tactical", "industrial", "consumer", rest_drift.BEYOND,
    ]  # fmt: skip
    assert rest_drift.worst_class(["tactical", "consumer", "industrial"]) == "consumer"


def turned_log(turns: list[tuple[str, float]] = TURNS, rest_s: float = 9.0, **more: Any) -> Material:
    """A unit turned from rest to rest: 0.03 deg/s and 10 mm/s^2 of scatter a sample, and a bias."""
    accel, gyro = noisy(*poses(turns, rest_s)[:2])
    t_s = np.arange(len(accel)) / RATE
    return log(accel, np.degrees(gyro) + np.array([0.4, -0.2, 0.1]), t_s, [], **more)


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
    drift = one(analysis, "gyro_drift").conditions
    assert drift["sensor_class"] in rest_drift.NAMES
    assert drift["horizon_s"] == 3.0  # no rest is longer than twice 10 s
    for words in ("of such horizons", "of the class industrial"):  # 0.24 deg/sqrt(h)
        assert any(words in note for note in analysis.notes)


def test_a_long_rest_gives_every_horizon_and_nothing_between() -> None:
    analysis = imu_strapdown.analyse(turned_log([], 200.0))
    horizons = [entry.conditions["horizon_s"] for entry in every(analysis, "rest_drift_horizontal")]
    assert horizons == [3.0, 10.0, 30.0, 60.0]
    assert analysis.missing == []
    (table,) = (table for table in analysis.tables if table.title == "Class of the sensors")
    drift = one(analysis, "gyro_drift")
    (shown,) = (row[2] for row in table.rows if row[0] == "gyro drift")
    assert shown == with_uncertainty(drift.value, drift.expanded_uncertainty)
    assert every(analysis, "level_error") == every(analysis, "turn_scale") == []


def test_a_single_turn_says_nothing_of_the_errors_between_rests() -> None:
    """With one degree of freedom an interval of 95 % is nine times the value: t / sqrt(2) for t = 12.706."""
    analysis = imu_strapdown.analyse(turned_log([("x", 90.0)]))
    entry = one(analysis, "level_error")
    assert entry.expanded_uncertainty / entry.value == pytest.approx(12.706 / np.sqrt(2.0), rel=1e-4)
    doubts = {check.quantities: check.code for check in weigh(analysis.evidence).against}
    assert doubts == {("level_error",): "too_few_motions", ("velocity_error",): "too_few_motions"}
    assert weigh(imu_strapdown.analyse(turned_log()).evidence).against == []


def test_a_wrong_rate_is_refused_with_the_rate_that_fits() -> None:
    """Trap: a log of 50 Hz said to be of 100 Hz turns by half of each angle."""
    wrong = turned_log()
    wrong.series["t_s"] /= 2.0  # type: ignore[index]
    with pytest.raises(FitError, match=r"B-FIT-142.*multiplied by 2 .*100 samples a second.*\(50 Hz would fit\)"):
        imu_strapdown.analyse(wrong)


def test_stamps_in_bursts_are_told_and_change_nothing() -> None:
    even, bursty = turned_log(), turned_log()
    stamps = bursty.series["t_s"]
    stamps[:-1] = np.floor(stamps[:-1] * RATE / 10.0) * 10.0 / RATE
    analysis = imu_strapdown.analyse(bursty)
    assert any("come in bursts" in note for note in analysis.notes)
    assert not any("come in bursts" in note for note in imu_strapdown.analyse(even).notes)
    for quantity in ("level_error", "angle_random_walk"):
        assert value(analysis, quantity) == pytest.approx(value(imu_strapdown.analyse(even), quantity), rel=1e-3)


def test_nothing_is_integrated_across_a_gap() -> None:
    material = turned_log()
    begin = round(9.5 * RATE)  # in the middle of the first turn
    for name, column in material.series.items():
        material.series[name] = np.delete(column, slice(begin, begin + 40))  # type: ignore[index]
    analysis = imu_strapdown.analyse(material)
    entry = one(analysis, "level_error")
    assert entry.n == len(TURNS) - 1
    assert entry.value < 0.1
    assert any("40 samples are missing in 1 gaps" in note for note in analysis.notes)


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
    assert any("B-FIT-140" in note for note in short.missing)
    assert value(short, "level_error") < 0.1
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
    name: str, rests: int, horizon_s: float, worst: str, walk: tuple[float, float], record_property: Keep
) -> None:
    """Nothing is set for a recording; the one known number of rests is 36 to 38 of imu_tk."""
    analysis = imu_strapdown.analyse(real_log(name))
    assert analysis.missing == []
    assert f"{rests} rests were found" in analysis.notes[0]
    rated = [entry.conditions for entry in analysis.estimates if "sensor_class" in entry.conditions]
    assert len(rated) == 3
    for conditions in rated:
        assert rest_drift.NAMES.index(conditions["sensor_class"]) <= rest_drift.NAMES.index(worst)
        assert conditions.get("horizon_s", horizon_s) == pytest.approx(horizon_s, abs=0.01)
    found = value(analysis, "angle_random_walk")
    record_property("obtained", f"{name}: {rests} rests, {found:.2f} deg/sqrt(h)")
    assert walk[0] < found < walk[1]


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
