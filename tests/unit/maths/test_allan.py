"""Allan deviations against published tables, the definition and another package; noise terms on known records."""

from collections.abc import Callable

import allantools
import numpy as np
import pytest
from allan_simulation import kasdin, record

from bench.maths.allan import allan_deviation, confidence_limits, degrees_of_freedom
from bench.maths.allan_terms import (
    GYRO_TERMS,
    TERMS,
    UNITS,
    allan_variance_of,
    expected_deviation,
    fit_noise_terms,
    variance_covariance,
)
from bench.model.errors import FitError

NBS_9_RATES = np.array([892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0])


def thousand_points() -> np.ndarray:
    """The test suite of NIST SP 1065, section 12.4: a congruential generator anybody can run."""
    numbers = [1_234_567_890]
    while len(numbers) < 1000:
        numbers.append(16_807 * numbers[-1] % 2_147_483_647)
    return np.array(numbers) / 2_147_483_647


def by_definition(rate: np.ndarray, factor: int) -> float:
    """Averages and their differences one after the other; whatever meets a gap is left out."""
    n = rate.size
    means = np.array([rate[i : i + factor].mean() for i in range(n - factor + 1)])
    differences = np.array([means[i + factor] - means[i] for i in range(n - 2 * factor + 1)])
    return float(np.sqrt(np.nanmean(differences**2) / 2.0))


@pytest.mark.validates(
    "Allan deviation, nine rates",
    against="NIST SP 1065 table 30 (the 14-point suite of NBS)",
)
def test_nbs_14_point_suite() -> None:
    """NIST SP 1065 table 30 (nine rates, ten phases), averaging times 1 and 2."""
    np.testing.assert_allclose(allan_deviation(NBS_9_RATES, 1.0).deviation[:2], [91.22945, 85.95287], rtol=1e-7)


@pytest.mark.validates(
    "Allan deviation, 1,000 rates",
    against="NIST SP 1065 table 31",
)
def test_nbs_1000_point_suite() -> None:
    """NIST SP 1065 table 31, averaging times 1, 10 and 100."""
    rate = thousand_points()
    assert rate.mean() == pytest.approx(4.897745e-01, rel=1e-6)
    overlapping = allan_deviation(rate, 1.0, factors=[1, 10, 100])
    np.testing.assert_allclose(overlapping.deviation, [2.922319e-01, 9.159953e-02, 3.241343e-02], rtol=2e-7)
    assert overlapping.exponents.tolist() == [0, 0, 0]


def test_confidence_limits_are_those_of_chi_squared() -> None:
    low, high = confidence_limits(np.array([2.0, 2.0]), np.array([10.0, 146.0]))
    np.testing.assert_allclose(10.0 * (2.0 / np.array([high[0], low[0]])) ** 2, [3.24697, 20.48318], rtol=1e-5)
    assert low[1] > low[0]
    assert high[1] < high[0]


@pytest.mark.parametrize("gaps", [0, 7])
def test_definition_with_and_without_gaps(gaps: int) -> None:
    rng = np.random.default_rng(41)
    rate = 1e3 + rng.normal(size=120).cumsum()
    rate[rng.choice(120, gaps, replace=False)] = np.nan
    found = allan_deviation(rate, 0.5, factors=[1, 2, 3, 7, 16])
    expected = [by_definition(rate, int(factor)) for factor in found.factors]
    np.testing.assert_allclose(found.deviation, expected, rtol=1e-9)
    np.testing.assert_array_equal(found.tau_s, 0.5 * found.factors)


def test_a_gap_costs_differences_and_nothing_else() -> None:
    """A ramp has the same deviation with gaps; the interval is that of the differences left."""
    rate = 0.25 * np.arange(200.0)
    whole = allan_deviation(rate, 1.0, factors=[4])
    rate[[50, 51, 120]] = np.nan
    broken = allan_deviation(rate, 1.0, factors=[4])
    assert broken.deviation[0] == pytest.approx(whole.deviation[0], rel=1e-12)
    assert whole.deviation[0] == pytest.approx(0.25 * 4 / np.sqrt(2.0), rel=1e-12)
    assert whole.differences[0] - broken.differences[0] == 9 + 8
    assert broken.dof[0] == pytest.approx(degrees_of_freedom(4, int(broken.differences[0]), int(broken.exponents[0])))
    assert broken.dof[0] < whole.dof[0]


def test_a_large_mean_costs_no_digits() -> None:
    rate = np.round(np.random.default_rng(42).normal(size=500), 3)
    plain, lifted = (allan_deviation(rate + offset, 1.0).deviation for offset in (0.0, 2.0**20))
    np.testing.assert_allclose(lifted, plain, rtol=1e-6)


@pytest.mark.validates(
    "Allan deviation at every averaging time",
    against="the package allantools",
)
def test_the_same_as_another_package(record_property: Callable[[str, object], None]) -> None:
    rate = np.random.default_rng(43).normal(size=777)
    found = allan_deviation(rate, 0.1)
    tau_s, expected, _, _ = allantools.oadev(rate, rate=10.0, data_type="freq", taus=found.tau_s)
    np.testing.assert_allclose(tau_s, found.tau_s[: tau_s.size])
    record_property("obtained", f"{np.abs(found.deviation[: tau_s.size] / expected - 1).max():.0e}")
    np.testing.assert_allclose(found.deviation[: tau_s.size], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("rate", "count"), [(np.array([1.0]), "1 good samples of 1"), (np.array([1.0, np.nan] * 4), "4 good samples of 8")]
)
def test_a_record_without_a_difference_is_refused(rate: np.ndarray, count: str) -> None:
    with pytest.raises(FitError, match=f"B-FIT-031: .*{count}"):
        allan_deviation(rate, 1.0)


def classical_dof(exponent: int, n: int, m: int) -> float:
    """Howe, Allan and Barnes (1981) for n readings of the angle, as in NIST SP 1065 table 5."""
    if exponent == 2:
        return (n + 1) * (n - 2 * m) / (2 * (n - m))
    if exponent == 0:
        return (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
    if exponent == -1:
        return 5 * n**2 / (4 * m * (n + 3 * m))
    return (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / (n - 3) ** 2


@pytest.mark.validates(
    "degrees of freedom of an Allan deviation",
    against="the formulas of Howe, Allan and Barnes in NIST SP 1065 table 5",
)
@pytest.mark.parametrize(("exponent", "within"), [(2, 0.03), (0, 0.02), (-1, 0.10), (-2, 0.10)])
def test_degrees_of_freedom_against_the_classical_formulas(exponent: int, within: float) -> None:
    """They are approximations of a few percent; that of white noise of the rate is 146.177 where the sum is 146.072."""
    for m in (8, 10, 20, 50):
        expected = classical_dof(exponent, 1001, m)
        assert degrees_of_freedom(m, 1001 - 2 * m, exponent) == pytest.approx(expected, rel=within)
    assert classical_dof(0, 1001, 10) == pytest.approx(146.177, abs=5e-4)


@pytest.mark.parametrize("exponent", [2, 1, 0, -1, -2])
def test_degrees_of_freedom_against_another_implementation(exponent: int) -> None:
    """allantools smooths the angle over a sample, which matters for noise of the rate and short averages only."""
    for factor, within in ((1, 1e-9), (5, 1e-9), (20, 1e-9)) if exponent > 0 else ((50, 0.03), (100, 0.03)):
        differences = 1001 - 2 * factor
        expected = allantools.edf_greenhall(exponent, 2, factor, 1001, overlapping=True, modified=False)
        assert degrees_of_freedom(factor, differences, exponent) == pytest.approx(expected, rel=within)


@pytest.mark.parametrize("exponent", [2, 0, -1, -2])
def test_intervals_cover_and_the_noise_is_recognised(exponent: int) -> None:
    """300 records of known noise, seed 44. Measured with 2,000: 94 to 97 %, but 91 % at 64 for white noise."""
    rng = np.random.default_rng([44, exponent + 2])
    curves = [allan_deviation(kasdin(rng, 512, exponent), 1.0, factors=[1, 4, 16, 64]) for _ in range(300)]
    true = np.sqrt(np.mean([curve.deviation**2 for curve in curves], axis=0))
    inside = np.mean([(curve.low <= true) & (true <= curve.high) for curve in curves], axis=0)
    recognised = np.mean([curve.exponents == exponent for curve in curves])
    print(f"exponent {exponent}: coverage {inside}, recognised {recognised:.2f}")
    assert (inside > 0.88).all()
    assert (inside < 0.985).all()
    assert recognised > 0.55
    assert np.mean([np.abs(curve.exponents - exponent) <= 1 for curve in curves]) > 0.98


@pytest.mark.parametrize("name", TERMS)
def test_a_pure_term_has_its_slope_and_size(name: str) -> None:
    """The definition's variance against records of that noise alone."""
    rng = np.random.default_rng([51, TERMS.index(name)])
    curves = [allan_deviation(record(rng, 2048, 10.0, **{name: 2.0}), 10.0, factors=[8, 64]) for _ in range(60)]
    mean = np.mean([curve.deviation**2 for curve in curves], axis=0)
    np.testing.assert_allclose(mean, 4.0 * allan_variance_of(name, curves[0].tau_s), rtol=0.12)
    slope = np.log(allan_variance_of(name, np.array([20.0])) / allan_variance_of(name, np.array([10.0]))) / np.log(4.0)
    assert slope[0] == pytest.approx(np.linspace(-1.0, 1.0, 5)[TERMS.index(name)])


@pytest.mark.parametrize(("name", "exponent"), [("quantisation_noise", 2), ("white_noise", 0),
                                                ("bias_instability", -1), ("random_walk", -2)])  # fmt: skip
def test_covariance_has_the_degrees_of_freedom_of_the_power_law(name: str, exponent: int) -> None:
    """Two ways to the same number: 2 V^2 / Var V, and the sum of Greenhall and Riley."""
    factors = np.array([1, 2, 8, 50])
    differences = 1000 - 2 * factors + 1
    variance = allan_variance_of(name, 10.0 * factors)
    spread = variance_covariance(factors, differences, 10.0).matrix({name: 1.0}).diagonal()
    expected = [degrees_of_freedom(int(m), int(d), exponent) for m, d in zip(factors, differences, strict=True)]
    np.testing.assert_allclose(2.0 * variance**2 / spread, expected, rtol=5e-3)


@pytest.mark.validates(
    "expected Allan deviation of declared noise, and the uncertainty of terms fitted to it",
    against="200 simulated records of white noise and random walk",
)
def test_expected_deviation_is_the_mean_of_records(record_property: Callable[[str, object], None]) -> None:
    """Seed 53; the mean variance within 4 of its own deviations, the spread of free terms within a sixth."""
    rng = np.random.default_rng(53)
    declared = {"white_noise": 3e-9, "random_walk": 1e-11}
    curves = [allan_deviation(record(rng, 512, 10.0, **declared), 10.0) for _ in range(200)]
    expected = expected_deviation(declared, 512, 10.0)
    assert expected.factors.tolist() == curves[0].factors.tolist()
    assert expected.differences.tolist() == curves[0].differences.tolist()
    squares = np.array([curve.deviation**2 for curve in curves])
    off = np.abs(squares.mean(axis=0) - expected.deviation**2) / (squares.std(axis=0) / np.sqrt(200))
    assert off.max() < 4.0
    fitted, found = ([fit_noise_terms(curve, tuple(declared)) for curve in some] for some in ([expected], curves))
    ratios = {}
    for name, value in declared.items():
        assert fitted[0][name].coefficient == pytest.approx(value, rel=1e-6)
        spread = np.sqrt(np.mean([(terms[name].coefficient - value) ** 2 for terms in found]))
        ratios[name] = spread / fitted[0][name].std_uncertainty
    record_property("obtained", ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items()))
    assert list(ratios.values()) == pytest.approx([1.0, 1.0], abs=1.0 / 6.0)


def test_no_averaging_time_of_a_single_sample() -> None:
    with pytest.raises(FitError, match=r"B-FIT-031: .*1 samples leave no averaging time"):
        expected_deviation({"white_noise": 1.0}, 1, 10.0)


@pytest.mark.validates(
    "the five noise terms of IEEE Std 952, 95 % intervals",
    against="60 simulated records each of three mixtures of known noise",
)
@pytest.mark.parametrize(
    "truth",
    [
        {"quantisation_noise": 3e-8, "white_noise": 1e-8, "random_walk": 1e-10},
        {"quantisation_noise": 3e-8, "bias_instability": 2e-9},
        {"white_noise": 3e-9, "rate_ramp": 3e-13},
    ],
    ids="+".join,
)
def test_coefficients_are_found_with_honest_intervals(
    record_property: Callable[[str, object], None], truth: dict[str, float]
) -> None:
    """60 records of 2,048 samples, seed 53: intervals of what is there, limits of everything, few false finds."""
    rng = np.random.default_rng(53)
    fits = [fit_noise_terms(allan_deviation(record(rng, 2048, 10.0, **truth), 10.0)) for _ in range(60)]
    for name in TERMS:
        terms, true = [fit[name] for fit in fits], truth.get(name, 0.0)
        share = np.mean([abs(term.coefficient - true) < 1.96 * term.std_uncertainty for term in terms])
        below = np.mean([true <= term.upper_limit for term in terms])
        significant = np.mean([term.significant for term in terms])
        print(f"{name}: significant {significant:.2f}, covered {share:.3f}, below the limit {below:.3f}")
        assert below > 0.90
        if name in truth:
            assert significant > 0.8
            record_property("obtained", f"{name} {100 * share:.0f} %")
            assert share > 0.86
        else:
            assert significant < 0.13
    ratio = np.mean([fit.chi2 for fit in fits]) / np.mean([fit.dof for fit in fits])
    print(f"chi squared per degree of freedom {ratio:.2f}")
    assert ratio == pytest.approx(1.0, abs=0.3)


def test_contiguous_counts_show_their_quantisation() -> None:
    """Windows of 100 s of a converter with 1.25 uC per pulse: q / sqrt(12) and a slope of -1, not white noise."""
    rng = np.random.default_rng(54)
    charge_C = 4.037e-7 * 100.0 * np.arange(901) + 2e-9 / np.sqrt(2) * 10.0 * rng.standard_normal(901).cumsum()
    counts = np.floor(charge_C / 1.25e-6 + rng.uniform())
    found = fit_noise_terms(allan_deviation(1.25e-6 * np.diff(counts) / 100.0, 100.0))
    assert found["quantisation_noise"].coefficient == pytest.approx(1.25e-6 / np.sqrt(12), rel=0.1)
    assert [term.name for term in found.terms if term.significant] == ["quantisation_noise"]
    assert 2e-9 / np.sqrt(2) < found["white_noise"].upper_limit < 3e-8


def test_fewer_terms_can_be_asked_for() -> None:
    curve = allan_deviation(np.random.default_rng(56).normal(size=400), 1.0)
    fit = fit_noise_terms(curve, ("white_noise",))
    assert [term.name for term in fit.terms] == ["white_noise"]
    assert fit["white_noise"].coefficient == pytest.approx(1.0, abs=4 * fit["white_noise"].std_uncertainty)
    assert fit.fitted == pytest.approx(fit["white_noise"].coefficient / np.sqrt(curve.tau_s))
    assert set(UNITS) == set(GYRO_TERMS) == set(TERMS)


def test_a_beat_that_no_term_describes_is_told_by_chi_squared() -> None:
    """Stamps of a clock of 50 ns on an event that slides against it, by turns added and taken off: no noise at all.

    The weights of the terms that come nearest leave none of them; weights of nothing there are not.
    """
    half_ps, tick_ps = 1_251_035_236, 50_000
    time_ps = half_ps * np.arange(3200, dtype=np.int64) + 344_690_183
    error = np.where(np.arange(3200) % 2, -1.0, 1.0) * (time_ps // tick_ps * tick_ps - time_ps)
    step = np.diff(error)
    rate = (step[:-2:2] + step[2::2]) / 2.0 + step[1:-1:2]
    fit = fit_noise_terms(allan_deviation(rate, 1.0, factors=(5, 7, 10, 14, 20, 28, 40, 57, 80)), TERMS[:2])
    assert any(term.coefficient > 0.0 for term in fit.terms)
    assert fit.chi2 > 20.0 * fit.dof


def test_what_cannot_be_fitted_is_refused() -> None:
    curve = allan_deviation(np.random.default_rng(57).normal(size=12), 1.0)
    with pytest.raises(FitError, match=r"B-FIT-030: 5 noise terms .* 3 averaging times"):
        fit_noise_terms(curve)


def test_a_record_without_noise_is_refused() -> None:
    with pytest.raises(FitError, match=r"B-FIT-030: .*without noise"):
        fit_noise_terms(allan_deviation(np.tile([1.0, -1.0], 200), 1.0, factors=(2, 4, 8, 16, 32)))
