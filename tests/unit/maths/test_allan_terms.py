"""The five noise terms on records whose coefficients are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from allan_simulation import record

from bench.maths.allan import allan_deviation, degrees_of_freedom
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

TRUTH = {"quantisation_noise": 3e-8, "white_noise": 3e-9, "bias_instability": 0.3e-9, "random_walk": 1e-11}


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
    with pytest.raises(FitError, match="1 samples leave no averaging time") as caught:
        expected_deviation({"white_noise": 1.0}, 1, 10.0)
    assert caught.value.code == "B-FIT-031"


def test_covariance_is_that_of_many_records() -> None:
    """2,000 records with four kinds of noise and a ramp, seed 52; each entry within 5 of its own deviations."""
    rng = np.random.default_rng(52)
    truth = {**TRUTH, "rate_ramp": 5e-14}
    factors = np.array([1, 2, 8, 40])
    curves = [allan_deviation(record(rng, 256, 10.0, **truth), 10.0, factors=factors.tolist()) for _ in range(2000)]
    seen = np.cov(np.array([curve.deviation**2 for curve in curves]).T)
    squares = {name: value**2 for name, value in truth.items()}
    expected = variance_covariance(factors, curves[0].differences, 10.0).matrix(squares)
    own = expected.diagonal()
    spread = np.sqrt((np.outer(own, own) + expected**2) / 2000) * 1.5  # variances are not quite normal
    print(np.round(seen / expected, 2))
    assert (np.abs(seen - expected) < 5 * spread).all()


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


def test_a_single_noise_is_all_there_is() -> None:
    rng = np.random.default_rng(55)
    fits = [fit_noise_terms(allan_deviation(record(rng, 900, 100.0, white_noise=1.0), 100.0)) for _ in range(40)]
    assert all(fit["white_noise"].significant for fit in fits)
    others = [fit[name].significant for fit in fits for name in TERMS if name != "white_noise"]
    print(f"terms found that are not there: {np.mean(others):.3f}")
    assert np.mean(others) < 0.08
    np.testing.assert_allclose(np.mean([fit["white_noise"].coefficient for fit in fits]), 1.0, rtol=0.05)


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


@pytest.mark.parametrize(("n", "modified", "text"), [(12, False, "5 noise terms .* 3 averaging times"),
                                                     (400, True, "modified Allan deviation")])  # fmt: skip
def test_what_cannot_be_fitted_is_refused(n: int, modified: bool, text: str) -> None:
    curve = allan_deviation(np.random.default_rng(57).normal(size=n), 1.0, modified=modified)
    with pytest.raises(FitError, match=text) as caught:
        fit_noise_terms(curve)
    assert caught.value.code == "B-FIT-030"


def test_a_record_without_noise_is_refused() -> None:
    with pytest.raises(FitError, match="without noise") as caught:
        fit_noise_terms(allan_deviation(np.tile([1.0, -1.0], 200), 1.0, factors=(2, 4, 8, 16, 32)))
    assert caught.value.code == "B-FIT-030"
