"""The polynomial against other implementations, its intervals against the truth, and the test of lack of fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from bench.systems.readings.estimators.polynomial import Curve, Points, fit_polynomial


def points(
    mean: np.ndarray, std: float | np.ndarray = 0.0, *, gain: float = 0.0, floor: float = 0.0, n: int = 5
) -> Points:
    every = np.ones_like(mean)
    scatter = std * np.sqrt(n) * every
    return Points(mean, std * every, scatter, gain * mean, floor * every, n * every)


def test_without_errors_of_x_it_is_numpys_polyfit() -> None:
    x, y = np.linspace(-2.0, 9.0, 9), np.array([3.1, 2.0, 1.7, 1.2, 2.4, 3.3, 5.9, 8.2, 12.4])
    curve = fit_polynomial(points(x), points(y, 0.05), (0, 1, 2))
    assert curve.coefficients[::-1] == pytest.approx(np.polyfit(x, y, 2), rel=1e-9)
    _, covariance = np.polyfit(x, y, 2, cov=True)
    assert curve.covariance[::-1, ::-1] == pytest.approx(covariance, rel=1e-6)  # its chi-square is above 1


@pytest.mark.validates("line through points with errors on both axes", against="Pearson's data with York's weights")
def test_errors_of_x_against_york(record_property: Callable[[str, object], None]) -> None:
    """Weights follow the slope from turn to turn here, and the slope follows the weights in York's exact solution."""
    x = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
    y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
    x_weight = np.array([1000.0, 1000.0, 500.0, 800.0, 200.0, 80.0, 60.0, 20.0, 1.8, 1.0])
    y_weight = np.array([1.0, 1.8, 4.0, 8.0, 20.0, 20.0, 70.0, 70.0, 100.0, 500.0])
    curve = fit_polynomial(points(x, x_weight**-0.5), points(y, y_weight**-0.5), (0, 1))
    off = (curve.coefficients - [5.47991022, -0.480533407]) / [0.29497, 0.05798]
    record_property("obtained", f"{np.max(np.abs(off)):.2g} standard uncertainties off")
    assert np.max(np.abs(off)) < 0.4


def test_errors_of_the_instruments_reach_the_coefficients() -> None:
    """One gain of the meter is one relative error of both coefficients; more points do not make it smaller."""
    x = np.linspace(1.0, 10.0, 40)
    curve = fit_polynomial(points(x), points(2.0 + 3.0 * x, 1e-9, gain=1e-4), (0, 1))
    assert np.sqrt(np.diag(curve.covariance)) == pytest.approx([2e-4, 3e-4], rel=1e-3)


def test_intervals_cover_the_truth() -> None:
    """Coverage of 95 % intervals, 400 campaigns: gain and offset of both meters drawn, five readings of each level."""
    rng = np.random.default_rng(7)
    levels, inside = np.linspace(1.0, 9.0, 7), np.zeros(2)
    for _ in range(400):
        gains, offsets = 1.0 + rng.normal(0.0, 2e-5, 2), rng.normal(0.0, 2e-4, 2)
        read = [
            np.mean(offset + gain * true + rng.normal(0.0, 1e-4, (5, 7)), axis=0)
            for gain, offset, true in zip(gains, offsets, (levels, 0.1 + 0.5 * levels), strict=True)
        ]
        x, y = (points(mean, 1e-4 / np.sqrt(5), gain=2e-5, floor=2e-4) for mean in read)
        curve = fit_polynomial(x, y, (0, 1))
        inside += np.abs(curve.coefficients - [0.1, 0.5]) <= 1.96 * np.sqrt(np.diag(curve.covariance))
    assert (inside / 400 >= 0.93).all()  # more than 95 %: the floor counts twice, because nobody says which it is


def test_lack_of_fit_is_rare_in_right_worlds_and_sure_in_wrong_ones() -> None:
    rng = np.random.default_rng(3)
    x, chances = np.linspace(0.0, 1.0, 8), []
    for _ in range(500):
        readings = 1.0 + 2.0 * x + rng.normal(0.0, 1e-3, (5, 8))
        chances.append(_curve(x, readings).lack)
    assert np.mean(np.array(chances) < 0.05) < 0.08
    bent = _curve(x, 1.0 + 2.0 * x + 0.02 * x**2 + rng.normal(0.0, 1e-3, (5, 8)))
    assert bent.lack < 1e-6
    assert bent.rival > 0.3


def _curve(x: np.ndarray, readings: np.ndarray) -> Curve:
    scatter = readings.std(axis=0, ddof=1)
    y = Points(readings.mean(axis=0), scatter / np.sqrt(5), scatter, 0.0 * x, 0.0 * x, np.full(8, 5.0))
    return fit_polynomial(points(x), y, (0, 1))
