"""Drift line, E_n, control limits and time to a limit against scipy, published figures and closed forms."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq, curve_fit

from bench.maths.drift import NO_STANDARD, days_to_limit, en_scores, fit_drift_line, individuals_chart
from bench.model.errors import FitError

SEED = 20260
OWN, SHARED, RATE, YEARS, CERTIFICATES = 2.0, 10.0, 12.0, 6.0, 6


def series(rng: np.random.Generator, count: int = 12) -> tuple[np.ndarray, ...]:
    """Calibrations over six years, a new certificate of the calibrator each year; its error is common to the year."""
    t = np.sort(rng.uniform(40.0, 40.0 + YEARS, count))
    standard = np.minimum((t - 40.0).astype(np.int64), CERTIFICATES - 1)
    errors = rng.normal(0.0, SHARED, CERTIFICATES)
    value = 300.0 + RATE * (t - 40.0) + errors[standard] + rng.normal(0.0, OWN, count)
    return t, value, np.full(count, np.hypot(OWN, SHARED)), np.full(count, SHARED), standard


def dense_covariance(std: np.ndarray, shared: np.ndarray, standard: np.ndarray) -> np.ndarray:
    same = (standard[:, None] == standard) & (standard != NO_STANDARD)
    return np.diag(std**2 - np.where(standard != NO_STANDARD, shared**2, 0.0)) + np.where(
        same, np.outer(shared, shared), 0.0
    )


@pytest.mark.validates(
    "drift line over calibrations, value and covariance",
    against="scipy.optimize.curve_fit with the full covariance",
)
@pytest.mark.parametrize("without", [False, True])
def test_the_line_is_that_of_scipy_with_the_full_covariance(
    record_property: Callable[[str, object], None], without: bool
) -> None:
    t, value, std, shared, standard = series(np.random.default_rng(SEED))
    if without:
        standard, shared = np.where(standard % 2 == 0, NO_STANDARD, standard), np.where(standard % 2 == 0, 0.0, shared)
    line = fit_drift_line(t, value, std, shared, standard)
    covariance = dense_covariance(std, shared, standard)

    def model(x: np.ndarray, mean: float, rate: float) -> np.ndarray:
        return mean + rate * (x - line.t_mean)

    found, spread = curve_fit(model, t, value, p0=(300.0, 0.0), sigma=covariance, absolute_sigma=True)
    record_property("obtained", f"rate {abs(line.rate / found[1] - 1):.0e}, limit 1e-6")
    assert line.mean == pytest.approx(found[0], rel=1e-6)
    assert line.rate == pytest.approx(found[1], rel=1e-6)
    np.testing.assert_allclose(line.covariance, spread, rtol=1e-5)
    left = value - model(t, *found)
    assert line.chi2 == pytest.approx(left @ np.linalg.inv(covariance) @ left, rel=1e-6)
    np.testing.assert_allclose(line.residual, left, atol=1e-5)
    assert line.dof == t.size - 2


@pytest.mark.validates(
    "95 % intervals of a drift rate",
    against="2,000 simulated histories with a shared calibrator",
)
def test_intervals_of_the_rate_cover_and_not_without_the_shared_standard(
    record_property: Callable[[str, object], None],
) -> None:
    rng = np.random.default_rng(SEED)
    covered = {"shared": 0, "white": 0}
    trials = 2000
    for _ in range(trials):
        t, value, std, shared, standard = series(rng)
        for name, part in (("shared", shared), ("white", np.zeros_like(shared))):
            line = fit_drift_line(t, value, std, part, standard)
            half = 1.959964 * np.sqrt(line.covariance[1, 1])
            covered[name] += abs(line.rate - RATE) <= half
    print(f"seed {SEED}: stated intervals cover {covered} of {trials}")
    record_property(
        "obtained",
        f"{100 * covered['shared'] / trials:.1f} %, without its share {100 * covered['white'] / trials:.1f} %",
    )
    assert abs(covered["shared"] / trials - 0.95) < 0.015
    assert covered["white"] / trials < 0.93


def test_scatter_beyond_what_is_stated_widens_the_interval() -> None:
    t = np.linspace(0.0, 9.0, 10)
    value = np.where(np.arange(10) % 2 == 0, 5.0, -5.0)
    line = fit_drift_line(t, value, np.ones(10), np.zeros(10), np.full(10, NO_STANDARD))
    scatter = np.sqrt(line.chi2 / 8)  # beside the uncertainty of 1 there is a random effect
    assert line.between_std == pytest.approx(np.sqrt(scatter**2 - 1.0), rel=1e-5)
    assert line.rate_std == pytest.approx(scatter / np.sqrt(82.5), rel=1e-5)  # sum of squares about the mean: 82.5
    assert line.rate_expanded == pytest.approx(2.306004 * line.rate_std, rel=1e-6)  # t of 8 degrees of freedom
    assert line.std_at(np.array([4.5]))[0] == pytest.approx(scatter / np.sqrt(10), rel=1e-5)
    two = fit_drift_line(t[:2], value[:2], np.ones(2), np.zeros(2), np.full(2, NO_STANDARD))
    assert two.between_std == 0.0
    assert two.rate_std == pytest.approx(np.sqrt(2.0))
    assert two.rate_expanded == pytest.approx(1.959964 * two.rate_std, rel=1e-6)


def test_the_random_effect_makes_chi_square_what_it_must_be() -> None:
    """With unequal uncertainties and shared certificates: the generalised chi-square is the degrees of freedom."""
    rng = np.random.default_rng(SEED)
    t, value, std, shared, standard = series(rng)
    value = value + rng.normal(0.0, 3.0 * std.max(), t.size)
    line = fit_drift_line(t, value, std, shared, standard)
    same = np.equal.outer(standard, standard) & (standard != NO_STANDARD)
    covariance = np.diag(std**2 - shared**2 + line.between_std**2) + np.outer(shared, shared) * same
    assert line.between_std > 0.0
    assert line.residual @ np.linalg.solve(covariance, line.residual) == pytest.approx(line.dof, rel=2e-3)
    design = np.column_stack([np.ones_like(t), t - line.t_mean])
    by_hand = np.linalg.inv(design.T @ np.linalg.solve(covariance, design))
    np.testing.assert_allclose(line.covariance, by_hand, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("count", "between", "least"), [(12, 0.0, 0.945), (12, 1.0, 0.93), (12, 5.0, 0.94), (5, 5.0, 0.94)]
)
def test_intervals_cover_where_calibrations_scatter(count: int, between: float, least: float) -> None:
    """The normal factor and the Birge ratio held 84.7 % of 5 and 90.7 % of 12 calibrations."""
    rng, inside, trials = np.random.default_rng(SEED), 0, 2000
    alone = np.full(count, NO_STANDARD)
    for _ in range(trials):
        t, std = np.arange(float(count)), rng.uniform(0.7, 1.4, count)
        value = RATE * t + rng.normal(0.0, np.hypot(std, between))
        line = fit_drift_line(t, value, std, np.zeros(count), alone)
        inside += abs(line.rate - RATE) <= line.rate_expanded
    print(f"{count} calibrations, random effect {between:g}: {inside} of {trials}")
    assert least < inside / trials < 0.98


def test_an_uncertainty_that_is_all_shared_still_gives_a_line() -> None:
    t, value, std, _, standard = series(np.random.default_rng(SEED))
    line = fit_drift_line(t, value, std, std, np.zeros_like(standard))
    assert np.isfinite(line.rate)
    assert np.isfinite(line.covariance).all()


def test_refusals() -> None:
    t, value, std, shared, standard = series(np.random.default_rng(SEED))
    with pytest.raises(FitError, match=r"B-FIT-001: .*rate"):
        fit_drift_line(np.full_like(t, 40.0), value, std, shared, standard)
    with pytest.raises(FitError, match="B-FIT-002"):
        fit_drift_line(t, value, np.zeros_like(std), shared, standard)
    with pytest.raises(FitError, match="B-FIT-001"):
        individuals_chart(np.ones(1))


def test_en_of_independent_laboratories() -> None:
    # two laboratories, 10.0 +- 0.3 and 10.5 +- 0.4: the difference is just its expanded uncertainty of 0.5
    en = en_scores(np.array([0.5, -1.0]), (np.full(2, 0.3), np.full(2, 0.4)), (np.zeros(2), np.zeros(2)))
    np.testing.assert_allclose(en, [1.0, -2.0])


@pytest.mark.validates(
    "E_n without the shared calibrator",
    against="20,000 simulated pairs: 95 % are to be within 1",
)
def test_en_with_the_shared_calibrator_left_out(record_property: Callable[[str, object], None]) -> None:
    rng = np.random.default_rng(SEED)
    trials = 20_000
    gain = rng.normal(0.0, SHARED, trials)
    first, second = (gain + rng.normal(0.0, OWN, trials) for _ in range(2))
    expanded = np.full(trials, 1.959964 * np.hypot(OWN, SHARED))
    part = np.full(trials, 1.959964 * SHARED)
    within = np.abs(en_scores(second - first, (expanded, expanded), (part, part))) <= 1.0
    blind = np.abs(en_scores(second - first, (expanded, expanded), (0.0 * part, 0.0 * part))) <= 1.0
    print(f"seed {SEED}: |E_n| <= 1 in {within.mean():.4f}, with the gain left in {blind.mean():.4f}")
    record_property("obtained", f"{100 * within.mean():.2f} %, limit 95 +- 0.6")
    assert abs(within.mean() - 0.95) < 0.006
    assert blind.all()  # a change of five standard uncertainties would pass unseen
    assert np.isnan(en_scores(np.array([1.0, np.nan]), (part[:2], part[:2]), (part[:2], part[:2]))).all()


@pytest.mark.validates(
    "control limits of individuals",
    against="NIST/SEMATECH e-Handbook 6.3.2.2",
)
def test_control_limits_of_a_published_example(record_property: Callable[[str, object], None]) -> None:
    # NIST/SEMATECH e-Handbook of Statistical Methods, section 6.3.2.2: ten flow rates of a batch process
    rates = np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1])
    chart = individuals_chart(rates)
    record_property("obtained", f"{chart.action[0]:.4f} to {chart.action[1]:.4f}")
    assert chart.centre == pytest.approx(50.81)
    assert chart.mean_range == pytest.approx(1.8778, abs=5e-5)
    assert chart.action == pytest.approx((45.8159, 55.8041), abs=5e-5)
    assert chart.warning == pytest.approx((50.81 - 2 / 3 * 4.9941, 50.81 + 2 / 3 * 4.9941), abs=5e-5)
    assert chart.range_limit == pytest.approx(3.267 * 1.8778, abs=5e-4)


@pytest.mark.validates(
    "days until an interval reaches its limit",
    against="scipy.optimize.brentq",
)
def test_days_to_a_limit_against_a_root_finder() -> None:
    rng = np.random.default_rng(SEED)
    count, most = 40, 3653
    value, std = rng.normal(0.0, 30.0, count), rng.uniform(1.0, 12.0, count)
    rate, rate_std = rng.normal(0.0, 0.08, count), rng.uniform(0.0, 0.01, count)
    limit = np.full(count, 100.0)
    found = days_to_limit(value, std, rate, rate_std, -limit, limit, most_days=most)
    for one in range(count):

        def over(day: float, at: int = one) -> float:
            reach = abs(value[at] + rate[at] * day) + 1.959963984540054 * np.hypot(std[at], rate_std[at] * day)
            return float(reach - limit[at])

        grid = np.linspace(0.0, most, 2_001)
        crossing = next((k for k in range(1, grid.size) if over(grid[k]) >= 0.0), None) if over(0.0) < 0.0 else 0
        if crossing is None:
            assert found[one] == most
        elif crossing:
            root = brentq(over, grid[crossing - 1], grid[crossing])
            assert root - 1.001 <= found[one] <= root
        else:
            assert found[one] == 0


def test_days_without_limit_drift_or_uncertainty() -> None:
    nothing, open_end = np.array([np.nan]), np.array([np.inf])
    one, ten = np.array([1.0]), np.array([10.0])
    assert days_to_limit(one, one, one, one, -open_end, open_end, most_days=365) == [365]
    assert days_to_limit(one, one, nothing, nothing, -ten, ten, most_days=365) == [365]
    assert days_to_limit(ten, one, nothing, nothing, -ten, ten, most_days=365) == [0]
    value, unknown, limit = np.array([1.0, np.nan]), np.array([np.nan, 1.0]), np.array([10.0, 10.0])
    assert days_to_limit(value, unknown, unknown, unknown, -limit, limit, most_days=365).tolist() == [0, 0]


def test_days_to_a_limit_on_one_side() -> None:
    """From 5.0 by 0.01 a day to 5.1: ten days less the reach of the interval; downwards there is no limit."""
    value, std, rate, none = np.array([5.0]), np.array([0.01]), np.array([0.01]), np.array([0.0])
    low, high, open_end = np.array([4.9]), np.array([5.1]), np.array([np.inf])
    assert days_to_limit(value, std, rate, none, low, high, most_days=365) == [8]
    assert days_to_limit(value, std, rate, none, -open_end, high, most_days=365) == [8]
    assert days_to_limit(value, std, rate, none, low, open_end, most_days=365) == [365]
    assert days_to_limit(value, std, -rate, none, low, open_end, most_days=365) == [8]
