"""The least-squares core against numpy's and scipy's own solvers, and its refusals."""

from collections.abc import Callable

import numpy as np
import pytest
import scipy.optimize

from bench.maths.least_squares import solve
from bench.model.errors import FitError

RNG = np.random.default_rng(20)
NAMES = ("a", "b", "c")


def test_unit_weights_agree_with_numpy() -> None:
    design, readings = RNG.normal(size=(30, 3)), RNG.normal(size=30)
    fit = solve(design, readings, np.eye(30), NAMES)
    expected, chi2, *_ = np.linalg.lstsq(design, readings)
    np.testing.assert_allclose(fit.parameters, expected, rtol=1e-12)
    assert fit.chi2 == pytest.approx(chi2[0], rel=1e-12)
    assert fit.dof == 27


@pytest.mark.validates(
    "least squares with a full covariance, value and covariance",
    against="scipy.optimize.curve_fit",
)
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


def test_rank_deficiency_names_the_parameters_that_are_not_determined() -> None:
    column = RNG.normal(size=9)
    design = np.column_stack([column, RNG.normal(size=9), 2 * column])
    with pytest.raises(FitError, match="do not determine a, c: rank 2 of 3") as caught:
        solve(design, RNG.normal(size=9), np.eye(9), NAMES)
    assert caught.value.code == "B-FIT-001"


def test_fewer_rows_than_parameters_is_refused() -> None:
    with pytest.raises(FitError) as caught:
        solve(np.array([[1.0, 2.0, 3.0]]), np.array([1.0]), np.eye(1), NAMES)
    assert caught.value.code == "B-FIT-001"


def test_the_dmm_equation_as_printed_is_refused() -> None:
    """Equation (17): row 2 is row 1 negated, and C_N+ / C_P- is the same ratio at every level."""
    level = np.array([30e-6, 100e-6, 1e-3, 1e-2, 0.1, 0.2])
    half = 0.5 * np.column_stack([level, level])
    printed = np.concatenate([half, -half])
    with pytest.raises(FitError, match="K_N, K_P") as caught:
        solve(printed, np.concatenate([level, -level]), np.diag(np.concatenate([level, level]) ** 2), ("K_N", "K_P"))
    assert caught.value.code == "B-FIT-001"


@pytest.mark.parametrize("covariance", [np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan)])
def test_covariance_that_is_not_positive_definite_is_refused(covariance: np.ndarray) -> None:
    with pytest.raises(FitError) as caught:
        solve(np.ones((3, 1)), np.ones(3), covariance, ("a",))
    assert caught.value.code == "B-FIT-002"
