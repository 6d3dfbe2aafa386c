"""Predictions against the multivariate normal distribution, the first phase against chi-square, changes found again."""

from __future__ import annotations

import math

import numpy as np
import pytest
from control_simulation import FIRST, OWN, SHARED, history
from scipy import stats

from bench.maths.control.limits import chart, limits_for
from bench.maths.control.predictions import (
    Readings,
    Scatter,
    change_until,
    first_phase,
    level_and_drift,
    odd_one_of_first_phase,
    predictions,
    step_until,
)
from bench.maths.drift import NO_STANDARD
from bench.model.errors import FitError

SEED = 23


def dense(readings: Readings, variance: float) -> np.ndarray:
    same = np.equal.outer(readings.standard, readings.standard) & (readings.standard != NO_STANDARD)
    return variance * np.eye(readings.t.size) + np.outer(readings.shared, readings.shared) * same


def expected_by_hand(readings: Readings, variance: float, place: int) -> tuple[float, float]:
    """Conditional distribution of one reading given those before it, level and drift with all but flat priors."""
    design = np.column_stack([np.ones_like(readings.t), readings.t - readings.t[0]])
    covariance = dense(readings, variance) + 1e8 * design @ design.T
    before = covariance[:place, :place]
    gain = np.linalg.solve(before, covariance[:place, place])
    left = covariance[place, place] - gain @ covariance[:place, place]
    return float(gain @ readings.value[:place]), math.sqrt(left)


def test_predictions_are_conditional_normal_distributions() -> None:
    readings = history(np.random.default_rng(SEED), 20, 5)
    scatter = first_phase(readings, FIRST)
    found = predictions(readings, scatter)
    assert np.isnan(found.expected[:2]).all()  # two unknowns
    for place in (3, 10, 14, 19):
        expected, std = expected_by_hand(readings, scatter.variance, place)
        assert found.expected[place] == pytest.approx(expected, abs=1e-3)
        assert found.std[place] == pytest.approx(std, rel=1e-4)


def test_the_first_phase_is_chi_square_of_its_own_scatter() -> None:
    readings = history(np.random.default_rng(SEED), FIRST, 4)
    scatter = first_phase(readings, FIRST)
    weight = np.linalg.inv(dense(readings, scatter.variance))
    design = level_and_drift(readings)
    left = readings.value - design @ np.linalg.solve(design.T @ weight @ design, design.T @ weight @ readings.value)
    assert left @ weight @ left == pytest.approx(FIRST - 2, rel=1e-6)
    assert scatter.count == FIRST


def test_without_certificates_it_is_the_residual_variance_of_the_line() -> None:
    readings = history(np.random.default_rng(SEED), FIRST, FIRST)
    alone = Readings(
        readings.t, readings.value, readings.std, 0.0 * readings.t, np.full(FIRST, NO_STANDARD), readings.level
    )
    scatter = first_phase(alone, FIRST)
    left = np.polyfit(alone.t, alone.value, 1, full=True)[1][0]
    assert scatter.variance == pytest.approx(left / (FIRST - 2), rel=1e-6)
    assert scatter.variance_std == pytest.approx(scatter.variance * math.sqrt(2.0 / (FIRST - 2)), rel=1e-6)
    assert scatter.dof == pytest.approx(FIRST - 2, rel=5e-3)
    assert predictions(alone, scatter).dof[-1] == pytest.approx(FIRST - 2, rel=5e-3)


def test_a_later_calibration_changes_nothing_before_it() -> None:
    readings = history(np.random.default_rng(SEED), 24, 5)
    scatter = first_phase(readings, FIRST)
    whole, part = predictions(readings, scatter), predictions(readings.of(slice(17)), scatter)
    np.testing.assert_allclose(whole.score[:17], part.score, rtol=1e-9)
    assert first_phase(readings.of(slice(17)), FIRST) == scatter


def test_a_new_certificate_is_less_of_a_surprise_than_the_same_change_without_one() -> None:
    readings = history(np.random.default_rng(SEED), 13, 12)
    scatter = first_phase(readings, FIRST)
    same = Readings(readings.t, readings.value, readings.std, readings.shared, 0 * readings.standard, readings.level)
    assert predictions(readings, scatter).std[12] > SHARED
    assert predictions(same, scatter).std[12] < 2.0 * OWN


def test_a_less_certain_calibration_has_that_on_top() -> None:
    readings = history(np.random.default_rng(SEED), 14, 20)
    scatter = first_phase(readings, FIRST)
    std = readings.std.copy()
    std[13] = math.hypot(std[13], 30.0)
    wide = predictions(Readings(readings.t, readings.value, std, *list(vars(readings).values())[3:]), scatter)
    assert wide.std[13] == pytest.approx(math.hypot(predictions(readings, scatter).std[13], 30.0), rel=1e-3)


def test_an_adjustment_begins_a_level_and_keeps_the_drift() -> None:
    readings = history(np.random.default_rng(SEED), 24, 30)
    level = (np.arange(24) >= 16).astype(np.int64)
    moved = Readings(
        readings.t, readings.value + 500.0 * level, readings.std, readings.shared, readings.standard, level
    )
    scatter = first_phase(moved, FIRST)
    found = predictions(moved, scatter)
    assert np.isnan(found.score[16])  # nothing is known of the new level
    assert np.isfinite(found.score[17:]).all()
    assert np.nanmax(np.abs(found.score)) < 4.0
    assert chart(found.score[FIRST:], limits_for(200.0, 1, scatter.dof)).signals == ()


@pytest.mark.parametrize("size", [8.0, -20.0])
def test_a_step_is_found_with_its_date_and_size(size: float) -> None:
    rng, right, inside, trials = np.random.default_rng(SEED), 0, 0, 40
    for _ in range(trials):
        readings = history(rng, 26, 40, size, 20)
        scatter = first_phase(readings, FIRST)
        signals = chart(predictions(readings, scatter).score[FIRST:], limits_for(60.0, 1, scatter.dof)).signals
        assert signals
        change = change_until(readings, scatter, 25)
        assert change is not None
        right += change.earliest <= 20 <= change.latest
        inside += abs(change.size - size * OWN) <= change.expanded
    print(f"seed {SEED}, step {size}: date within its range {right}, size within its interval {inside} of {trials}")
    assert right >= 36
    assert inside >= 34


def test_units_with_the_same_certificates_are_predicted_together() -> None:
    """Eight units by turns, known scatter: scores are standard normal and the next one knows nothing of the last."""
    rng, scores = np.random.default_rng(SEED), []
    for _ in range(30):
        errors, parts = rng.normal(0.0, SHARED, 5), []
        for _ in range(8):
            t = np.sort(rng.uniform(0.0, 5.0, 10))
            label = np.floor(t).astype(np.int64)
            value = rng.normal(0.0, 300.0) + rng.normal(0.0, 10.0) * t + errors[label] + rng.normal(0.0, OWN, 10)
            parts.append((t, value, label))
        t, value, label = (np.concatenate(column) for column in zip(*parts, strict=True))
        order, shared, level = np.argsort(t), np.full(80, SHARED), np.zeros(80, dtype=np.int64)
        together = Readings(t, value, shared, shared, label, level, np.repeat(np.arange(8), 10)).of(order)
        score = predictions(together, Scatter(OWN**2, 1e-9, np.inf, 0, np.inf)).score
        scores.append(score[np.isfinite(score)])
    assert all(score.size == 80 - 2 * 8 for score in scores)  # a level and a drift each
    print(f"seed {SEED}: standard deviation {np.concatenate(scores).std():.3f}")
    assert np.concatenate(scores).std() == pytest.approx(1.0, abs=4.0 / (2 * 1920) ** 0.5)
    assert abs(np.mean([np.mean(score[1:] * score[:-1]) for score in scores])) < 4.0 / 1890**0.5


def test_an_odd_calibration_of_the_first_phase_by_leaving_it_out() -> None:
    """Its residual against the line of the others, over its standard deviation by their scatter, by Student's t."""
    readings = history(np.random.default_rng(SEED), FIRST, FIRST)
    value = readings.value.copy()
    value[7] += 6.0 * OWN
    alone = Readings(readings.t, value, readings.std, 0.0 * value, np.full(FIRST, NO_STANDARD), readings.level)
    worst, probability = odd_one_of_first_phase(alone, first_phase(alone, FIRST))
    others = np.arange(FIRST) != 7
    design = np.column_stack([np.ones(FIRST), readings.t])
    fitted, squares, *_ = np.linalg.lstsq(design[others], value[others])
    leverage = design[7] @ np.linalg.inv(design[others].T @ design[others]) @ design[7]
    by_hand = (value[7] - design[7] @ fitted) / math.sqrt(squares[0] / (FIRST - 3) * (1.0 + leverage))
    assert worst == 7
    assert probability == pytest.approx(2.0 * FIRST * stats.t.sf(abs(by_hand), FIRST - 3), rel=1e-4)


def test_a_step_in_independent_errors_is_their_weighted_mean() -> None:
    error, std = np.array([0.1, np.nan, 5.0, 7.0]), np.array([1.0, np.nan, 1.0, 2.0])
    change = step_until(error, std, 3, np.inf)
    assert change is not None
    assert (change.since, change.size) == (2, pytest.approx((5.0 + 7.0 / 4.0) / 1.25))
    assert change.std == pytest.approx(1.25**-0.5)


def test_what_shows_no_scatter_is_refused() -> None:
    readings = history(np.random.default_rng(SEED), 4, 4)
    with pytest.raises(FitError) as caught:
        first_phase(readings, 2)
    assert caught.value.code == "B-FIT-001"
    with pytest.raises(FitError) as caught:
        first_phase(Readings(readings.t, readings.value, 0.0 * readings.t, *list(vars(readings).values())[3:]), 4)
    assert caught.value.code == "B-FIT-002"
    still = Readings(readings.t, 0.0 * readings.t, *list(vars(readings).values())[2:])
    assert first_phase(still, 4).variance > 0.0
    assert isinstance(first_phase(still, 4), Scatter)
