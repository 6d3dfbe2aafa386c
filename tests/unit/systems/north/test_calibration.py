"""Constants of both lock-ins against a fit of the printed equations by another program, one constant at a time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize
from single_north import single_north

from bench.model.errors import FitError
from bench.systems.north.estimators.calibration import IndexCalibration, calibrate_index
from bench.systems.north.estimators.eight_samples import eight_sample_north
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.estimators.quadrant import quadrant_north

PHI_deg = 33.0
TRUE = (1.6, 1.5, 0.3, 0.7, -2.0, -0.2)  # f1, f2 deg, f3, f4, f5 deg, f6
STEPS_deg = np.arange(4) * 90.0


def model(_: object, f1: float, f2: float, f3: float, f4: float, f5: float, f6: float) -> np.ndarray:
    """(13a-d) and (14a-d) at the known phase."""
    phi = np.deg2rad(PHI_deg + STEPS_deg)
    return np.concatenate((f1 * np.sin(phi + np.deg2rad(f2)) + f3, f4 * np.cos(phi + np.deg2rad(f5)) + f6))


@pytest.fixture(scope="module")
def noisy() -> np.ndarray:
    return model(None, *TRUE) + 0.01 * np.random.default_rng(81).normal(size=8)


def known(samples: np.ndarray) -> IndexCalibration:
    return calibrate_index(samples[:4], samples[4:], PHI_deg)


def test_every_constant_and_its_uncertainty_are_those_of_a_non_linear_fit(noisy: np.ndarray) -> None:
    values, covariance = optimize.curve_fit(model, np.arange(8.0), noisy, p0=TRUE)
    found = known(noisy)
    ours = (found.f1, found.f2_deg, found.f3, found.f4, found.f5_deg, found.f6)
    np.testing.assert_allclose(ours, values, rtol=1e-5)
    np.testing.assert_allclose(found.covariance, covariance[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], rtol=1e-4, atol=1e-8)
    assert found.dof == 2.0
    np.testing.assert_allclose(found.gains, np.array([1.6, 0.7]) / np.sqrt(1.12), rtol=0.02)


@pytest.mark.parametrize("method", ["least_squares", "quadrant", "literal", "single"])
def test_what_the_calibration_adds_is_what_a_wrong_placement_does(noisy: np.ndarray, method: str) -> None:
    """Each placement is put wrong by its own standard uncertainty, and the azimuths are found again."""
    found = known(noisy)
    exact = model(None, *TRUE)
    parts = []
    for place, std in ((1, found.covariance[1, 1]), (4, found.covariance[3, 3])):
        wrong = np.array(TRUE)
        wrong[place] += np.sqrt(std)
        phi_deg = azimuth(method, exact, wrong) - azimuth(method, exact, np.array(TRUE))
        parts.append(float(wrapped_deg(phi_deg)))
    assert found.std_deg(method) == pytest.approx(np.hypot(*parts), rel=1e-3)
    assert found.covariance[3, 3] > 4.0 * found.covariance[1, 1]  # so that the two cannot stand for each other


def azimuth(method: str, samples: np.ndarray, constants: np.ndarray) -> float:
    f1, f2_deg, _, f4, f5_deg, _ = constants
    u1, u2 = samples[:4], samples[4:]
    if method == "least_squares":
        gains = (f1 / np.sqrt(f1 * f4), f4 / np.sqrt(f1 * f4))
        return float(eight_sample_north(u1, u2, gains=gains, f2_deg=f2_deg, f5_deg=f5_deg).phi_deg)
    if method == "single":
        return float(single_north(u1, u2, f2_deg=f2_deg).phi_deg)
    return float(quadrant_north(u1, u2, f5_deg=f5_deg).phi_deg)


def test_noise_and_uncertainty_with_known_constants(noisy: np.ndarray) -> None:
    """Noise: what numpy's least squares with these gains and placements leave. Uncertainty: by steps of each sample."""
    f1, f2, _, f4, f5, _ = np.array(TRUE)
    gains = (f1 / np.sqrt(f1 * f4), f4 / np.sqrt(f1 * f4))

    def phi_deg(samples: np.ndarray) -> float:
        return float(eight_sample_north(samples[:4], samples[4:], gains=gains, f2_deg=f2, f5_deg=f5).phi_deg)

    at_1, at_2, ones = np.deg2rad(STEPS_deg + f2), np.deg2rad(STEPS_deg + f5), np.ones(4)
    design = np.block([
        [gains[0] * np.column_stack((np.sin(at_1), np.cos(at_1))), np.outer(ones, (1.0, 0.0))],
        [gains[1] * np.column_stack((np.cos(at_2), -np.sin(at_2))), np.outer(ones, (0.0, 1.0))],
    ])  # fmt: skip
    left = np.linalg.lstsq(design, noisy)[1]
    found = eight_sample_north(noisy[:4], noisy[4:], gains=gains, f2_deg=f2, f5_deg=f5)
    assert found.noise == pytest.approx(np.sqrt(left[0] / 4.0), rel=1e-9)
    steps = [(phi_deg(noisy + 1e-5 * one) - phi_deg(noisy - 1e-5 * one)) / 2e-5 for one in np.eye(8)]
    assert found.std_deg == pytest.approx(float(found.noise) * np.linalg.norm(steps), rel=0.02)


@pytest.mark.parametrize("silent", [slice(0, 4), slice(4, 8)])
def test_one_lock_in_without_a_signal_is_no_calibration(noisy: np.ndarray, silent: slice) -> None:
    noisy = noisy.copy()
    noisy[silent] = 0.0
    with pytest.raises(FitError, match="B-FIT-113"):
        known(noisy)
