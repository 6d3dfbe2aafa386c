"""The methods for comparison: unlike gains, uncertainty against the scatter of many sets, failures of one lock-in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from north_repeats import average_north
from single_north import single_north

from bench.systems.north.estimators.literal import literal_north
from bench.systems.north.estimators.phasors import North, wrapped_deg
from bench.systems.north.estimators.quadrant import quadrant_north

STEPS_deg = np.arange(4) * 90.0


def samples(
    phi_deg: np.ndarray, f1: float = 1.0, f2: float = 0.0, f4: float = 1.0, f5: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """(13a-d) and (14a-d) as printed, with offsets."""
    phi = np.asarray(phi_deg)[..., None] + STEPS_deg
    return f1 * np.sin(np.deg2rad(phi + f2)) + 0.3, f4 * np.cos(np.deg2rad(phi + f5)) - 0.2


@pytest.mark.parametrize("method", [quadrant_north, single_north])
def test_unlike_gains_turn_nothing(method: Callable[..., North]) -> None:
    phi_deg = np.arange(-179.0, 180.0, 7.0)
    found = method(*samples(phi_deg, f1=1.3, f4=0.8))
    assert np.abs(wrapped_deg(found.phi_deg - phi_deg)).max() < 1e-9


@pytest.mark.parametrize("method", [quadrant_north, single_north])
def test_stated_noise_and_uncertainty_are_the_scatter_of_many_sets(method: Callable[..., North]) -> None:
    rng = np.random.default_rng(91)
    phi_deg = rng.uniform(-180.0, 180.0, 4000)
    u1, u2 = (one + 0.01 * rng.normal(size=one.shape) for one in samples(phi_deg))
    found = method(u1, u2)
    scatter_deg = np.sqrt(np.mean(np.square(wrapped_deg(found.phi_deg - phi_deg))))
    assert np.sqrt(np.mean(found.noise**2)) == pytest.approx(0.01, rel=0.03)
    assert np.sqrt(np.mean(found.std_deg**2)) == pytest.approx(scatter_deg, rel=0.05)


def test_where_there_is_no_azimuth_there_is_no_uncertainty() -> None:
    found = quadrant_north(*samples(np.array([10.0, 40.0]), f2=100.0))
    assert np.isnan(found.phi_deg).all()
    assert np.isnan(found.std_deg).all()


def test_literal_formulas_take_the_placement_off_at_their_end() -> None:
    u1, u2 = samples(np.array([20.0]), f2=2.0, f5=2.0)
    assert literal_north(u1, u2, f5_deg=2.0).north.phi_deg == pytest.approx(20.0, abs=1e-6)


def test_failures_are_told_of_the_lock_in_that_has_them() -> None:
    """Noise in lock-in 2 alone, 2 degrees from where its first and third sample vanish."""
    rng = np.random.default_rng(92)
    u1, u2 = samples(np.full(400, 88.0))
    failures = literal_north(u1, u2 + 0.05 * rng.normal(size=u2.shape)).failures
    assert not failures.flipped_17.any()
    assert not failures.amplitude_19.any()
    flipped = failures.flipped_18 > 0
    assert 0.2 < flipped.mean() < 0.8
    assert failures.amplitude_20[flipped].all()
    assert failures.any[flipped].all()


def test_scatter_of_repeats_does_not_depend_on_the_unit() -> None:
    angles_deg = np.array([10.0, 12.0, 11.0, 13.0])
    found = average_north(3e-3 * np.exp(1j * np.deg2rad(angles_deg)))
    assert float(found.scatter_deg) == pytest.approx(np.std(angles_deg, ddof=1), rel=1e-3)
