"""North from raw samples: another fit, gaps, noise that is not white, table that turns either way, what is refused."""

from __future__ import annotations

import north_simulation as sim
import numpy as np
import pytest
from scipy import optimize, signal

from bench.model.errors import FitError
from bench.systems.north.estimators.likelihood import likelihood_north
from bench.systems.north.estimators.phasors import heading_deg, wrapped_deg

FS = 100
T = (np.arange(20 * FS) + 0.5) / FS
THETA = 360.0 * T


def test_the_same_as_a_non_linear_fit_of_amplitude_and_phase() -> None:
    rng = np.random.default_rng(31)
    theta = np.deg2rad(THETA + 3.0 * np.sin(2 * np.pi * 0.3 * T))
    u = 1.3 * np.sin(theta + 2.5) + 0.2 + 0.1 * np.sin(2 * theta + 0.4) + 0.3 * rng.normal(size=T.size)

    def model(angle: np.ndarray, size: float, phi: float, offset: float, second: float, at: float) -> np.ndarray:
        return size * np.sin(angle + phi) + offset + second * np.sin(2 * angle + at)

    values, covariance = optimize.curve_fit(model, theta, u, p0=(1.0, 2.4, 0.0, 0.1, 0.5))
    found = likelihood_north(u, np.mod(np.rad2deg(theta), 360.0), harmonics=(2,))
    assert found.phi_deg == pytest.approx(np.rad2deg(values[1]), abs=1e-5)
    assert found.std_deg == pytest.approx(np.rad2deg(np.sqrt(covariance[1, 1])), rel=1e-4)
    assert found.amplitude == pytest.approx(values[0], rel=1e-6)
    assert found.offset_V == pytest.approx(values[2], abs=1e-6)
    assert abs(found.harmonics[0]) == pytest.approx(values[3], rel=1e-5)
    assert np.angle(found.harmonics[0]) == pytest.approx(values[4], abs=1e-5)
    assert found.bound_deg == pytest.approx(found.std_deg, rel=0.01)
    assert found.dof == T.size - 5
    assert not found.widened


@pytest.mark.parametrize("sense", [1, -1])
def test_against_the_encoder_the_sense_does_not_matter(sense: int) -> None:
    heading = np.arange(0.0, 360.0, 15.0)
    theta = np.mod(sense * THETA, 360.0)
    u = np.cos(np.deg2rad(heading[:, None] - theta))
    found = heading_deg(likelihood_north(u, theta).phi_deg, 1)
    assert np.abs(wrapped_deg(found - heading)).max() < 1e-9


def test_missing_samples_are_left_out_and_counted() -> None:
    rng = np.random.default_rng(32)
    u = np.sin(np.deg2rad(THETA + 77.0)) + 0.1 * rng.normal(size=(2, T.size))
    u[1, rng.choice(T.size, 150, replace=False)] = np.nan
    u[1, 700:960] = np.nan
    found = likelihood_north(u, np.mod(THETA, 360.0))
    lost = int(np.isnan(u[1]).sum())
    np.testing.assert_array_equal(found.dropped, [0, lost])
    np.testing.assert_array_equal(found.samples, [T.size, T.size - lost])
    kept = np.isfinite(u[1])
    alone = likelihood_north(u[1, kept], THETA[kept])
    assert found.phi_deg[1] == alone.phi_deg
    assert found.bound_deg[1] == alone.bound_deg
    assert np.all(np.abs(wrapped_deg(found.phi_deg - 77.0)) < found.half_width_deg(0.999))
    assert found.std_deg[1] > found.std_deg[0]


def test_records_with_their_own_angles_are_as_one_by_one() -> None:
    rng = np.random.default_rng(33)
    theta = np.mod(THETA + rng.uniform(0.0, 360.0, (2, 3, 1)), 360.0)
    u = np.sin(np.deg2rad(theta + 10.0)) + 0.1 * rng.normal(size=theta.shape)
    found = likelihood_north(u, theta)
    assert found.phi_deg.shape == found.widened.shape == (2, 3)
    assert found.harmonics.shape == (2, 3, 0)
    assert found.phi_deg[1, 2] == likelihood_north(u[1, 2], theta[1, 2]).phi_deg


def test_noise_that_is_not_white_widens_the_interval() -> None:
    """Noise that is mostly below 3 Hz: white noise's formula would be 3 times too sure."""
    rng = np.random.default_rng(34)
    white = 0.3 * rng.normal(size=(400, 2 * T.size))
    red = signal.lfilter([1.0], [1.0, -0.9], white, axis=1)[:, T.size :]
    found = likelihood_north(np.sin(np.deg2rad(THETA)) + red, THETA)
    errors = wrapped_deg(found.phi_deg)
    assert sim.rms(errors) > 2.5 * sim.rms(found.bound_deg)
    assert found.widened.mean() > 0.99
    assert float(np.mean(np.abs(errors) < found.half_width_deg())) == pytest.approx(0.95, abs=0.03)
    even = likelihood_north(np.sin(np.deg2rad(THETA)) + white[:, : T.size], THETA)
    assert even.widened.mean() < 0.03  # 1 % by chance
    assert even.whiteness.mean() == pytest.approx(1.0, abs=0.06)


def test_uncertainty_on_a_part_of_a_turn_is_that_of_the_direction_that_turns_north() -> None:
    """A third of a turn: amplitude and direction are far from equally well known."""
    theta = np.mod(THETA, 120.0)
    u = np.sin(np.deg2rad(theta + 10.0)) + 0.05 * np.random.default_rng(36).normal(size=T.size)

    def model(angle: np.ndarray, size: float, phi: float, offset: float) -> np.ndarray:
        return size * np.sin(angle + phi) + offset

    values, covariance = optimize.curve_fit(model, np.deg2rad(theta), u, p0=(1.0, 0.2, 0.0))
    found = likelihood_north(u, theta)
    assert found.std_deg == pytest.approx(np.rad2deg(np.sqrt(covariance[1, 1])), rel=1e-3)
    assert covariance[0, 0] / values[0] ** 2 > 4.0 * covariance[1, 1]


def test_the_scatter_of_turns_is_seen_behind_an_encoder_that_begins_again_each_turn() -> None:
    """Six turns and a tenth: five degrees of freedom, and the piece of a turn at the end is none of them."""
    theta, rng = THETA[:610], np.random.default_rng(37)
    u = np.sin(np.deg2rad(theta)) + 0.3 * rng.normal(size=(400, theta.size))
    found = likelihood_north(u, np.mod(theta, 360.0))
    np.testing.assert_allclose(found.whiteness, likelihood_north(u, theta).whiteness)
    assert found.whiteness.mean() == pytest.approx(1.0, abs=0.1)  # standard deviation of the mean 0.03
    swayed = np.repeat([0.1, -0.1, 0.1, -0.1, 0.1, -0.1], 100)
    turned = likelihood_north(np.sin(np.deg2rad(THETA[:600]) + swayed) + 1e-3 * rng.normal(size=600), THETA[:600])
    assert (turned.widened, turned.dof) == (True, 5.0)
    assert turned.std_deg == pytest.approx(np.rad2deg(0.1 / np.sqrt(5.0)), rel=0.02)  # of six values of 0.1 each


def test_few_turns_have_no_scatter_to_look_at() -> None:
    found = likelihood_north(np.sin(np.deg2rad(THETA[:350])), THETA[:350])
    assert np.isnan(found.whiteness)
    assert not found.widened


def test_weak_signals_may_point_anywhere() -> None:
    rng = np.random.default_rng(35)
    found = likelihood_north(1e-3 * np.sin(np.deg2rad(THETA)) + rng.normal(size=(50, T.size)), THETA)
    assert np.mean(found.half_width_deg() == 180.0) > 0.5


def test_angles_that_do_not_determine_north() -> None:
    u = np.sin(np.deg2rad(THETA))
    with pytest.raises(FitError, match=r"B-FIT-112.*too little of a turn \(separation"):
        likelihood_north(u, np.mod(THETA, 80.0))
    with pytest.raises(FitError, match=r"B-FIT-112.*3 good samples for 3 unknowns"):
        likelihood_north(u[:3], THETA[:3])
    with pytest.raises(FitError, match=r"B-FIT-112.*do not belong together"):
        likelihood_north(u, THETA[:-1])
    with pytest.raises(FitError, match="B-FIT-112"):
        likelihood_north(np.full(THETA.size, np.nan), THETA)
