"""The least-squares core on certified problems, and that plain doubles lose the digits there."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from polynomial_columns import polynomial_columns
from strd_linear import PROBLEMS, Problem

import bench.maths.least_squares as core
from bench.maths.extended import Extended
from bench.maths.least_squares import solve
from bench.model.errors import FitError

DIGITS = 9.0
EVERY = pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)


def digits(found: np.ndarray | float, certified: tuple[float, ...] | float) -> float:
    """Log relative error: digits that agree, 15 at most; of the worst number. Against 0 the absolute error counts."""
    value, true = np.atleast_1d(found), np.atleast_1d(np.asarray(certified, float))
    error = np.abs(value - true) / np.where(true == 0.0, 1.0, np.abs(true))
    return float(np.min(-np.log10(np.clip(error, 1e-15, 1.0))))


def design_of(problem: Problem) -> np.ndarray | Extended:
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
    print(problem.name, found)
    record_property("obtained", f"{problem.name} {min(found.values()):.1f}")
    assert min(found.values()) >= DIGITS


@EVERY
def test_weights_of_any_size_leave_the_digits(problem: Problem) -> None:
    """Variances of 1e-18 and a full covariance that is the identity in other words: the same digits."""
    y = np.array(problem.y, float)
    fit = solve(design_of(problem), y, np.full(y.size, 1e-18) * np.eye(y.size), names(problem))
    assert digits(fit.parameters, problem.parameters) >= DIGITS
    assert digits(np.sqrt(fit.chi2 / fit.dof) * 1e-9, problem.residual_deviation) >= DIGITS


@EVERY
def test_certified_values_are_those_of_the_tables(problem: Problem) -> None:
    """Exact rational arithmetic on the decimal numbers of the tables, so that a misprint here would be seen."""
    y = [Fraction(repr(float(value))) for value in problem.y]
    x = [[Fraction(repr(float(v))) for v in np.atleast_1d(row)] for row in problem.x]
    rows = x if problem.order < 0 else [[t[0] ** k for k in range(problem.order + 1)] for t in x]
    columns = range(len(rows[0]))
    normal = [[sum(row[i] * row[j] for row in rows) for j in columns] for i in columns]
    inverse = rational_inverse(normal)
    moment = [sum(row[i] * value for row, value in zip(rows, y, strict=True)) for i in columns]
    exact = [sum(inverse[i][j] * moment[j] for j in columns) for i in columns]
    rest = [value - sum(b * v for b, v in zip(exact, row, strict=True)) for row, value in zip(rows, y, strict=True)]
    variance = sum(r * r for r in rest) / (len(y) - len(exact))
    assert digits(np.array([float(b) for b in exact]), problem.parameters) > 14.0
    assert digits(float(variance) ** 0.5, problem.residual_deviation) > 14.0
    deviations = np.array([float(variance * inverse[i][i]) ** 0.5 for i in columns])
    assert digits(deviations, problem.deviations) > 14.0


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


@pytest.mark.parametrize(("name", "at_most"), [("Filip", 1.0), ("Wampler5", 8.0), ("Wampler4", 9.0), ("Pontius", 8.0)])
def test_plain_doubles_lose_the_digits(name: str, at_most: float) -> None:
    """numpy.linalg.lstsq on the same columns. Measured: Filip 0, Wampler5 5.8, Pontius 6.3, Wampler4 7.8 digits."""
    problem = next(one for one in PROBLEMS if one.name == name)
    columns = np.vander(np.array(problem.x, float), problem.order + 1, increasing=True)
    found, *_ = np.linalg.lstsq(columns, np.array(problem.y, float), rcond=None)
    assert digits(found, problem.parameters) < at_most


def test_rounded_powers_are_refused_where_they_would_not_give_nine_digits() -> None:
    problem = next(one for one in PROBLEMS if one.name == "Filip")
    columns = np.vander(np.array(problem.x, float), 11, increasing=True)
    with pytest.raises(FitError) as caught:
        solve(columns, np.array(problem.y), np.eye(82), names(problem))
    assert caught.value.code == "B-FIT-001"


# --- the accurate path against the plain one -------------------------------------------------------------------------


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


@pytest.mark.validates(
    "correlated, ill-conditioned least squares",
    against="the normal equations in exact fractions",
)
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
    design = Extended(np.hstack((powers.high, other)), np.hstack((powers.low, 0 * other)))
    with pytest.raises(FitError, match="do not determine a, b, c, d, e: rank 5 of 6") as caught:
        solve(design, np.ones(20), np.eye(20), "abcdef")
    assert caught.value.code == "B-FIT-001"


# --- the arithmetic --------------------------------------------------------------------------------------------------


def exact(number: Extended) -> list[Fraction]:
    return [Fraction(h) + Fraction(low) for h, low in zip(number.high.ravel(), number.low.ravel(), strict=True)]


def test_arithmetic_keeps_thirty_digits() -> None:
    rng = np.random.default_rng(32)
    a, b = (
        Extended(values, values * rng.uniform(-1, 1, 500) * 2.0**-54)
        for values in rng.normal(size=(2, 500)) * 10.0 ** rng.uniform(-6, 6, (2, 500))
    )
    for found, true, size in (
        (a + b, [x + y for x, y in zip(exact(a), exact(b), strict=True)], np.abs(a.high) + np.abs(b.high)),
        (a - b, [x - y for x, y in zip(exact(a), exact(b), strict=True)], np.abs(a.high) + np.abs(b.high)),
        (a * b, [x * y for x, y in zip(exact(a), exact(b), strict=True)], np.abs(a.high * b.high)),
        (a / b, [x / y for x, y in zip(exact(a), exact(b), strict=True)], np.abs(a.high / b.high)),
        ((a * a).sqrt(), [abs(x) for x in exact(a)], np.abs(a.high)),
    ):
        error = [abs(float(f - t)) for f, t in zip(exact(found), true, strict=True)]
        assert (error <= 2.0**-100 * size).all()
    assert abs(float(exact(a.sum())[0] - sum(exact(a)))) < 2.0**-98 * np.abs(a.high).sum()


def test_powers_are_exact_to_thirty_digits() -> None:
    x = np.array([-8.781464495, 0.1, 3.0])
    found = polynomial_columns(x, 10)
    true = [Fraction(float(t)) ** k for t in x for k in range(11)]
    assert all(abs(f / t - 1) < Fraction(1, 10**30) for f, t in zip(exact(found), true, strict=True))
