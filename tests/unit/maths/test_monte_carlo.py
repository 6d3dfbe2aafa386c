"""Propagation against published examples and drawn numbers; variances, repeats, correlations, tail probabilities."""

import math
import statistics
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal, stats

from bench.maths import budget
from bench.maths.stein import needed, widening
from bench.maths.tests import SMALLEST, chi2_both, chi2_tail, f_tail, odd_one, of_many, t_both, trend
from bench.maths.variances import of_variances
from bench.maths.verdict import coverage_factor

ROOT3 = math.sqrt(3.0)
TRIALS = 1_000_000


def four_normal(generator: np.random.Generator, trials: int) -> np.ndarray:
    return generator.normal(size=(4, trials)).sum(axis=0)


def four_rectangular(generator: np.random.Generator, trials: int) -> np.ndarray:
    return generator.uniform(-ROOT3, ROOT3, (4, trials)).sum(axis=0)


def one_dominant(generator: np.random.Generator, trials: int) -> np.ndarray:
    return generator.uniform(-ROOT3, ROOT3, (3, trials)).sum(axis=0) + generator.uniform(
        -10 * ROOT3, 10 * ROOT3, trials
    )


def mass(generator: np.random.Generator, trials: int) -> np.ndarray:
    """Deviation of a weight from 100 g in mg, JCGM 101:2008 clause 9.3."""
    reference = generator.normal(100_000.0, 0.050, trials)
    balance = generator.normal(1.234, 0.020, trials)
    air = generator.uniform(1.10, 1.30, trials)
    weight, standard = generator.uniform(7000.0, 9000.0, trials), generator.uniform(7950.0, 8050.0, trials)
    return (reference + balance) * (1.0 + (air - 1.2) * (1.0 / weight - 1.0 / standard)) - 100_000.0


@pytest.mark.validates(
    "Monte Carlo propagation, additive model",
    against="JCGM 101:2008 9.2 and the exact interval",
)
@pytest.mark.parametrize(
    ("draw", "std", "half", "digits", "statement"),
    [
        (four_normal, 2.0, 3.92, 1, "agrees"),  # published: 2.00, 3.92
        (four_rectangular, 2.0, 2 * ROOT3 * (2 - (3 / 5) ** 0.25), 1, "agrees"),  # exact; published: 2.00, 3.88
        (one_dominant, 10.1, 17.0, 2, "differs"),  # published: 10.1, 17.0
    ],
    ids=["normal", "rectangular", "dominant"],
)
def test_additive_model(
    record_property: Callable[[str, object], None], draw, std: float, half: float, digits: int, statement: str
) -> None:
    """JCGM 101:2008 clause 9.2: the interval of the guide is 1.96 u; seed 1."""
    found = budget.propagate(draw, 1, TRIALS)
    print(f"u = {found.std:.4f}, [{found.low:.3f}, {found.high:.3f}]")
    record_property("obtained", f"u {found.std:.3f}, half {(found.high - found.low) / 2:.3f} ({half:.3f})")
    assert found.std == pytest.approx(std, rel=0.005)
    assert found.low == pytest.approx(-half, abs=5 * found.low_numerical_std)
    assert found.high == pytest.approx(half, abs=5 * found.high_numerical_std)
    assert budget.check_interval(0.0, std, 1.96 * std, found, digits).statement == statement


@pytest.mark.validates(
    "Monte Carlo propagation, non-linear model",
    against="JCGM 101:2008 9.3, calibration of a mass",
)
def test_mass_calibration(record_property: Callable[[str, object], None]) -> None:
    """Clause 9.3, published: 1.2341 mg, 0.0754 mg, [1.0834, 1.3825] mg; the first-order 0.0539 mg is refused."""
    found = budget.propagate(mass, 3, TRIALS)
    print(f"{found.mean:.4f}, {found.std:.4f}, [{found.low:.4f}, {found.high:.4f}]")
    record_property("obtained", f"u = {found.std:.4f} mg (0.0754), length {found.high - found.low:.4f} mg (0.2991)")
    assert found.mean == pytest.approx(1.2341, abs=3e-4)
    assert found.std == pytest.approx(0.0754, abs=2e-4)
    assert found.low == pytest.approx(1.0834, abs=5e-3)
    assert found.high - found.low == pytest.approx(1.3825 - 1.0834, abs=1e-3)
    assert budget.check_interval(1.2340, 0.0539, 1.96 * 0.0539, found).statement == "differs"


def test_shortest_interval_of_a_one_sided_distribution() -> None:
    """Exponential: from 0 to -ln 0.05, while the symmetric one would be [0.025, 3.69]."""
    low, high = budget.shortest_interval(np.random.default_rng(4).exponential(size=400_000))
    assert (low, high) == (pytest.approx(0.0, abs=1e-3), pytest.approx(-math.log(0.05), abs=0.03))


def test_the_same_seed_gives_the_same_numbers_and_nothing_gives_no_interval() -> None:
    assert budget.propagate(mass, 6, 50_000) == budget.propagate(mass, 6, 50_000)
    assert budget.propagate(mass, 6, 50_000) != budget.propagate(mass, 7, 50_000)
    with pytest.raises(ValueError, match="no digits"):
        budget.numerical_tolerance(0.0)
    with pytest.raises(ValueError, match="5 trials"):
        budget.shortest_interval(np.arange(5.0))


@pytest.mark.parametrize(
    ("std", "digits", "tolerance"),
    [(0.00035, 2, 0.5e-5), (2.0, 1, 0.5), (2.0, 2, 0.05), (10.4, 2, 0.5), (9.96, 2, 0.5), (0.0539, 2, 0.0005)],
)
def test_numerical_tolerance(std: float, digits: int, tolerance: float) -> None:
    """The first two are the examples of clause 7.9.2; 9.96 has the digits 10."""
    assert budget.numerical_tolerance(std, digits) == pytest.approx(tolerance, rel=1e-12)


def test_stated_scatter_of_the_ends_is_theirs() -> None:
    """Seeds 0 to 79: the ends scatter as stated, and half as much as those of the plain smallest length do."""
    found = [budget.propagate(four_normal, seed, 100_000) for seed in range(80)]
    scatter = np.std([one.low for one in found], ddof=1)
    stated = np.mean([one.low_numerical_std for one in found])
    plain = np.std([smallest_length(four_normal(np.random.default_rng(seed), 100_000))[0] for seed in range(80)])
    print(f"scatter {scatter:.4f}, stated {stated:.4f}, plain smallest length {plain:.4f}")
    assert stated == pytest.approx(scatter, rel=0.3)
    assert scatter < 0.65 * plain
    assert np.mean([one.low for one in found]) == pytest.approx(-3.92, abs=5 * scatter / math.sqrt(80))


def smallest_length(values: np.ndarray) -> tuple[float, float]:
    ordered = np.sort(values)
    held = int(0.95 * ordered.size + 0.5)
    first = int(np.argmin(ordered[held:] - ordered[:-held]))
    return float(ordered[first]), float(ordered[first + held])


@pytest.mark.parametrize(
    ("high", "noise", "statement"), [(2.0, 0.0, "agrees"), (2.2, 0.1, "not resolved"), (2.2, 0.01, "differs")]
)
def test_statement_of_a_check(high: float, noise: float, statement: str) -> None:
    found = budget.Distribution(0.0, 1.0, -2.0, high, 10_000, noise, noise)
    check = budget.check_interval(0.0, 1.0, 2.0, found)
    assert (check.tolerance, check.statement) == (0.05, statement)
    assert (check.low_difference, check.high_difference) == (0.0, pytest.approx(high - 2.0))


Array = NDArray[np.float64]
SEED = 11


def behind_a_floor(share: float) -> Callable[[Array], Array]:
    """A variance over what it leaves of a limit, of which it takes this share."""

    def of(variance: Array) -> Array:
        left = 1.0 - share * variance
        return np.where(left > 0.0, variance / np.where(left > 0.0, left, 1.0), np.inf)

    return of


@pytest.mark.parametrize("dof", [4.0, 14.0, 49.0, 18_791.0])
def test_one_variance(dof: float) -> None:
    """The standard deviation by its formula; the interval by the distribution function of the chi-square."""
    std, half = of_variances(lambda variance: 3.0 * variance, dof)
    assert std == pytest.approx(3.0 * np.sqrt(2.0 / dof), rel=0.01)
    ends = (dof / (1.0 + half / 3.0), dof / (1.0 - half / 3.0) if half < 3.0 else np.inf)
    assert stats.chi2.cdf(ends[1], dof) - stats.chi2.cdf(ends[0], dof) == pytest.approx(0.95, abs=1.5e-3)
    if dof < 50.0:
        by_student = stats.t.ppf(0.975, dof) * std  # what was stated
        ends = (dof / (1.0 + by_student / 3.0), dof / max(1.0 - by_student / 3.0, 1e-9))
        assert stats.chi2.cdf(ends[1], dof) - stats.chi2.cdf(ends[0], dof) < 0.94


@pytest.mark.parametrize(("share", "dof"), [(0.16, 49.0), (0.32, 49.0), (0.16, 17.0)])
def test_intervals_behind_a_floor_hold_in_95_per_cent(share: float, dof: float) -> None:
    rng, count, function = np.random.default_rng(SEED), 1000, behind_a_floor(share)
    estimates = rng.chisquare(dof, count) / dof
    halves = [of_variances(lambda factor, own=own: function(own * factor), dof)[1] for own in estimates]
    held = int(np.sum(np.abs(function(estimates) - function(np.ones(1))) <= halves))
    print(f"seed {SEED}, share {share}, dof {dof:g}: {held} of {count}")
    low, high = stats.binom.interval(0.999, count, 0.95)
    assert low <= held <= high
    std, _ = of_variances(function, dof)
    assert std == pytest.approx(np.std(function(rng.chisquare(dof, 400_000) / dof)), rel=0.02)


def test_two_variances() -> None:
    rng = np.random.default_rng(SEED)
    first, second = (rng.chisquare(dof, 400_000) / dof for dof in (20.0, 8.0))
    std, half = of_variances(lambda one, other: 2.0 * one + other, 20.0, 8.0)
    assert std == pytest.approx(np.std(2.0 * first + second), rel=0.01)
    assert half == pytest.approx(np.quantile(np.abs(2.0 / first + 1.0 / second - 3.0), 0.95), rel=0.01)
    assert of_variances(lambda one, other: 2.0 * one + other, np.inf, 8.0) == pytest.approx(
        of_variances(lambda other: 2.0 + other, 8.0)
    )


def test_without_a_value_nothing_is_known() -> None:
    assert of_variances(behind_a_floor(1.5), 20.0) == (np.inf, np.inf)  # no value
    assert of_variances(behind_a_floor(0.5), 20.0) == (np.inf, np.inf)  # half of a percent of estimates have none
    assert of_variances(lambda known: known, np.inf) == (0.0, 0.0)


# Grubbs, Technometrics 11 (1969), table 1: two-sided 5 %, (x - mean) / s.
GRUBBS_5 = {5: 1.715, 8: 2.126, 10: 2.290, 15: 2.549, 20: 2.709}


@pytest.mark.validates("odd reading among n", against="Grubbs, Technometrics 11 (1969), table 1, 5 %")
@pytest.mark.parametrize(("n", "critical"), GRUBBS_5.items())
def test_grubbs(n: int, critical: float) -> None:
    """A reading exactly at the critical value of the table is odd with 5 %."""
    others = stats.norm.ppf((np.arange(n - 1) + 0.5) / (n - 1))
    low, high = 1.0, 50.0
    for _ in range(100):
        middle = (low + high) / 2.0
        readings = np.append(others, middle)
        size = (middle - readings.mean()) / readings.std(ddof=1)
        low, high = (middle, high) if size < critical else (low, middle)
    assert odd_one(np.append(others, low)).probability == pytest.approx(0.05, rel=0.01)


def test_trend_is_the_slope_of_a_line() -> None:
    t_s = np.array([0.0, 1.0, 2.5, 3.0, 6.0, 7.0])
    readings = 5.0 + 0.002 * t_s + np.array([1.0, -2.0, 0.5, 1.5, -1.0, 0.2]) * 1e-3
    known, found = stats.linregress(t_s, readings), trend(t_s, readings)
    assert found.probability == pytest.approx(known.pvalue, rel=1e-9)
    assert found.size == pytest.approx(7.0 * known.slope, rel=1e-9)


def test_what_few_or_equal_readings_say() -> None:
    three, alike = np.array([1.0, 2.0, 3.0]), np.full(8, 5.0)
    assert trend(three, three) is None
    assert odd_one(three) is None
    assert trend(np.arange(8.0), alike) is None
    assert odd_one(alike) is None
    found = odd_one(np.array([5.0, 5.0, 5.0, 5.0, 5.1]))
    assert found.probability == 0.0
    assert found.size == pytest.approx(-0.02)


N, CAMPAIGNS = 2000, 300


@pytest.mark.validates("mean of correlated readings", against="autoregressive processes of first order")
def test_autoregressive_processes(record_property: Callable[[str, object], None]) -> None:
    """n (1 - a) / (1 + a) of n readings count; 95 % intervals of the mean hold the truth, which is zero."""
    shares, inside = [], []
    for correlation in (0.0, 0.5, 0.9):
        counts, covered = _campaigns(correlation)
        shares.append(counts * (1.0 + correlation) / (1.0 - correlation) / N)
        inside.append(covered)
    record_property("obtained", f"{100.0 * min(inside):.1f} % to {100.0 * max(inside):.1f} % covered")
    assert shares == pytest.approx([1.0, 1.0, 1.0], abs=0.06)
    assert 0.92 <= min(inside) <= max(inside) <= 0.98


def _campaigns(correlation: float) -> tuple[float, float]:
    """Return the mean count of independent readings, and the share of intervals that hold the truth."""
    rng = np.random.default_rng(int(100 * correlation))
    counts, inside = [], 0
    for _ in range(CAMPAIGNS):
        readings = signal.lfilter([1.0], [1.0, -correlation], rng.normal(size=N + 500))[500:]
        counts.append(budget.independent_count(readings))
        std = readings.std(ddof=1) * np.sqrt((N - 1) / N / (counts[-1] - 1.0))
        inside += abs(readings.mean()) <= coverage_factor(counts[-1] - 1.0) * std
    return float(np.mean(counts)), inside / CAMPAIGNS


def test_readings_are_worth_no_more_than_they_are() -> None:
    assert budget.independent_count(np.array([1.0, -1.0] * 20)) == 40.0
    assert 2.0 <= budget.independent_count(np.arange(1000.0)) < 4.0
    assert budget.independent_count(np.full(7, 3.2)) == 7.0
    assert budget.independent_count(np.array([1.0])) == 1.0


@pytest.mark.validates("widening of a 95 % interval by few degrees of freedom", against="scipy.stats.t")
@pytest.mark.parametrize("dof", [9, 10, 14, 29, 99, 999])
def test_the_widening_is_that_of_students_t(dof: int) -> None:
    assert widening(dof) == pytest.approx(stats.t.ppf(0.975, dof) / stats.norm.ppf(0.975), rel=1e-5)


@pytest.mark.parametrize("target", [0.05, 0.2, 1.0])
def test_it_is_the_least_number_whose_interval_is_no_wider(target: float) -> None:
    """The interval of n readings is t s / sqrt(n), with the t and the s of the first ten, whatever n is."""
    first = np.random.default_rng(4).normal(3.0, 0.7, 10).tolist()
    count = needed(first, target)
    half_width = stats.t.ppf(0.975, 9) * statistics.stdev(first)
    allowed = stats.norm.ppf(0.975) * target
    assert half_width / math.sqrt(count) <= allowed * (1 + 1e-5)
    assert count == 10 or half_width / math.sqrt(count - 1) > allowed * (1 - 1e-5)


def test_readings_without_scatter_need_no_more() -> None:
    assert needed([1.0] * 12, 1e-9) == 12


@pytest.mark.parametrize(
    ("probability", "due"),
    [  # NIST/SEMATECH e-Handbook of Statistical Methods, sections 1.3.6.7.1 to 1.3.6.7.4
        (chi2_tail(3.841, 1), 0.05),
        (chi2_tail(18.307, 10), 0.05),
        (chi2_both(20.483, 10), 0.05),
        (chi2_both(3.247, 10), 0.05),
        (f_tail(4.965, 1, 10), 0.05),
        (f_tail(10.044, 1, 10), 0.01),
        (f_tail(18.307 / 10, 10, math.inf), 0.05),
        (t_both(2.228, 10), 0.05),
        (t_both(-2.228, 10), 0.05),
        (t_both(1.95996), 0.05),
    ],
)
def test_critical_values_of_the_tables(probability: float, due: float) -> None:
    assert probability == pytest.approx(due, rel=1e-3)


def test_a_probability_is_never_a_certainty_and_never_above_one() -> None:
    assert chi2_tail(1e6, 3) == f_tail(1e300, 900, 900) == t_both(1e6) == SMALLEST
    assert chi2_tail(0.0, 0) == chi2_tail(5.0, 0) == 1.0
    assert of_many(0.3, 4) == 1.0
    assert of_many(0.1, 4) == pytest.approx(0.4)


def test_arrays_are_judged_element_by_element() -> None:
    assert np.allclose(t_both(np.array([1.95996, 2.228]), np.array([math.inf, 10.0])), 0.05, rtol=1e-3)
    assert np.allclose(f_tail(np.array([4.965, 1.8307]), np.array([1, 10]), np.array([10, math.inf])), 0.05, rtol=1e-3)
