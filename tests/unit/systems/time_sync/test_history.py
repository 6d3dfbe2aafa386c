"""Past states are read between samples and carry the corrections made since."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.maths.strapdown import small_rotation
from bench.systems.time_sync.estimators.kalman.innovation import History, Past, rotation_between

Array = NDArray[np.float64]

RATE_rad_s = 0.3
ACCELERATION_m_s2 = np.array([4.0, -2.0, 1.0])
JUMP = np.array([2.0, 0.0, 0.0, 0.5, -0.3, 0.2, 0.0, 0.0, 1e-3])  # position, velocity, rotation


def true_state(t_s: float) -> Array:
    """(15, 1, 1): accelerated from 50 m/s, turning about the vertical."""
    v = np.array([50.0, 0.0, 0.0]) + ACCELERATION_m_s2 * t_s
    p = np.array([50.0, 0.0, 0.0]) * t_s + 0.5 * ACCELERATION_m_s2 * t_s**2
    C = small_rotation(np.array([0.0, 0.0, RATE_rad_s * t_s])[:, None])[..., 0]
    return np.concatenate([p, v, C.ravel()])[:, None, None]


def filled(corrected_at: int | None) -> History:
    """40 samples; the first ones, up to a correction, are wrong by minus JUMP."""
    history = History(np.arange(100) * 0.005, 0.1, 1, 1)
    for j in range(40):
        state = true_state(j * 0.005)
        if corrected_at is not None and j <= corrected_at:
            state[:3] += -JUMP[:3, None, None] - JUMP[3:6, None, None] * (j - corrected_at) * 0.005
            state[3:6] -= JUMP[3:6, None, None]
            turn = small_rotation(-JUMP[6:, None])[..., 0]
            state[6:] = (turn @ state[6:].reshape(3, 3)).reshape(9, 1, 1)
        history.store(j, state)
        if j == corrected_at:
            history.correct(-JUMP[:, None, None], true_state(j * 0.005))
    return history


def read(history: History, t_s: float) -> Past:
    return history.read(np.array([[t_s]]))


@pytest.mark.parametrize("corrected_at", [None, 30, 34, 38])
@pytest.mark.parametrize("t_s", [0.1713, 0.15, 0.2021, 0.165])
def test_a_past_state_is_what_it_would_be_with_the_correction(t_s: float, corrected_at: int | None) -> None:
    past, true = read(filled(corrected_at), t_s), true_state(t_s)
    assert past.p == pytest.approx(true[:3], abs=1e-9)
    assert past.v == pytest.approx(true[3:6], abs=1e-9)
    turned = rotation_between(past.C, true[6:].reshape(3, 3, 1, 1)) + past.turned
    assert turned == pytest.approx(np.zeros((3, 1, 1)), abs=1e-5)
    assert past.age_s == pytest.approx(39 * 0.005 - t_s)


@pytest.mark.parametrize("corrected_at", [None, 32, 33, 34])
def test_a_correction_is_no_acceleration_and_no_turn(corrected_at: int | None) -> None:
    """Step of 0.6 m/s in 20 ms: taken for motion it would be 30 m/s2 and 3 deg/s."""
    past = read(filled(corrected_at), 0.1667)
    assert past.acceleration[:, 0] == pytest.approx(ACCELERATION_m_s2, abs=1e-6)
    assert past.rate[:, 0] == pytest.approx([0.0, 0.0, RATE_rad_s], abs=1e-4)


def test_beyond_what_is_stored_motion_goes_on_evenly() -> None:
    history = filled(None)
    for t_s in (0.26, 0.02):  # ahead of the newest, and from before the oldest of 0.1 s
        past, true = read(history, t_s), true_state(t_s)
        assert past.p == pytest.approx(true[:3], abs=1e-6)
        assert past.v == pytest.approx(true[3:6], abs=1e-6)
        turned = rotation_between(past.C, true[6:].reshape(3, 3, 1, 1))
        assert turned == pytest.approx(np.zeros((3, 1, 1)), abs=1e-3)
