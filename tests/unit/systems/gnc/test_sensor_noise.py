"""Declared noise of sensors against sums over time, textbook formulas and the estimators that measure it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.maths.allan import allan_deviation
from bench.systems.gnc.estimators.bias_mean import declared_mean, mean_bias
from bench.systems.gnc.estimators.bias_stability import bias_stability, declared_noise
from bench.systems.gnc.estimators.sensor_noise import SensorNoise, expected_range

WANDERING = [(3.0, 40.0), (2.0, 300.0)]


def summed(begin_s: np.ndarray, length_s: np.ndarray) -> np.ndarray:
    """Covariance of means as a sum over 400 points of each."""
    points = begin_s[:, None] + (np.arange(400) + 0.5) / 400.0 * length_s[:, None]
    apart = np.abs(points.ravel()[:, None] - points.ravel())
    whole = sum(size**2 * np.exp(-apart / time_s) for size, time_s in WANDERING)
    return whole.reshape(len(begin_s), 400, -1, 400).mean(axis=(1, 3))


def test_wandering_is_the_integral_of_its_covariance() -> None:
    noise = SensorNoise(1.0, WANDERING, 0.0, 0.01)
    begin_s, length_s = np.array([100.0, 0.0, 160.0]), np.array([60.0, 90.0, 20.0])
    np.testing.assert_allclose(noise.wander(begin_s, length_s), summed(begin_s, length_s), rtol=1e-4)


def test_what_all_records_share_is_no_error_of_their_bias() -> None:
    noise = SensorNoise(0.0, [(5.0, 1e9)], 0.0, 0.01)
    begin_s, length_s = np.array([0.0, 100.0]), np.array([50.0, 80.0])
    assert np.abs(noise.wander_about_mean(begin_s, length_s)).max() < 1e-4
    about_first = noise.wander_about_mean(begin_s, length_s, np.array([True, False]))
    assert about_first[0, 0] == pytest.approx(0.0, abs=1e-12)


def test_allan_variance_of_white_noise_and_of_a_correlated_part() -> None:
    """IEEE Std 952 C.1.6: sigma^2 T/tau (3 and 4 exponentials) is that of exponentially correlated noise."""
    tau_s, size, time_s = 25.0, 3.0, 40.0
    x = tau_s / time_s
    due = 2.0 * size**2 / x * (1.0 - (3.0 - 4.0 * math.exp(-x) + math.exp(-2.0 * x)) / (2.0 * x))
    noise = SensorNoise(1.5, [(size, time_s)], 0.0, 0.01)
    assert noise.allan_variance(tau_s) == pytest.approx(1.5**2 / tau_s + due, rel=1e-12)


def test_a_declared_mean_is_what_records_of_such_noise_say() -> None:
    rng = np.random.default_rng(31)
    print("seed 31")
    noise = SensorNoise(0.3, [], 0.05, 0.05)
    samples = rng.normal(0.0, 0.3 / math.sqrt(0.05), (60, 3600))
    found = [mean_bias(np.round(row / 0.05) * 0.05, 0.05, 0.05) for row in samples]
    declared = declared_mean(0.0, noise, 3600)
    measured = math.sqrt(float(np.mean([mean.std**2 - mean.slow_std**2 for mean in found])))
    assert measured == pytest.approx(declared.std, rel=0.03)
    assert declared.std == pytest.approx(math.sqrt((0.3**2 + 0.05**2 / 12.0 * 0.05) / 180.0), rel=1e-12)
    assert declared.dof == pytest.approx(float(np.median([mean.dof for mean in found])), rel=0.01)
    assert declared.slow_std == 0.0


def test_degrees_of_freedom_of_a_declared_stability() -> None:
    """White noise has n - 1; wandering has 2 E^2 / Var by the traces of its covariance."""
    assert declared_noise(SensorNoise(1.0, [], 0.0, 0.1), 360, 10.0).dof_of_variance == pytest.approx(359.0)
    noise = SensorNoise(6.0, WANDERING, 0.0, 0.1)
    covariance = noise.of_means(10.0 * np.arange(360), np.full(360, 10.0))
    centred = (np.eye(360) - 1.0 / 360.0) @ covariance
    due = float(np.trace(centred) ** 2 / np.trace(centred @ centred))
    found = bias_stability(np.zeros(36_000), 0.1, declared=noise)
    assert found.dof == pytest.approx(due, rel=1e-9)
    assert found.value == pytest.approx(math.sqrt(float(np.trace(centred)) / 359.0), rel=1e-9)


def test_allan_variance_is_that_of_simulated_noise() -> None:
    rng = np.random.default_rng(32)
    print("seed 32")
    keep = math.exp(-1.0 / 40.0)
    kicks = rng.normal(0.0, 3.0 * math.sqrt(1.0 - keep**2), 200_000)
    slow = np.empty(kicks.size)
    at = 0.0
    for place, kick in enumerate(kicks.tolist()):
        slow[place] = at = at * keep + kick
    curve = allan_deviation(slow, 1.0, factors=[20])
    due = SensorNoise(0.0, [(3.0, 40.0)], 0.0, 1.0).allan_variance(20.0)
    assert curve.deviation[0] ** 2 == pytest.approx(due, rel=0.03)


@pytest.mark.parametrize(("count", "deviations"), [(2, 1.128), (5, 2.326), (10, 3.078), (25, 3.931), (50, 4.498)])
def test_the_range_of_a_sample_is_that_of_tippett(count: int, deviations: float) -> None:
    assert expected_range(count) == pytest.approx(deviations, abs=6e-4)
