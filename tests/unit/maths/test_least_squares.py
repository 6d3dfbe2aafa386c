"""The least-squares core on certified problems, against numpy and scipy; clocks, polynomials, noise by other ways."""

from collections.abc import Callable
from decimal import localcontext
from fractions import Fraction

import numpy as np
import pytest
import scipy.optimize
from strd_linear import PROBLEMS, Problem, polynomial_columns

import bench.maths.least_squares as core
from bench.maths.least_squares import Exact, solve
from bench.maths.verdict import coverage_factor
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
)
from bench.systems.af_converter.group_fit import fit_temperature

RNG = np.random.default_rng(21)  # by seed 20 the differences of scipy.optimize put a covariance off by 2e-5
NAMES = ("a", "b", "c")


@pytest.mark.validates("least squares with a full covariance, value and covariance", against="scipy.optimize.curve_fit")
def test_full_covariance_agrees_with_scipy_curve_fit(record_property: Callable[[str, object], None]) -> None:
    design = RNG.normal(size=(25, 3)) * [1.0, 1e-6, 1e4]
    root = RNG.normal(size=(25, 25))
    covariance = root @ root.T + np.eye(25)
    readings = design @ [1.0, 2e6, 3e-4] + np.linalg.cholesky(covariance) @ RNG.normal(size=25)
    fit = solve(design, readings, covariance, NAMES)

    def model(_x: object, a: float, b: float, c: float) -> np.ndarray:
        return design @ [a, b * 1e6, c * 1e-4]

    best, spread = scipy.optimize.curve_fit(
        model, np.arange(25), readings, p0=[0, 0, 0], sigma=covariance, absolute_sigma=True
    )
    scale = np.array([1.0, 1e6, 1e-4])
    record_property("obtained", f"{np.abs(fit.parameters / (best * scale) - 1).max():.0e}, limit 1e-6")
    np.testing.assert_allclose(fit.parameters, best * scale, rtol=1e-6)
    np.testing.assert_allclose(fit.covariance, spread * np.outer(scale, scale), rtol=1e-5)


def test_operator_is_the_estimator_and_gives_its_covariance() -> None:
    design, covariance = RNG.normal(size=(12, 3)), np.diag(RNG.uniform(1, 9, 12))
    readings = RNG.normal(size=12)
    fit = solve(design, readings, covariance, NAMES)
    np.testing.assert_allclose(fit.operator @ readings, fit.parameters, rtol=1e-12)
    np.testing.assert_allclose(fit.operator @ covariance @ fit.operator.T, fit.covariance, rtol=1e-10)
    np.testing.assert_allclose(fit.operator @ design, np.eye(3), atol=1e-12)


def test_what_the_rows_do_not_determine_is_named() -> None:
    column = RNG.normal(size=9)
    design = np.column_stack([column, RNG.normal(size=9), 2 * column])
    with pytest.raises(FitError, match=r"B-FIT-001: .*do not determine a, c: rank 2 of 3"):
        solve(design, RNG.normal(size=9), np.eye(9), NAMES)
    with pytest.raises(FitError, match="B-FIT-001"):
        solve(np.array([[1.0, 2.0, 3.0]]), np.array([1.0]), np.eye(1), NAMES)
    # Equation (17): row 2 is row 1 negated, and C_N+ / C_P- is the same ratio at every level.
    level = np.array([30e-6, 100e-6, 1e-3, 1e-2, 0.1, 0.2])
    half = 0.5 * np.column_stack([level, level])
    printed = np.concatenate([half, -half])
    with pytest.raises(FitError, match=r"B-FIT-001: .*K_N, K_P"):
        solve(printed, np.concatenate([level, -level]), np.diag(np.concatenate([level, level]) ** 2), ("K_N", "K_P"))


@pytest.mark.parametrize("covariance", [np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan)])
def test_covariance_that_is_not_positive_definite_is_refused(covariance: np.ndarray) -> None:
    with pytest.raises(FitError, match="B-FIT-002"):
        solve(np.ones((3, 1)), np.ones(3), covariance, ("a",))


DIGITS = 9.0
EVERY = pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)


def digits(found: np.ndarray | float, certified: tuple[float, ...] | float) -> float:
    """Log relative error: digits that agree, 15 at most; of the worst number. Against 0 the absolute error counts."""
    value, true = np.atleast_1d(found), np.atleast_1d(np.asarray(certified, float))
    error = np.abs(value - true) / np.where(true == 0.0, 1.0, np.abs(true))
    return float(np.min(-np.log10(np.clip(error, 1e-15, 1.0))))


def design_of(problem: Problem) -> np.ndarray | Exact:
    x = np.array(problem.x, float)
    return x if problem.order < 0 else polynomial_columns(x, problem.order)


def names(problem: Problem) -> list[str]:
    return [f"b{k}" for k in range(len(problem.parameters))]


@pytest.mark.validates(
    "linear least squares: parameters, deviations, residual to at least 9 digits",
    against="certified values of the NIST StRD linear regression problems",
)
@EVERY
def test_at_least_nine_digits(record_property: Callable[[str, object], None], problem: Problem) -> None:
    """Measured: 12.7 digits of the parameters at worst (Norris), 13.9 of the deviations, 14.0 of the residual's."""
    y = np.array(problem.y, float)
    fit = solve(design_of(problem), y, np.eye(y.size), names(problem))
    residual_deviation = np.sqrt(fit.chi2 / fit.dof)
    found = {
        "parameters": digits(fit.parameters, problem.parameters),
        "deviations": digits(residual_deviation * np.sqrt(fit.covariance.diagonal()), problem.deviations),
        "residual": digits(residual_deviation, problem.residual_deviation),
    }
    record_property("obtained", f"{problem.name} {min(found.values()):.1f}")
    assert min(found.values()) >= DIGITS


@EVERY
def test_weights_of_any_size_leave_the_digits(problem: Problem) -> None:
    """Variances of 1e-18 and a full covariance that is the identity in other words: the same digits."""
    y = np.array(problem.y, float)
    fit = solve(design_of(problem), y, np.full(y.size, 1e-18) * np.eye(y.size), names(problem))
    assert digits(fit.parameters, problem.parameters) >= DIGITS
    assert digits(np.sqrt(fit.chi2 / fit.dof) * 1e-9, problem.residual_deviation) >= DIGITS


def rational_inverse(matrix: list[list[Fraction]]) -> list[list[Fraction]]:
    """Gauss-Jordan elimination."""
    size = len(matrix)
    work = [[*row, *(Fraction(int(i == j)) for j in range(size))] for i, row in enumerate(matrix)]
    for k in range(size):
        work[k] = [value / work[k][k] for value in work[k]]
        for i in range(size):
            if i != k:
                work[i] = [a - work[i][k] * b for a, b in zip(work[i], work[k], strict=True)]
    return [row[size:] for row in work]


def test_rounded_powers_are_refused_where_they_would_not_give_nine_digits() -> None:
    problem = next(one for one in PROBLEMS if one.name == "Filip")
    columns = np.vander(np.array(problem.x, float), 11, increasing=True)
    with pytest.raises(FitError, match="B-FIT-001"):
        solve(columns, np.array(problem.y), np.eye(82), names(problem))


@pytest.mark.parametrize("full", [True, False])
def test_both_paths_agree_where_both_are_good(monkeypatch: pytest.MonkeyPatch, full: bool) -> None:
    rng = np.random.default_rng(31)
    design, readings = rng.normal(size=(40, 4)) * [1.0, 1e-7, 1e5, 3.0], rng.normal(size=40)
    root = rng.normal(size=(40, 40))
    covariance = root @ root.T + 40.0 * np.eye(40) if full else np.diag(rng.uniform(0.5, 2.0, 40))
    plain = solve(design, readings, covariance, "abcd")
    monkeypatch.setattr(core, "_CONDITION_LIMIT", 1.0)
    exact = solve(design, readings, covariance, "abcd")
    for name in ("parameters", "covariance", "operator", "residual"):
        np.testing.assert_allclose(getattr(exact, name), getattr(plain, name), rtol=1e-10, atol=1e-300, err_msg=name)
        assert not np.array_equal(getattr(exact, name), getattr(plain, name)), "one path only"
    assert exact.chi2 == pytest.approx(plain.chi2, rel=1e-12)
    assert exact.dof == plain.dof == 36


@pytest.mark.validates("correlated, ill-conditioned least squares", against="the normal equations in exact fractions")
def test_a_correlated_ill_conditioned_problem_against_rational_arithmetic(
    record_property: Callable[[str, object], None],
) -> None:
    """Random walk covariance min(i, j): its inverse is known, so the normal equations are exact fractions."""
    x = np.arange(1.0, 16.0)
    y = np.round(np.sin(x), 6)
    fit = solve(polynomial_columns(x, 6), y, np.minimum.outer(x, x), list("abcdefg"))
    rows = [[Fraction(int(t)) ** k for k in range(7)] for t in x]
    steps = [
        [a - b for a, b in zip(row, before, strict=True)] for before, row in zip([[0] * 7, *rows], rows, strict=False)
    ]
    readings = [Fraction(repr(float(v))) for v in y]
    jumps = [b - a for a, b in zip([Fraction(0), *readings], readings, strict=False)]
    normal = [[sum(s[i] * s[j] for s in steps) for j in range(7)] for i in range(7)]
    inverse = rational_inverse(normal)
    moment = [sum(s[i] * v for s, v in zip(steps, jumps, strict=True)) for i in range(7)]
    exact = [float(sum(inverse[i][j] * moment[j] for j in range(7))) for i in range(7)]
    record_property("obtained", f"{digits(fit.parameters, tuple(exact)):.1f} digits, limit 12")
    assert digits(fit.parameters, tuple(exact)) > 12.0
    assert digits(fit.covariance.diagonal(), tuple(float(inverse[i][i]) for i in range(7))) > 12.0


def test_dependent_exact_columns_are_named() -> None:
    """Four distinct temperatures do not determine a polynomial of order 4; with a further column that is sound."""
    x = np.tile([1.1, 2.3, 3.7, 5.9], 5)
    powers = polynomial_columns(x, 4)
    other = np.random.default_rng(3).normal(size=(20, 1))
    design = np.hstack((powers, other))
    with pytest.raises(FitError, match=r"B-FIT-001: .*do not determine a, b, c, d, e: rank 5 of 6"):
        solve(design, np.ones(20), np.eye(20), "abcdef")


def exact(numbers: Exact) -> list[Fraction]:
    return [Fraction(number) for number in numbers]


def test_arithmetic_keeps_thirty_digits() -> None:
    rng = np.random.default_rng(32)
    doubles = rng.normal(size=(2, 500)) * 10.0 ** rng.uniform(-6, 6, (2, 500))
    with localcontext(core._DIGITS):
        a, b = core._exact(doubles) + core._exact(doubles * rng.uniform(-1, 1, (2, 500)) * 2.0**-54)
        computed = (a + b, a - b, a * b, a / b, np.sqrt(a * a))
        total = Fraction(a.sum())
    size, pairs = np.abs(doubles), list(zip(exact(a), exact(b), strict=True))
    for found, true, most in zip(
        computed,
        zip(*((x + y, x - y, x * y, x / y, abs(x)) for x, y in pairs), strict=True),
        (size.sum(axis=0), size.sum(axis=0), size[0] * size[1], size[0] / size[1], size[0]),
        strict=True,
    ):
        error = [abs(float(f - t)) for f, t in zip(exact(found), true, strict=True)]
        assert (error <= 2.0**-100 * most).all()
    assert abs(float(total - sum(exact(a)))) < 2.0**-98 * size[0].sum()


CONVERTER = Converter(k0_C=1.25e-6, af_clock_Hz=256e3, white_A_rtHz=2e-9, walk_A_rth=3e-10)


def readings(**changes: object) -> Readings:
    count = len(changes.get("level_A", [0.0]))
    values = {name: np.zeros(count) for name in Readings.__dataclass_fields__}
    values |= {"gate_s": np.full(count, 100.0), "af_count": np.full(count, 25.6e6), "time_s": 120.0 * np.arange(count)}
    return Readings(**(values | {name: np.asarray(value, dtype=float) for name, value in changes.items()}))


@pytest.mark.validates(
    "AF paper (1) and 4.1: clock ratio and master-clock error", against="closed form for clocks off by +50 and -30 ppm"
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


@pytest.mark.validates("coverage factor for 95 %", against="JCGM 100:2008 table G.2")
@pytest.mark.parametrize(("dof", "table"), [(1, 12.71), (2, 4.30), (10, 2.23), (50, 2.01), (float("inf"), 1.960)])
def test_coverage_factor_is_that_of_the_guides_table(dof: float, table: float) -> None:
    """JCGM 100:2008 table G.2, column 95 %."""
    assert coverage_factor(dof) == pytest.approx(table, abs=0.006)


def test_shared_errors_are_not_read_out_of_a_misfit() -> None:
    """An error shared to the last digits but three, and a cubic of 80 ppm: the constant stays where it is.

    What the parabola leaves over widens it, with two degrees of freedom: the root of RSS / 2 times the leverage.
    """
    at = np.array([-10.0, 5.0, 20.0, 35.0, 50.0])
    values = 0.01 * (at - 20.0) ** 3
    shared = (1.8 * (1 + 1e-6 * values))[:, None]
    fit = fit_temperature(at, values, 0.01 * np.eye(5), shared, 20.0)
    np.testing.assert_allclose(fit.coefficients, np.polynomial.polynomial.polyfit(at - 20.0, values, 2), atol=1e-9)
    own = np.sqrt(
        np.sum(fit.residual**2) / 2.0 * np.linalg.inv(np.vander(at - 20.0, 3).T @ np.vander(at - 20.0, 3))[2, 2]
    )
    assert fit.std_uncertainty(0) == pytest.approx(np.hypot(1.8, own), rel=0.01)
    assert (fit.misfit[0], fit.misfit_dof) == (pytest.approx(own), 2)


def test_two_temperatures_give_a_slope_one_gives_nothing_and_equal_ones_are_refused() -> None:
    two = fit_temperature(np.array([20.0, 35.0]), np.array([1.0, 4.0]), np.eye(2), np.zeros((2, 0)), 20.0)
    np.testing.assert_allclose(two.coefficients, [1.0, 0.2])
    assert fit_temperature(np.array([20.0]), np.array([1.0]), np.eye(1), np.zeros((1, 0)), 20.0) is None
    with pytest.raises(FitError, match="B-FIT-001"):
        fit_temperature(np.full(3, 20.0), np.zeros(3), np.eye(3), np.zeros((3, 0)), 20.0)


def test_bias_and_noise_of_a_gate_are_those_of_the_design() -> None:
    bias = open_input_bias(readings(p_count=[32.0], unit_temperature_degC=[21.0]), CONVERTER)
    assert bias.value_A == pytest.approx(400e-9)
    assert bias.unit_temperature_degC == 21.0
    assert bias.std_uncertainty_A == pytest.approx(np.hypot(5.103e-9, 0.1414e-9), rel=1e-3)
    parts = noise_parts(readings(n_count=[8e6], level_A=[0.1]), CONVERTER)
    assert np.sqrt(parts["quantisation of the counts"][0, 0]) == pytest.approx(5.10e-9, rel=1e-3)
    assert np.sqrt(parts["white noise of the converter"][0, 0]) == pytest.approx(0.1414e-9, rel=1e-3)


@pytest.mark.validates("covariance of gate averages of a random walk", against="20,000 simulated walks")
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
