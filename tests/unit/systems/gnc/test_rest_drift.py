"""Rests, drift over them and between them: against closed forms, and motions made by scipy's rotations."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.model.errors import FitError
from bench.systems.gnc.estimators.between_rests import drift_between_rests, turn_scale
from bench.systems.gnc.estimators.clocks import sample_stamps
from bench.systems.gnc.estimators.rest_drift import (
    BEYOND,
    CLASSES,
    _rotation_vectors,
    class_of,
    drift_at_rest,
    level,
    random_walk,
    worst_class,
)
from bench.systems.gnc.estimators.static_intervals import StaticIntervals, find_rests

SEED = 812
RATE = 50.0
GYRO_NOISE = 5e-4  # rad/s a sample: 0.24 deg/sqrt(h)
NONE = np.empty(0, np.int64)
G = 9.80619776931  # normal gravity at 45 degrees, closed form of GRS 80 and WGS-84 alike to 1e-7: 9.8061977693
Turn = tuple[str, float]  # axis and degrees


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


TURNS: list[Turn] = [("x", 90.0), ("y", -90.0), ("z", 120.0), ("x", 75.0), ("y", 100.0), ("x", -90.0), ("y", 60.0)]


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
    (drift,) = drift_at_rest(accel, gyro, whole(len(t_s)), RATE, horizons_s=(horizon,))
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
    found = random_walk(gyro, whole(count), RATE)
    assert abs(found.value - walk) < 4.0 * found.std
    assert found.std < 0.05 * walk
    (drift,) = drift_at_rest(accel, gyro, whole(count), RATE, horizons_s=(3.0,))
    assert drift.windows == 150
    assert drift.attitude_rms_deg == pytest.approx(np.degrees(walk * np.sqrt(6.0)), rel=0.12)
    assert drift.white_deg == pytest.approx(np.degrees(walk * np.sqrt(6.0)), rel=0.05)
    assert drift.velocity_rms_m_s == pytest.approx(velocity_walk * np.sqrt(6.0), rel=0.15)


def test_the_turning_earth_is_no_drift() -> None:
    """A perfect unit that stands still reads the Earth's rate in its own axes; no azimuth is known of it."""
    force, _, _ = poses([])
    for azimuth in (0.0, 140.0):
        body = Rotation.from_matrix(level(force[0])).inv() * Rotation.from_euler("z", azimuth, degrees=True)
        earth = 7.292115e-5 * np.array([np.cos(np.radians(45.0)), 0.0, -np.sin(np.radians(45.0))])
        gyro = np.tile(body.apply(earth), (2000, 1))
        accel = np.tile(force[0], (2000, 1))
        (drift,) = drift_at_rest(accel, gyro, whole(2000), RATE, 45.0, (20.0,))
        assert drift.attitude_rms_deg < 1e-3  # 20 s of a horizontal rate whose azimuth is off turn the level by this
        assert drift.horizontal_rms_m < 0.02


def test_a_turn_without_errors_ends_level_and_at_rest() -> None:
    force, rate, begins = poses(TURNS)
    rests = StaticIntervals(np.array(begins), np.array(begins) + 300, 1.0, 1.0)
    between = drift_between_rests(force, rate, rests, RATE, NONE)
    assert between is not None
    assert len(between.rest) == len(TURNS)
    assert between.level_error_deg.max() < 0.02  # 15 deg/h of the Earth over 3 s, in the wrong axes
    assert between.velocity_rms_m_s < 0.02
    assert between.tilted_deg.max() > 80.0


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
    right = turn_scale(accel, np.degrees(gyro), rests, RATE)
    wrong = turn_scale(accel, np.degrees(gyro), rests, 2.0 * RATE)
    counts = turn_scale(accel, np.degrees(gyro) * 437.0, rests, RATE)
    assert right is not None
    assert wrong is not None
    assert counts is not None
    assert abs(right.scale - 1.0) < 0.01
    assert wrong.scale == pytest.approx(2.0 * right.scale, rel=1e-4)
    assert counts.scale == pytest.approx(right.scale / 437.0, rel=1e-4)
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


def test_rotation_vectors_of_turns_of_any_size() -> None:
    vectors = np.random.default_rng(SEED).normal(size=(20, 3))
    vectors *= np.linspace(0.0, 3.0, 20)[:, None] / np.linalg.norm(vectors, axis=1)[:, None]
    assert _rotation_vectors(Rotation.from_rotvec(vectors).as_matrix()) == pytest.approx(vectors, abs=1e-9)


@pytest.mark.parametrize(
    ("accel", "gyro", "why"),
    [
        (np.ones((500, 3)), np.ones((500, 3)), "does not change"),
        (np.zeros((20, 3)), np.zeros((20, 3)), "shorter than one window"),
    ],
)
def test_a_log_without_rest_is_refused(accel: np.ndarray, gyro: np.ndarray, why: str) -> None:
    with pytest.raises(FitError, match=why) as caught:
        find_rests(accel, gyro, RATE, NONE)
    assert caught.value.code == "B-FIT-084"


def test_a_rest_too_short_for_a_drift_is_refused() -> None:
    with pytest.raises(FitError, match=r"longest rest is 5 s long, 6 s are needed") as caught:
        drift_at_rest(np.ones((250, 3)), np.zeros((250, 3)), whole(250), RATE)
    assert caught.value.code == "B-FIT-140"


def test_stamps_even_with_gaps_and_in_bursts() -> None:
    even = np.arange(1000) / 102.4
    found = sample_stamps(even)
    assert (found.rate_Hz, found.missing, found.bursty) == (pytest.approx(102.4), 0, False)
    gaps = sample_stamps(np.delete(even, [200, 201, 700]))
    assert (gaps.breaks.tolist(), gaps.missing, gaps.bursty) == ([200, 698], 3, False)
    assert gaps.rate_Hz == pytest.approx(102.4)
    bursts = sample_stamps(np.ceil(np.arange(1000) / 8) * 8 / 102.4)
    assert bursts.bursty
    assert bursts.rate_Hz == pytest.approx(102.4, rel=0.01)
    assert not len(bursts.breaks)
    mean_s = np.ceil(999 / 8) * 8 / 102.4 / 999  # first stamp 0, then eight at a time
    due_s = np.abs(np.ceil(np.arange(1000) / 8) * 8 / 102.4 - mean_s * np.arange(1000)).max()
    assert bursts.worst_s == pytest.approx(due_s)


@pytest.mark.parametrize("stamps", [np.zeros(5), np.arange(2.0), np.empty(0)])
def test_stamps_that_tell_no_rate_are_refused(stamps: np.ndarray) -> None:
    with pytest.raises(FitError) as caught:
        sample_stamps(stamps)
    assert caught.value.code == "B-FIT-141"


def test_classes_stand_in_order_and_a_unit_is_its_worst_sensor() -> None:
    for better, worse in pairwise(CLASSES):
        assert better.gyro_deg_h < worse.gyro_deg_h
        assert better.walk_deg_rt_h < worse.walk_deg_rt_h
        assert better.accel_mg < worse.accel_mg
    published = {"navigation": (0.01, 0.002, 0.1), "tactical": (10.0, 0.05, 5.0), "consumer": (360.0, 5.0, 1000.0)}
    bounds = {one.name: (one.gyro_deg_h, one.walk_deg_rt_h, one.accel_mg) for one in CLASSES}
    assert {name: bounds[name] for name in published} == published  # deg/h (0.1 deg/s), deg/sqrt(h), mg
    assert [class_of("gyro_deg_h", value) for value in (0.01, 0.02, 10.0, 11.0, 100.0, 400.0)] == [
        "navigation", "tactical", "tactical", "industrial", "consumer", BEYOND,
    ]  # fmt: skip
    assert worst_class(["tactical", "consumer", "industrial"]) == "consumer"
