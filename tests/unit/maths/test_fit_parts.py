"""Clocks, coverage, verdicts, temperature polynomials, bias and the noise model, each against an independent answer."""

import numpy as np
import pytest

from bench.maths.verdict import coverage_factor, verdict
from bench.model.errors import FitError
from bench.systems.af_converter.estimators.readings import (
    Converter,
    RangeSpecification,
    Readings,
    calibrator_effects,
    clock_ratio,
    master_clock_error,
    noise_parts,
    open_input_bias,
    specification,
)
from bench.systems.af_converter.estimators.temperature import fit_temperature

CONVERTER = Converter(k0_C=1.25e-6, af_clock_Hz=256e3, white_A_rtHz=2e-9, walk_A_rth=3e-10)


def readings(**changes: object) -> Readings:
    count = len(changes.get("level_A", [0.0]))
    values = {name: np.zeros(count) for name in Readings.__dataclass_fields__}
    values |= {"gate_s": np.full(count, 100.0), "af_count": np.full(count, 25.6e6), "time_s": 120.0 * np.arange(count)}
    return Readings(**(values | {name: np.asarray(value, dtype=float) for name, value in changes.items()}))


@pytest.mark.validates(
    "AF paper (1) and 4.1: clock ratio and master-clock error",
    against="closed form for clocks off by +50 and -30 ppm",
)
def test_clock_ratio_and_master_error_from_clocks_of_known_error() -> None:
    af, master = 50e-6, -30e-6
    gate_s = np.array([100.0])
    true_s = gate_s / (1 + master)
    ratio = clock_ratio(256e3 * (1 + af) * true_s, gate_s, 256e3)
    assert ratio[0] == pytest.approx((1 + master) / (1 + af), rel=1e-14)
    assert master_clock_error(1e7 * true_s, gate_s, 1e7)[0] == pytest.approx(master, rel=1e-9)


def test_clock_without_pulses_is_not_a_number() -> None:
    assert np.isnan(clock_ratio(np.zeros(1), np.ones(1), 256e3)).all()
    assert np.isnan(master_clock_error(np.zeros(1), np.ones(1), 1e7)).all()


@pytest.mark.validates(
    "coverage factor for 95 %",
    against="JCGM 100:2008 table G.2",
)
@pytest.mark.parametrize(("dof", "table"), [(1, 12.71), (2, 4.30), (10, 2.23), (50, 2.01), (float("inf"), 1.960)])
def test_coverage_factor_is_that_of_the_guides_table(dof: float, table: float) -> None:
    """JCGM 100:2008 table G.2, column 95 %."""
    assert coverage_factor(dof) == pytest.approx(table, abs=0.006)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (79.4, "pass"),
        (-79.4, "pass"),
        (79.6, "conditional_pass"),
        (-100.0, "conditional_pass"),
        (100.1, "conditional_fail"),
        (120.6, "fail"),
        (float("nan"), "fail"),
    ],
)
def test_verdict_with_guard_band(value: float, expected: str) -> None:
    """Design figure: U = 20.5 ppm on a limit of 100 ppm accepts up to 79.5 ppm."""
    assert verdict(value, 20.5, 100.0) == expected


def test_no_limit_no_verdict() -> None:
    assert verdict(1e9, 0.0, None) == "none"


def test_temperature_polynomial_recovers_a_parabola_and_its_common_part() -> None:
    at = np.array([-10.4, 5.0, 20.0, 35.0, 50.0])
    values = 400.0 + 8.0 * (at - 20.0) - 0.03 * (at - 20.0) ** 2
    fit = fit_temperature(at, values, np.eye(5), np.full((5, 1), 10.0), 20.0)
    assert fit is not None
    np.testing.assert_allclose(fit.coefficients, [400.0, 8.0, -0.03], rtol=1e-9)
    alone = fit_temperature(at, values, np.eye(5), np.zeros((5, 0)), 20.0)
    assert alone is not None
    np.testing.assert_allclose(fit.covariance - alone.covariance, np.diag([100.0, 0.0, 0.0]), atol=1e-9)
    assert fit.slope(50.0) == pytest.approx(8.0 - 0.06 * 30.0, rel=1e-9)
    reference = np.polynomial.polynomial.polyfit(at - 20.0, values, 2)
    np.testing.assert_allclose(fit.coefficients, reference, rtol=1e-9)


def test_shared_errors_are_not_read_out_of_a_misfit() -> None:
    """An error shared to the last digits but three, and a cubic of 80 ppm: the constant stays where it is."""
    at = np.array([-10.0, 5.0, 20.0, 35.0, 50.0])
    values = 0.01 * (at - 20.0) ** 3
    shared = (1.8 * (1 + 1e-6 * values))[:, None]
    fit = fit_temperature(at, values, 0.01 * np.eye(5), shared, 20.0)
    assert fit is not None
    np.testing.assert_allclose(fit.coefficients, np.polynomial.polynomial.polyfit(at - 20.0, values, 2), atol=1e-9)
    assert fit.std_uncertainty(0) == pytest.approx(1.8, rel=0.01)


def test_two_temperatures_give_a_slope_one_gives_nothing() -> None:
    two = fit_temperature(np.array([20.0, 35.0]), np.array([1.0, 4.0]), np.eye(2), np.zeros((2, 0)), 20.0)
    assert two is not None
    np.testing.assert_allclose(two.coefficients, [1.0, 0.2])
    assert fit_temperature(np.array([20.0]), np.array([1.0]), np.eye(1), np.zeros((1, 0)), 20.0) is None


def test_equal_temperatures_are_refused() -> None:
    with pytest.raises(FitError) as caught:
        fit_temperature(np.full(3, 20.0), np.zeros(3), np.eye(3), np.zeros((3, 0)), 20.0)
    assert caught.value.code == "B-FIT-001"


def test_bias_is_the_negative_of_the_open_reading() -> None:
    bias = open_input_bias(readings(p_count=[32.0], unit_temperature_degC=[21.0]), CONVERTER)
    assert bias.value_A == pytest.approx(400e-9)
    assert bias.unit_temperature_degC == 21.0
    assert bias.std_uncertainty_A == pytest.approx(np.hypot(5.103e-9, 0.1414e-9), rel=1e-3)


def test_noise_of_a_gyro_gate_is_the_design_figure() -> None:
    parts = noise_parts(readings(n_count=[8e6], level_A=[0.1]), CONVERTER)
    assert np.sqrt(parts["quantisation of the counts"][0, 0]) == pytest.approx(5.10e-9, rel=1e-3)
    assert np.sqrt(parts["white noise of the converter"][0, 0]) == pytest.approx(0.1414e-9, rel=1e-3)


@pytest.mark.validates(
    "covariance of gate averages of a random walk",
    against="20,000 simulated walks",
)
def test_random_walk_covariance_against_simulated_walks() -> None:
    rng = np.random.default_rng(4)
    seconds, steps = 12, 100
    walks = np.cumsum(rng.normal(0, 3e-10 / np.sqrt(3600 * steps), (20_000, seconds * steps)), axis=1)
    means = np.stack([walks[:, a * steps : (a + 4) * steps].mean(axis=1) for a in (0, 4, 8)])
    rows = readings(level_A=np.zeros(3), gate_s=np.full(3, 4.0), time_s=[2.0, 6.0, 10.0])
    model = noise_parts(rows, CONVERTER)["random walk of the bias"]
    np.testing.assert_allclose(np.cov(means), model, rtol=0.06)


def test_effects_change_sign_with_the_switch_and_zero_rows_have_no_linearity() -> None:
    standard = {2.2e-4: RangeSpecification(2e-5, 6e-9)}
    rows = readings(level_A=[0.0, 0.0, 1e-4, 1e-4], polarity=[1, -1, 1, -1], range_A=np.full(4, 2.2e-4))
    effects = calibrator_effects(rows, standard)
    assert effects.labels == ("offset of the range 0.00022 A", "linearity of the range 0.00022 A at 0.0001 A")
    np.testing.assert_allclose(effects.matrix.T * 1e9, [[3, -3, 3, -3], [0, 0, 3, -3]])


def test_range_missing_in_the_register_is_named() -> None:
    with pytest.raises(FitError, match=r"range 0\.022 A") as caught:
        specification({2.2e-4: RangeSpecification(2e-5, 6e-9)}, 2.2e-2)
    assert caught.value.code == "B-FIT-003"
