"""Angle random walk, quantisation, alignment time and the theory beside them."""

from __future__ import annotations

import allantools
import numpy as np
import pytest

from bench.model.errors import FitError
from bench.systems.lock_in.estimators.random_walk import (
    alignment_time_s,
    expected_random_walk,
    gyro_gain,
    lock_in_rate_deg_s,
    path_exponent,
    random_walk,
    shared_variance,
)

PERIOD_s = 1.0 / 400.0
MIL_deg = 0.05625
_RUNS = 24


def increments(walk_rad: float, quantum_rad: float, halves: int, seed: int) -> np.ndarray:
    """Both senses' mean of steps of a walk in half a period and of a white error of each latched phase."""
    rng = np.random.default_rng(seed)
    psi = np.concatenate(([0.0], np.cumsum(walk_rad * rng.standard_normal(halves))))
    step = np.diff(psi + quantum_rad * rng.standard_normal(psi.size))
    start = np.arange(0, halves - 2, 2)
    return (step[start] + step[start + 2]) / 2.0 + step[start + 1]


@pytest.mark.parametrize(
    ("walk_rad", "quantum_rad", "bias", "scatter"),
    [(0.02, 0.0, 0.02, 0.03), (0.02, 0.02, 0.02, 0.04), (2e-3, 0.02, 0.04, 0.08)],
)
def test_walk_and_quantisation_are_told_apart(walk_rad: float, quantum_rad: float, bias: float, scatter: float) -> None:
    runs = [random_walk(increments(walk_rad, quantum_rad, 8_000, seed), PERIOD_s, 0.28) for seed in range(_RUNS)]
    truth = np.rad2deg(walk_rad * np.sqrt(2.0 / PERIOD_s) / gyro_gain(0.28)) * 60.0
    walks = np.array([run.n_deg_rth for run in runs]) / truth
    assert abs(walks.mean() - 1.0) < bias + 3.0 * scatter / np.sqrt(_RUNS)
    assert walks.std() < 1.8 * scatter
    stated = np.nanmean([run.n_std_deg_rth for run in runs]) / truth
    assert 0.5 * walks.std() < stated < 2.0 * walks.std()
    if quantum_rad > walk_rad:
        quanta = np.deg2rad([run.q_deg for run in runs]) * gyro_gain(0.28)
        assert quanta.mean() == pytest.approx(quantum_rad / np.sqrt(2.0), rel=0.03)  # a mean of two readings


def test_stated_uncertainties_and_limits_are_those_of_many_records() -> None:
    """60 records with a walk of half the quantisation: scores of one, 95 of 100 below the upper limit."""
    runs = [random_walk(increments(0.01, 0.02, 2_000, seed), PERIOD_s, 0.28) for seed in range(60)]
    walk_deg_rth = np.rad2deg(0.01 * np.sqrt(2.0 / PERIOD_s) / gyro_gain(0.28)) * 60.0
    quantum_deg = np.rad2deg(0.02 / np.sqrt(2.0) / gyro_gain(0.28))
    walks = np.array([(run.n_deg_rth - walk_deg_rth) / run.n_std_deg_rth for run in runs])
    quanta = np.array([(run.q_deg - quantum_deg) / run.q_std_deg for run in runs])
    assert 0.85 < walks.std() < 1.25
    assert 0.7 < np.nanstd(quanta) < 1.15
    assert abs(walks.mean()) < 0.35
    assert 0.9 <= np.mean([walk_deg_rth < run.n_upper_deg_rth for run in runs]) < 1.0


def test_a_walk_beside_hardly_any_quantisation_is_right_on_average() -> None:
    """Half of the records have a quantisation of 0; a walk fitted beside that 0 is low by 0.4 of its uncertainty."""
    runs = [random_walk(increments(0.02, 0.002, 2_000, seed), PERIOD_s, 0.28) for seed in range(150)]
    walk_deg_rth = np.rad2deg(0.02 * np.sqrt(2.0 / PERIOD_s) / gyro_gain(0.28)) * 60.0
    scores = np.array([(run.n_deg_rth - walk_deg_rth) / run.n_std_deg_rth for run in runs])
    assert 50 < sum(run.q_deg == 0.0 for run in runs) < 100
    assert abs(scores.mean()) < 0.25
    assert 0.88 < scores.std() < 1.12


def test_the_deviation_is_that_of_the_walk_and_not_of_its_smoothed_phases() -> None:
    """The mean of both senses would take 7.5 % off the variance at five periods."""
    runs = [random_walk(increments(0.02, 0.0, 4_000, seed), PERIOD_s, 0.28) for seed in range(24)]
    assert runs[0].tau_s[0] == pytest.approx(5.0 * PERIOD_s)
    walk_deg_h = np.rad2deg(0.02 * np.sqrt(2.0 / PERIOD_s) / gyro_gain(0.28)) * 3600.0
    found = np.mean([run.deviation_deg_h[0] ** 2 for run in runs])
    assert found == pytest.approx(walk_deg_h**2 / (5.0 * PERIOD_s), rel=0.04)


def test_the_curve_is_that_of_another_package() -> None:
    steps = increments(1e-3, 0.02, 8_000, 3)
    found = random_walk(steps, PERIOD_s, 0.28)
    angle_deg = np.rad2deg(np.concatenate(([0.0], np.cumsum(steps))) / gyro_gain(0.28))
    _, deviation, _, _ = allantools.oadev(angle_deg, rate=1.0 / PERIOD_s, data_type="phase", taus=found.tau_s)
    np.testing.assert_allclose(found.deviation_deg_h, deviation * 3600.0, rtol=2e-3)  # less the smoothing of the walk


@pytest.mark.parametrize("part", [0.0, 0.6, 1.0])
def test_walks_of_two_outputs_scatter_together_by_what_is_shared(part: float) -> None:
    """60 pairs of records, with the quantisation of one pick-off in both: the correlation of their squared walks."""
    walks, shared = [], []
    for seed in range(60):
        first, other = increments(0.02, 0.0, 4_000, seed), increments(0.02, 0.0, 4_000, 1000 + seed)
        same = increments(0.0, 0.02, 4_000, 2000 + seed)
        first, behind = first + same, part * first + np.sqrt(1.0 - part**2) * other + same
        walks.append([random_walk(each, PERIOD_s, 0.28).n_deg_rth ** 2 for each in (first, behind)])
        behind[7] = np.nan
        shared.append(shared_variance(first, behind))
    assert np.mean(shared) == pytest.approx(part**2, abs=0.03)
    assert np.corrcoef(np.transpose(walks))[0, 1] == pytest.approx(part**2, abs=0.4)


def test_a_gap_shifts_nothing() -> None:
    steps = increments(0.02, 0.0, 8_000, 5)
    whole = random_walk(steps, PERIOD_s, 0.28)
    torn = steps + 4e-3  # a rate besides
    torn[2_000] = np.nan
    found = random_walk(torn, PERIOD_s, 0.28)
    assert found.n_deg_rth == pytest.approx(whole.n_deg_rth, rel=0.03)


def test_too_short() -> None:
    with pytest.raises(FitError, match="averaging times") as caught:
        random_walk(np.zeros(150), PERIOD_s, 0.28)
    assert caught.value.code == "B-FIT-099"


def test_published_figures() -> None:
    """Paper: 0.005 deg/rt-h, 1 mil, 10 min; half the path, 5.7 times the walk."""
    error_deg = np.rad2deg(1.04e-3 * 0.982)  # 1.04 NATO mil at latitude 37 deg
    assert alignment_time_s(0.005, 37.0, error_deg) == pytest.approx(600.0, rel=0.01)
    per_s = 0.003 / 60.0 / (7.2921151e-5 * np.cos(np.deg2rad(37.0)) * MIL_deg)  # earth rate in rad/s
    assert alignment_time_s(0.003, 37.0, MIL_deg) == pytest.approx(per_s**2, rel=1e-6)
    short, long = expected_random_walk(0.2, 100.0, 0.14), expected_random_walk(0.05, 100.0, 0.28)
    assert short / long == pytest.approx(5.66, abs=0.01)
    assert long == pytest.approx(2.724e-3, rel=1e-3)


def test_gain_and_lock_in_rate() -> None:
    """28 cm: 1.865 seconds of arc in a fringe of 2 pi."""
    assert np.rad2deg(2.0 * np.pi / gyro_gain(0.28)) * 3600.0 == pytest.approx(1.865, abs=1e-3)
    assert lock_in_rate_deg_s(gyro_gain(0.28) * np.deg2rad(0.05), 0.28) == pytest.approx(0.05)


def test_path_exponent() -> None:
    path_m = np.array([0.15, 0.28, 0.34])
    exponent, std = path_exponent(path_m, 3e-4 * path_m**-2.5, 0.02 * 3e-4 * path_m**-2.5)
    assert exponent == pytest.approx(-2.5)
    x = np.log(path_m)
    assert std == pytest.approx(0.02 / np.sqrt(((x - x.mean()) ** 2).sum()))


def test_path_exponent_of_walks_known_unlike_well() -> None:
    """Against numpy's weighted line; the middle one is off the power law and hardly counts."""
    path_m, off = np.array([0.15, 0.28, 0.34]), np.array([1.0, 1.3, 1.0])
    walk = 3e-4 * path_m**-2.5 * off
    std = np.array([0.01, 0.5, 0.02]) * walk
    line, covariance = np.polyfit(np.log(path_m), np.log(walk), 1, w=walk / std, cov="unscaled")
    exponent, uncertainty = path_exponent(path_m, walk, std)
    assert exponent == pytest.approx(line[0], rel=1e-9)
    assert uncertainty == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-9)


@pytest.mark.parametrize(
    ("path_m", "std"), [([0.28, 0.28], [1e-5, 1e-5]), ([0.15, 0.28], [1e-5, np.nan])], ids=["one path", "unknown"]
)
def test_no_path_exponent(path_m: list[float], std: list[float]) -> None:
    with pytest.raises(FitError, match="path lengths") as caught:
        path_exponent(np.array(path_m), np.array([1e-3, 2e-3]), np.array(std))
    assert caught.value.code == "B-FIT-100"
