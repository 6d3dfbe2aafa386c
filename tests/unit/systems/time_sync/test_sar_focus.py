"""Targets in the pulses, positions at them, and focusing against the image that plain double-precision sums give."""

from __future__ import annotations

import numpy as np
import pytest
from sar_rig import ALONG, EDGE, RADAR, SIGHT, MIDDLE_m, TRACK_m, by_sums, focus, pulses

from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.image import focus_sums, point_targets
from bench.systems.time_sync.estimators.sar.pulses import Pulses, at_places, finer, positions_at, sums_of
from sim_instruments.worlds.time_sync.radar import Radar, echoes

EPOCH_s = np.arange(21) * 0.005
PULSE_s = np.linspace(0.0, 0.1, 101)
CUBIC = np.array([[3.0, -1.0, 2.0], [250.0, 4.0, -6.0], [2.0, 5.0, -9.0], [70.0, -30.0, 11.0]])  # by power of time
AZIMUTH_m = np.linspace(-3.0, 3.0, 61)
RANGE_m = np.linspace(-32.0, 32.0, 61)
PIXELS_m = np.concatenate([MIDDLE_m + AZIMUTH_m[:, None] * ALONG, MIDDLE_m + RANGE_m[:, None] * SIGHT])


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


def test_gates_and_backprojection_give_the_image_of_the_plain_sums() -> None:
    image = focus(pulses(), TRACK_m, PIXELS_m)
    assert np.abs(image - by_sums(PIXELS_m)).max() < 5e-4  # -66 dB of the peak


def test_blocks_of_pulses_give_the_image_of_all_pulses() -> None:
    image = focus(pulses(), TRACK_m, PIXELS_m)
    sums = sums_of(pulses(), TRACK_m, MIDDLE_m, 2.4)
    assert len(sums.fine) < 1100
    assert np.abs(focus_sums(sums, PIXELS_m) - image).max() < 5e-5


def test_positions_of_a_bent_track_focus_alike() -> None:
    bent = TRACK_m + np.outer(EDGE**2, [0.0, 3.0, -2.0])
    image = focus(pulses(), bent, PIXELS_m)
    assert np.abs(image - by_sums(PIXELS_m, bent)).max() < 5e-4


def test_a_window_of_gates_that_follows_the_range_changes_nothing() -> None:
    """The radar may open its gates later in the middle of the aperture."""
    one = pulses()
    later = np.where(np.abs(EDGE) < 0.5, 4, 0)
    gates = np.stack([np.roll(gate, -shift) for gate, shift in zip(one.gates, later, strict=True)])
    gates[later > 0, -4:] = 0.0
    followed = Pulses(gates, RADAR.near_range_m + 2.5 * later, 2.5, one.wavelength_m)
    near = PIXELS_m[:61]
    expected = focus_sums(sums_of(one, TRACK_m, MIDDLE_m, 2.4), near)
    assert np.abs(focus_sums(sums_of(followed, TRACK_m, MIDDLE_m, 2.4), near) - expected).max() < 1e-3


@pytest.mark.parametrize("centre", [28.0, 31.37, 35.5])
def test_values_between_gates_are_those_of_the_band_limited_pulse(centre: float) -> None:
    """5/6 of the gates' band is filled, as by 50 MHz in gates of 2.5 m."""
    band = 2.0 * 50e6 / 299_792_458.0 * 2.5
    gates = np.sinc((np.arange(64) - centre) * band).astype(np.complex64)[None]
    place = np.linspace(12.0, 51.0, 1234)[None]
    found = at_places(finer(gates * np.complex64(1j)), place)
    assert np.abs(found - 1j * np.sinc((place - centre) * band)).max() < 1e-3


def test_beyond_the_gates_there_is_nothing() -> None:
    found = at_places(finer(np.ones((2, 64), np.complex64)), np.array([[-0.3, 63.2], [-400.0, 1e5]]))
    assert not found.any()
