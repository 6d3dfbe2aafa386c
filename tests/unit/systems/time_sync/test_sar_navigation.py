"""Positions at the pulses from a navigation solution at 200 Hz."""

from __future__ import annotations

import numpy as np
import pytest

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.navigation import positions_at

EPOCH_s = np.arange(21) * 0.005
PULSE_s = np.linspace(0.0, 0.1, 101)
CUBIC = np.array([[3.0, -1.0, 2.0], [250.0, 4.0, -6.0], [2.0, 5.0, -9.0], [70.0, -30.0, 11.0]])  # by power of time


def _position(time_s: np.ndarray) -> np.ndarray:
    return np.vander(time_s, 4, increasing=True) @ CUBIC


def _velocity(time_s: np.ndarray) -> np.ndarray:
    return np.vander(time_s, 3, increasing=True) @ (CUBIC[1:] * [[1.0], [2.0], [3.0]])


def test_a_cubic_path_is_met_exactly() -> None:
    found = positions_at(PULSE_s, EPOCH_s, _position(EPOCH_s), _velocity(EPOCH_s))
    assert np.abs(found - _position(PULSE_s)).max() < 1e-12


def test_lanes_are_interpolated_each_for_itself() -> None:
    lanes = np.stack([_position(EPOCH_s), 2.0 * _position(EPOCH_s)], axis=1)
    velocities = np.stack([_velocity(EPOCH_s), 2.0 * _velocity(EPOCH_s)], axis=1)
    found = positions_at(PULSE_s, EPOCH_s, lanes, velocities)
    assert found.shape == (101, 2, 3)
    assert np.abs(found[:, 1] - 2.0 * _position(PULSE_s)).max() < 1e-12


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.75])
def test_a_step_of_acceleration_within_an_interval_costs_no_more_than_stated(share: float) -> None:
    """0.1 g within 5 ms: position and velocity at the ends as integrated by hand."""
    step_m_s2, interval_s = 0.981, 0.005
    after = np.linspace(0.0, interval_s, 501)
    truth = 0.5 * step_m_s2 * np.clip(after - share * interval_s, 0.0, None) ** 2
    position = np.array([[0.0, 0.0, 0.0], [truth[-1], 0.0, 0.0]])
    velocity = np.array([[0.0, 0.0, 0.0], [step_m_s2 * interval_s * (1.0 - share), 0.0, 0.0]])
    found = positions_at(after, np.array([0.0, interval_s]), position, velocity)[:, 0]
    assert np.abs(found - truth).max() <= step_m_s2 * interval_s**2 / 62.0


@pytest.mark.parametrize(
    ("pulses", "epochs"),
    [
        (np.array([-0.001, 0.02]), EPOCH_s),
        (np.array([0.05, 0.1001]), EPOCH_s),
        (np.array([]), EPOCH_s),
        (np.array([0.05]), EPOCH_s[::-1]),
    ],
)
def test_pulses_outside_the_solution_are_refused(pulses: np.ndarray, epochs: np.ndarray) -> None:
    with pytest.raises(FitError) as caught:
        positions_at(pulses, epochs, _position(epochs), _velocity(epochs))
    assert caught.value.code == "B-FIT-124"
