"""Calibration without a table: intervals at rest, norm of gravity, gyroscopes between rests."""

from collections.abc import Callable
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy import optimize
from scipy.spatial.transform import Rotation

from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError
from bench.systems.gnc.estimators.between_rests import fit_between_rests
from bench.systems.gnc.estimators.multi_position import fit_multi_position
from bench.systems.gnc.estimators.static_intervals import StaticIntervals, static_intervals

Keep = Callable[[str, object], None]
G = 9.80665
TRUE = np.array([[0.00241, 3e-5, -2e-5], [0.0, 0.00243, 4e-5], [0.0, 0.0, 0.0024]])
ZERO = np.array([33124.0, 33275.0, 32364.0])
UPPER = np.triu_indices(3)


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def poses(seed: int, count: int = 36, noise: float = 0.4) -> np.ndarray:
    """Mean outputs in counts of poses drawn over the sphere, with noise in counts."""
    rng = np.random.default_rng([51, seed])
    return G * directions(rng, count) @ np.linalg.inv(TRUE).T + ZERO + rng.normal(size=(count, 3)) * noise


@pytest.mark.validates(
    "multi-position accelerometer fit: 95 % intervals of the nine parameters",
    against="the simulated truth of 500 units, 36 poses drawn over the sphere",
)
def test_intervals_cover(record_property: Keep) -> None:
    inside, truth = [], np.concatenate([TRUE[UPPER], ZERO])
    for seed in range(500):
        fit = fit_multi_position(poses(seed), G)
        off = np.concatenate([fit.matrix[UPPER], fit.zero]) - truth
        inside.append(np.abs(off) <= coverage_factor(fit.dof) * np.sqrt(fit.covariance.diagonal()))
    share = 100.0 * np.mean(inside, axis=0)
    record_property("obtained", f"{share.min():.1f} to {share.max():.1f} %, all {share.mean():.1f} %")
    assert np.all(np.abs(share - 95.0) <= 4.0)
    assert abs(share.mean() - 95.0) <= 1.5


def test_same_minimum_as_another_parametrisation() -> None:
    """A symmetric quadric by BFGS, turned into a triangle by Cholesky."""
    mean = poses(7, noise=3.0)
    fit = fit_multi_position(mean, G)

    def cost(x: np.ndarray) -> float:
        root = np.zeros((3, 3))
        root[np.tril_indices(3)] = x[:6]
        around = (mean - ZERO) * 0.0024 - x[6:]
        return float(np.sum((np.linalg.norm(around @ (root + np.tril(root, -1).T), axis=1) - G) ** 2))

    found = optimize.minimize(cost, [1, 0, 1, 0, 0, 1, 0, 0, 0], method="BFGS", options={"gtol": 1e-9})
    root = np.zeros((3, 3))
    root[np.tril_indices(3)] = found.x[:6]
    root += np.tril(root, -1).T
    triangle = np.linalg.cholesky(root.T @ root).T * 0.0024
    assert fit.matrix == pytest.approx(triangle, rel=1e-6, abs=1e-10)
    assert fit.zero == pytest.approx(ZERO + found.x[6:] / 0.0024, abs=1e-3)
    assert fit.residual_rms == pytest.approx(np.sqrt(found.fun / len(mean)), rel=1e-6)


def test_stated_scale_is_in_the_unit_of_its_uncertainty() -> None:
    exact = fit_multi_position(poses(1, noise=0.0), G)
    assert exact.matrix == pytest.approx(TRUE, abs=1e-12)
    assert exact.counts_per_unit == pytest.approx(1.0 / TRUE.diagonal())
    assert np.linalg.norm(exact.apply(poses(1, noise=0.0)), axis=1) == pytest.approx(np.full(36, G))
    fits = [fit_multi_position(poses(seed), G) for seed in range(100)]
    drawn = np.std([fit.counts_per_unit for fit in fits], axis=0)
    assert np.mean([fit.counts_per_unit_std for fit in fits], axis=0) == pytest.approx(drawn, rel=0.25)
    drawn = np.std([fit.zero for fit in fits], axis=0)
    assert np.mean([fit.zero_std for fit in fits], axis=0) == pytest.approx(drawn, rel=0.25)


@pytest.mark.parametrize(
    ("kept", "missing"),
    [
        (lambda u: np.abs(u[:, 2]) < 0.08, 2),  # turned about z only
        (lambda u: u[:, 0] > 0.8, 0),  # never with x down
        (lambda u: np.abs(u[:, 1]) < 0.06, 1),
    ],
)
def test_poses_not_spread_enough_are_refused_naming_the_direction(kept: Callable, missing: int) -> None:
    unit = directions(np.random.default_rng(9), 20_000)
    mean = (G * unit[kept(unit)][:40]) @ np.linalg.inv(TRUE).T + ZERO
    with pytest.raises(FitError, match=r"B-FIT-085.*do not determine the length along") as refused:
        fit_multi_position(mean, G)
    named = [float(part) for part in refused.value.message.split("(")[1].split(")")[0].split(",")]
    assert np.argmax(np.abs(named)) == missing


def test_too_few_poses_and_poses_that_are_none_are_refused() -> None:
    with pytest.raises(FitError, match=r"B-FIT-085.*9 poses, 10 are needed"):
        fit_multi_position(poses(1, 9), G)
    rng = np.random.default_rng(5)
    with pytest.raises(FitError, match=r"B-FIT-086.*scatter by"):
        fit_multi_position(directions(rng, 60) * rng.uniform(0.6, 1.4, (60, 1)), 1.0)


MATRIX = np.array([[1.01, 0.004, -0.002], [0.006, 0.99, 0.005], [-0.003, 0.001, 1.02]])  # of K, per count of 80 / deg/s
OFFSET = np.array([32768.0, 32466.0, 32485.0])


def one_after_the_other(steps: Rotation) -> Rotation:
    """Product of all steps up to each of them."""
    reach = 1
    while reach < len(steps):
        steps = Rotation.concatenate([steps[:reach], steps[:-reach] * steps[reach:]])
        reach *= 2
    return steps


@cache
def record(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Step, accelerometer and gyroscope (counts), 50 Hz: 20 s at rest, then 30 turns of 2 s, each with 4 s of rest."""
    rng, rate = np.random.default_rng([61, seed]), 50.0
    attitude, omega = Rotation.from_rotvec(rng.normal(size=3)), [np.zeros((1000, 3))]
    bell = 1.0 - np.cos(2.0 * np.pi * (np.arange(100) + 0.5) / 100)
    for _ in range(30):
        omega += [bell[:, None] * directions(rng, 1) * rng.uniform(30.0, 60.0), np.zeros((200, 3))]
    rates = np.concatenate(omega)
    attitudes = attitude * one_after_the_other(Rotation.from_rotvec(rates / rate, degrees=True))
    force = attitudes.inv().apply([0.0, 0.0, G])
    shake = rng.normal(size=force.shape) * 0.3 * (np.abs(rates).sum(axis=1) > 0)[:, None]
    acceleration = (force + shake) @ np.linalg.inv(TRUE).T + ZERO + rng.normal(size=force.shape) * 5.0
    gyro = rates @ np.linalg.inv(MATRIX).T * 80.0 + OFFSET + rng.normal(size=force.shape) * 4.0
    return np.full(len(rates), 1.0 / rate), acceleration, gyro


def test_rests_are_found_where_they_were() -> None:
    _, acceleration, _ = record(1)
    rests = static_intervals(acceleration, 50.0, initial_s=15.0, window_s=1.0)
    assert len(rests.begin) == 31
    begins = np.concatenate([[0], 1000 + 100 + 300 * np.arange(30)])
    assert np.all((rests.begin - begins >= 0) & (rests.begin - begins <= 60))
    assert np.all(rests.end[1:] - begins[1:] <= 200)
    assert rests.means(acceleration).shape == (31, 3)


def test_moving_variance_is_that_of_numpy() -> None:
    """A threshold between the variances of windows, found by numpy, divides the record in the same places."""
    values = np.random.default_rng(2).normal(size=(400, 3)) * np.linspace(1.0, 3.0, 400)[:, None] + 3e4
    windows = np.lib.stride_tricks.sliding_window_view(values, 21, axis=0)
    size = np.linalg.norm(np.var(windows, axis=-1), axis=1)
    initial = np.linalg.norm(np.var(values[:50], axis=0))
    found = static_intervals(values, 10.0, initial_s=5.0, multiple=3.0, window_s=2.0, least_s=0.1)
    rest = np.zeros(400, bool)
    for begin, end in zip(found.begin, found.end, strict=True):
        rest[begin:end] = True
    assert np.array_equal(rest[10:-10], size < 3.0 * initial)
    assert found.threshold == pytest.approx(3.0 * initial)


def test_record_without_rest_is_refused() -> None:
    noise = np.random.default_rng(1).normal(size=(3000, 3))
    shaken = noise * (1 + 99 * (np.arange(3000) > 60))[:, None]
    for samples, initial_s, why in (
        (noise[:300], 5.0, "rest first"),
        (np.ones((3000, 3)), 5.0, "do not change"),
        (shaken, 0.5, "no interval"),
    ):
        with pytest.raises(FitError, match=f"B-FIT-084.*{why}"):
            static_intervals(samples, 100.0, initial_s=initial_s)


def test_gyroscopes_between_rests() -> None:
    """K in the frame of the accelerometers, with nothing of the truth."""
    for seed in range(2):
        step, acceleration, gyro = record(seed)
        rests = static_intervals(acceleration, 50.0, initial_s=15.0, window_s=1.0)
        force = fit_multi_position(rests.means(acceleration), G).apply(rests.means(acceleration))
        fit = fit_between_rests(step, gyro, rests, force, 80.0)
        assert fit.zero == pytest.approx(OFFSET, abs=0.5)
        assert np.abs(fit.matrix * 80.0 - MATRIX).max() < 0.002


def test_turns_that_do_not_determine_the_gyroscopes_are_refused() -> None:
    step, acceleration, gyro = record(1)
    rests = static_intervals(acceleration, 50.0, initial_s=15.0, window_s=1.0)
    force = (rests.means(acceleration) - ZERO) @ TRUE.T
    for count, order, code, why in ((10, -1, "B-FIT-086", "off by"), (6, 1, "B-FIT-085", "5 turns .*, 8 are needed")):
        some = StaticIntervals(rests.begin[:count], rests.end[:count], rests.threshold, rests.initial)
        with pytest.raises(FitError, match=f"{code}.*{why}"):
            fit_between_rests(step, gyro, some, force[:count][::order], 80.0)


def test_turns_about_one_axis_leave_the_others_open() -> None:
    rng, rate = np.random.default_rng(3), 100.0
    bell = 1.0 - np.cos(2.0 * np.pi * (np.arange(200) + 0.5) / 200)
    rates = np.zeros((600 * 12, 3))
    for k in range(12):
        rates[600 * k + 400 : 600 * k + 600, 0] = bell * 40.0
    angle = np.cumsum(rates[:, 0]) / rate
    force = G * np.column_stack([np.zeros(len(angle)), np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    samples = force + rng.normal(size=force.shape) * 0.01
    rests = static_intervals(samples, rate, initial_s=3.0, window_s=1.0)
    assert [600 * k <= b < 600 * k + 200 for k, (b, _) in enumerate(pairwise([*rests.begin, 0]))] == [True] * 12
    gyro = rates + rng.normal(size=rates.shape) * 0.01
    with pytest.raises(FitError, match=r"B-FIT-085.*condition"):
        fit_between_rests(np.full(len(rates), 0.01), gyro, rests, rests.means(samples), 1.0)
