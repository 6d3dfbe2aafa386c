"""Noise that is alike for a while: against dense matrices, known sizes, and the coverage of intervals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from bench.systems.af_converter.estimators.correlated_noise import fit_noise, whitening
from bench.systems.af_converter.estimators.drift_ramp import block_means, fit_drift

M, STEP_s = 150, 600.0
T_s = np.arange(M) * STEP_s


def dense(t_s: np.ndarray, white: float, slow: float, time_s: float) -> np.ndarray:
    return white * np.eye(t_s.size) + slow * np.exp(-np.abs(t_s[:, None] - t_s) / time_s)


@pytest.mark.validates(
    "whitening of exponentially correlated noise",
    against="numpy's Cholesky factor of the dense matrix",
)
def test_whitening_equals_the_cholesky_factor_of_the_matrix(record_property: Callable[[str, object], None]) -> None:
    rng = np.random.default_rng(1)
    t_s = np.sort(rng.uniform(0.0, 1e5, 120))
    columns = rng.normal(size=(120, 4))
    factor = np.linalg.cholesky(dense(t_s, 0.5, 2.0, 3000.0))
    filtered = whitening(t_s, (0.5, 2.0, 3000.0))
    found = filtered.of(columns)
    record_property("obtained", f"{np.abs(found - np.linalg.solve(factor, columns)).max():.0e}, limit 1e-12")
    np.testing.assert_allclose(found, np.linalg.solve(factor, columns), atol=1e-12)
    assert filtered.log_volume == pytest.approx(float(np.sum(np.log(np.diag(factor)))), rel=1e-12)
    np.testing.assert_allclose(filtered.of(columns[:, 0]), found[:, 0], atol=1e-13)


def test_white_noise_is_found_white() -> None:
    rng = np.random.default_rng(2)
    design = np.vander(np.linspace(-1, 1, M), 3)
    noise = fit_noise(T_s, rng.normal(0.0, 2.0, M), design)
    weights = np.full(M, 1.0 / M)
    variance, dof = noise.variance_of(weights, T_s)
    assert variance == pytest.approx(4.0 / M, rel=0.5)
    assert noise.white + noise.slow == pytest.approx(4.0, rel=0.3)
    assert dof > 10


def test_size_and_duration_of_slow_noise() -> None:
    rng = np.random.default_rng(3)
    t_s = np.arange(200) * STEP_s
    factor = np.linalg.cholesky(dense(t_s, 0.2, 1.0, 6000.0))
    found = [fit_noise(t_s, factor @ rng.normal(size=200), np.ones((200, 1))) for _ in range(8)]
    assert float(np.median([one.slow for one in found])) == pytest.approx(1.0, rel=0.3)
    assert float(np.median([one.time_s for one in found])) == pytest.approx(6000.0, rel=0.4)
    assert float(np.median([one.white for one in found])) == pytest.approx(0.2, rel=0.4)


def test_variance_of_a_sum_is_that_of_the_matrix() -> None:
    rng = np.random.default_rng(4)
    noise = fit_noise(T_s, rng.normal(size=M).cumsum(), np.ones((M, 1)))
    weights = rng.normal(size=M)
    matrix = dense(T_s, noise.white, noise.slow, noise.time_s)
    assert noise.variance_of(weights, T_s)[0] == pytest.approx(weights @ matrix @ weights, rel=1e-12)


def coverage(time_s: float, trials: int, seed: int) -> tuple[float, float]:
    """Share of 95 % intervals of the up/down term that hold its true value 0: stated, and for independent rows."""
    rng = np.random.default_rng(seed)
    factor = np.linalg.cholesky(dense(T_s, 0.1, 1.0, time_s) if time_s else np.eye(M))
    branch = np.repeat([0.0, 0.5, 0.0, -0.5, 0.0], M // 5)
    temperature = 20.0 + 15.0 * np.interp(np.arange(M), M * np.array([0.2, 0.4, 0.6, 0.8]), [0.0, 1.0, 1.0, 0.0])
    blocks = block_means(T_s, M)
    held = naive = 0
    for _ in range(trials):
        fit = fit_drift(blocks, temperature, factor @ rng.normal(size=M), branch, 25.0)
        value, std, dof = fit.estimate("up minus down")
        held += abs(value) <= stats.t.ppf(0.975, dof) * std
        sigma = float(np.sqrt(fit.residual @ fit.residual / (M - 7)))
        naive += abs(value) <= 1.96 * sigma * float(np.linalg.norm(fit.operator[4]))
    return held / trials, naive / trials


@pytest.mark.validates(
    "95 % intervals of up minus down in an imported ramp",
    against="24 simulated ramps each with noise alike for 0 s, 6,000 s and 30,000 s",
)
@pytest.mark.parametrize("time_s", [0.0, 6000.0, 30000.0])
def test_intervals_hold_the_truth_and_those_of_independent_rows_do_not(
    record_property: Callable[[str, object], None], time_s: float
) -> None:
    held, naive = coverage(time_s, 24, seed=5)
    print(f"time {time_s} s, seed 5, 24 fits: stated {held:.3f}, independent rows {naive:.3f}")
    record_property("obtained", f"{time_s:.0f} s: {100 * held:.0f} %, as independent rows {100 * naive:.0f} %")
    assert held >= 0.8
    assert (naive < 0.7) == (time_s > 0)


@pytest.mark.sweep
@pytest.mark.parametrize("time_s", [0.0, 6000.0, 30000.0])
def test_coverage_of_the_up_down_term(time_s: float) -> None:
    held, _ = coverage(time_s, 500, seed=6)
    print(f"time {time_s} s, seed 6, 500 fits: {held:.3f}")
    assert 0.92 <= held <= 0.985
