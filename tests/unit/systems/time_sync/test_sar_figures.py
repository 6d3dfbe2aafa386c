"""Levels of a report's figures."""

from __future__ import annotations

import numpy as np
import pytest

from bench.systems.time_sync.estimators.sar.image import FLOOR_dB, levels_dB


def test_levels_are_decibels_against_a_reference_down_to_a_floor() -> None:
    value = np.array([[2.0, 0.2j], [0.0, -2e-3]], np.complex128)
    assert levels_dB(value, 2.0) == pytest.approx(np.array([[0.0, -20.0], [FLOOR_dB, -60.0]]))
    assert levels_dB(np.abs(value), 20.0, -30.0) == pytest.approx(np.array([[-20.0, -30.0], [-30.0, -30.0]]))
