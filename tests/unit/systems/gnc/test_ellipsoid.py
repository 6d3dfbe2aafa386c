"""Hard and soft iron: units whose errors are known, other algebra, and readings that determine nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import linalg, optimize

from bench.model.errors import FitError
from bench.systems.gnc.estimators.magnetometer.ellipsoid import fit_ellipsoid, sphere_coverage

IRON = np.array([[1.05, 0.03, -0.02], [0.01, 0.96, 0.04], [-0.03, 0.0, 1.02]])
OFFSET_gauss = np.array([0.05, -0.1, 0.2])
FIELD_gauss, NOISE_gauss = 0.5, 0.5e-3
TURN = np.linspace(0.0, 2.0 * np.pi, 1000)


def ring(axis: int, height: float = 0.0) -> np.ndarray:
    """Directions of a field turned about one axis."""
    flat = np.sqrt(1.0 - height**2)
    return np.roll(np.column_stack((flat * np.cos(TURN), flat * np.sin(TURN), 0 * TURN + height)), axis + 1, axis=1)


def everywhere(rng: np.random.Generator, count: int = 3000) -> np.ndarray:
    unit = rng.normal(size=(count, 3))
    return np.asarray(unit / np.linalg.norm(unit, axis=1)[:, None])


def readings(directions: np.ndarray, rng: np.random.Generator, noise: float = NOISE_gauss) -> np.ndarray:
    clean = FIELD_gauss * directions @ IRON.T + OFFSET_gauss
    return np.asarray(clean + rng.normal(0.0, noise, clean.shape)) if noise else clean


def test_without_noise_the_roots_are_those_of_the_iron() -> None:
    """|A^-1 (v - b)| is what determines the roots: the symmetric one is sqrtm, the triangular one Cholesky's."""
    fit = fit_ellipsoid(readings(everywhere(np.random.default_rng(81)), np.random.default_rng(0), 0.0), FIELD_gauss)
    square = np.linalg.inv(IRON @ IRON.T)
    np.testing.assert_allclose(fit.hard_iron, OFFSET_gauss, atol=1e-9)
    np.testing.assert_allclose(fit.symmetric, linalg.sqrtm(square), atol=1e-8)
    np.testing.assert_allclose(fit.triangular, np.linalg.cholesky(square).T, atol=1e-8)
    free = fit_ellipsoid(readings(everywhere(np.random.default_rng(81)), np.random.default_rng(0), 0.0))
    assert np.linalg.det(free.symmetric) == pytest.approx(1.0, rel=1e-9)
    assert free.norm == pytest.approx(FIELD_gauss * np.linalg.det(IRON) ** (1 / 3), rel=1e-8)


def test_same_minimum_as_a_search_over_every_foot() -> None:
    """Every reading with a direction of its own as unknown, minimised by scipy: the same ellipsoid."""
    rng = np.random.default_rng(82)
    field = readings(everywhere(rng, 30), rng, 2e-3)
    fit = fit_ellipsoid(field, FIELD_gauss)

    def rest(place: np.ndarray) -> np.ndarray:
        shape = np.zeros((3, 3))
        shape[np.triu_indices(3)] = place[3:9]
        unit = place[9:].reshape(-1, 3)
        unit = unit / np.linalg.norm(unit, axis=1)[:, None]
        return np.asarray((place[:3] + FIELD_gauss * np.linalg.solve(shape, unit.T).T - field).ravel())

    start = np.concatenate((field.mean(axis=0), np.eye(3)[np.triu_indices(3)], (field - field.mean(axis=0)).ravel()))
    start[9:] /= FIELD_gauss
    found = optimize.least_squares(rest, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    np.testing.assert_allclose(found[:3], fit.hard_iron, atol=1e-6)
    np.testing.assert_allclose(found[3:9], fit.triangular[np.triu_indices(3)], atol=1e-5)


@pytest.mark.validates(
    "hard and soft iron of a magnetometer: 95 % intervals",
    against="the errors that were put into 120 simulated sets of readings over the sphere",
)
def test_intervals_cover(record_property: Callable[[str, object], None]) -> None:
    rng = np.random.default_rng(83)
    inside, square = [], linalg.sqrtm(np.linalg.inv(IRON @ IRON.T))
    root = np.linalg.cholesky(np.linalg.inv(IRON @ IRON.T)).T
    upper = np.triu_indices(3)
    for _ in range(120):
        fit = fit_ellipsoid(readings(everywhere(rng, 400), rng), FIELD_gauss)
        scores = (
            (fit.hard_iron - OFFSET_gauss) / np.sqrt(np.diag(fit.hard_iron_covariance)),
            (fit.symmetric - square)[upper] / fit.symmetric_std[upper],
            (fit.triangular - root)[upper] / fit.triangular_std[upper],
        )
        inside.append(np.abs(np.concatenate(scores)) < 1.96)
    covered = float(np.mean(inside))
    record_property("obtained", f"{100 * covered:.1f} %, worst parameter {100 * np.mean(inside, axis=0).min():.1f} %")
    assert 0.91 < covered < 0.99


def test_corrected_readings_have_the_size_of_the_field() -> None:
    rng = np.random.default_rng(84)
    field = readings(everywhere(rng), rng)
    fit = fit_ellipsoid(field, FIELD_gauss)
    for triangular in (False, True):
        size = np.linalg.norm(fit.corrected(field, triangular=triangular), axis=1)
        assert size.std() == pytest.approx(NOISE_gauss, rel=0.1)
        assert size.mean() == pytest.approx(FIELD_gauss, rel=1e-4)
    assert np.linalg.norm(field, axis=1).std() > 100 * NOISE_gauss


def test_three_turns_about_the_axes_are_enough() -> None:
    rng = np.random.default_rng(85)
    fit = fit_ellipsoid(readings(np.vstack([ring(axis) for axis in range(3)]), rng), FIELD_gauss)
    assert fit.coverage.complete
    assert fit.coverage.sentences == ()
    assert np.abs(fit.hard_iron - OFFSET_gauss).max() < 1e-4
    assert fit.worst_std < 1e-3


def cap(rng: np.random.Generator, angle_deg: float) -> np.ndarray:
    directions = everywhere(rng, 6000)
    return np.asarray(directions[directions[:, 2] > np.cos(np.deg2rad(angle_deg))])


@pytest.mark.validates(
    "magnetometer readings that do not determine an ellipsoid are refused with the missing direction",
    against="turns about one axis, two turns, cones and caps of the sphere, whose missing direction is known",
)
@pytest.mark.parametrize(
    ("name", "directions", "missing"),
    [
        ("turn about z", ring(2), (0, 0, 1)),
        ("turn about x", ring(0), (1, 0, 0)),
        ("turn about y", ring(1), (0, 1, 0)),
        ("cone about z", ring(2, 0.6), (0, 0, 1)),
        ("turns about x and z", np.vstack((ring(0), ring(2))), (1, 0, 1)),
        ("two cones about z", np.vstack((ring(2, 0.3), ring(2, -0.3))), (0, 0, 1)),
        ("cap of 60 degrees", cap(np.random.default_rng(86), 60.0), (0, 0, 1)),
        ("cap of 20 degrees", cap(np.random.default_rng(86), 20.0), (0, 0, 1)),
    ],
)
@pytest.mark.parametrize("noise", [0.0, NOISE_gauss, 5e-3])
def test_partial_coverage_is_refused(
    name: str, directions: np.ndarray, missing: tuple[int, int, int], noise: float
) -> None:
    rng = np.random.default_rng(87)
    field = readings(directions, rng, noise)
    with pytest.raises(FitError, match="too little about the direction") as caught:
        fit_ellipsoid(field, FIELD_gauss)
    assert caught.value.code == "B-FIT-091"
    weakest = sphere_coverage(field).weakest
    if noise < 1e-3:
        assert abs(weakest @ np.array(missing)) / np.linalg.norm(missing) > 0.9, (name, weakest)


def test_half_a_sphere_is_fitted_and_flagged() -> None:
    rng = np.random.default_rng(88)
    fit = fit_ellipsoid(readings(cap(rng, 90.0), rng), FIELD_gauss)
    assert not fit.coverage.complete
    assert "nearest -z" in fit.coverage.sentences[0]
    assert "extrapolated" in fit.coverage.sentences[0]
    score = np.abs(fit.hard_iron - OFFSET_gauss) / np.sqrt(np.diag(fit.hard_iron_covariance))
    assert score.max() < 4.0


def test_few_noisy_readings_leave_the_size_uncertain() -> None:
    rng = np.random.default_rng(89)
    with pytest.raises(FitError, match=r"uncertain by [\d.]+ % \(limit 1 %\)") as caught:
        fit_ellipsoid(readings(everywhere(rng, 14), rng, 12e-3), FIELD_gauss)
    assert caught.value.code == "B-FIT-091"


@pytest.mark.parametrize("count", [0, 9, 50])
def test_too_few_readings(count: int) -> None:
    field = np.full((count, 3), 0.1) if count == 50 else everywhere(np.random.default_rng(90), count)
    with pytest.raises(FitError) as caught:
        fit_ellipsoid(field)
    assert caught.value.code == "B-FIT-090"
