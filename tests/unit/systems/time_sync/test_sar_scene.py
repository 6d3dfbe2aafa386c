"""Point targets are found in the pulses of a radar without anybody saying where they stand."""

from __future__ import annotations

import numpy as np
import pytest

from bench.systems.time_sync.estimators.sar.pulses import Pulses
from bench.systems.time_sync.estimators.sar.scene import point_targets
from sim_instruments.worlds.time_sync.sar_echo import Radar, echoes


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 215.0])
def test_targets_are_found_to_a_few_cells(heading_deg: float) -> None:
    radar, height_m, range_m = Radar(), 3000.0, 45_000.0
    turn = np.radians(heading_deg)
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    right = np.array([-np.sin(turn), np.cos(turn), 0.0])
    along_m = (np.arange(10_000) - 4999.5) * 0.25
    positions_m = along_m[:, None] * ahead + [500.0, -200.0, -height_m]
    middle_m = np.array([500.0, -200.0, 0.0]) + np.sqrt(range_m**2 - height_m**2) * right
    targets_m = np.stack([middle_m, middle_m + 40.0 * ahead + 15.0 * right, middle_m - 30.0 * ahead - 12.0 * right])
    echo = echoes(radar, positions_m, targets_m, np.array([1.0, 0.8, 0.6]))
    wavelength_m = 299_792_458.0 / radar.carrier_Hz
    found_m = point_targets(Pulses(echo.gates, echo.near_range_m, echo.spacing_m, wavelength_m), positions_m)
    assert found_m.shape == (3, 3)
    assert np.abs((found_m - targets_m) @ ahead).max() < 1.0
    assert np.abs((found_m - targets_m) @ right).max() < 4.0
