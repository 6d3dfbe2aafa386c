"""Echoes of point targets: phase, pulse response, gates, scene."""

from __future__ import annotations

import numpy as np
import pytest

from sim_instruments.worlds.time_sync.radar import Radar, echoes, scene

RADAR = Radar()
LIGHT_m_s = 299_792_458.0


def _echo(range_m: float, amplitude: float = 1.0) -> np.ndarray:
    return echoes(RADAR, np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, range_m, 0.0]]), np.array([amplitude])).gates[0]


def test_the_phase_goes_back_by_half_a_turn_for_a_quarter_of_a_wavelength() -> None:
    at = RADAR.near_range_m + 30 * 2.5
    near, far = _echo(at), _echo(at + RADAR.wavelength_m / 4)
    assert np.angle(far[30] / near[30] * -1.0) == pytest.approx(0.0, abs=1e-3)
    eighth = _echo(at + RADAR.wavelength_m / 8)
    assert np.angle(eighth[30] / near[30]) == pytest.approx(-np.pi / 2, abs=1e-3)


def test_the_phase_is_minus_four_pi_range_over_wavelength() -> None:
    """45 km = 1441002.767... waves of 9.6 GHz each way, reckoned in whole numbers."""
    both_ways, light = 2 * 45_000 * 9_600_000_000, 299_792_458
    turns = (both_ways % light) / light
    peak = _echo(45_000.0)
    assert np.angle(peak[np.abs(peak).argmax()] * np.exp(2j * np.pi * turns)) == pytest.approx(0.0, abs=1e-4)


def test_the_pulse_is_a_flat_band_of_50_MHz() -> None:
    """Target in the middle of a gate train: 50 of 60 MHz filled evenly, 10 MHz empty but for the train's ends."""
    gates = _echo(RADAR.near_range_m + 31.5 * 2.5)
    spectrum = np.abs(np.fft.fft(gates))
    frequency_MHz = np.fft.fftfreq(64, 2 * 2.5 / LIGHT_m_s) / 1e6
    inside, outside = np.abs(frequency_MHz) < 22.0, np.abs(frequency_MHz) > 28.0
    assert spectrum[inside] == pytest.approx(1.2 * np.ones(inside.sum()), rel=0.05)
    assert spectrum[outside].max() < 0.05 * 1.2


def test_the_first_zero_is_a_range_resolution_away() -> None:
    at = RADAR.near_range_m + 20 * 2.5
    assert abs(_echo(at + LIGHT_m_s / 100e6)[20]) < 1e-4
    assert abs(_echo(at)[20]) == pytest.approx(1.0, abs=1e-6)


def test_targets_add_and_keep_their_amplitudes() -> None:
    track = np.stack([np.linspace(-5, 5, 7), np.zeros(7), np.full(7, -3000.0)], axis=1)
    targets = scene(RADAR, np.array([0.0, 0.0, -3000.0]), np.array([250.0, 0.0, 0.0]), ahead_s=0.0)
    together = echoes(RADAR, track, targets, np.array([1.0, 0.5, 2.0])).gates
    each = sum(
        amplitude * echoes(RADAR, track, target[None], np.ones(1)).gates
        for target, amplitude in zip(targets, (1.0, 0.5, 2.0), strict=True)
    )
    assert np.abs(together - each).max() < 1e-5


def test_pulses_one_by_one_are_those_of_the_whole_aperture() -> None:
    track = np.stack([np.arange(2500) * 0.25, np.zeros(2500), np.full(2500, -3000.0)], axis=1)
    targets = scene(RADAR, track[0], np.array([250.0, 0.0, 0.0]), ahead_s=1.25)
    whole = echoes(RADAR, track, targets, np.ones(3))
    some = [echoes(RADAR, track[index : index + 1], targets, np.ones(3)) for index in (0, 1999, 2000, 2499)]
    for index, one in zip((0, 1999, 2000, 2499), some, strict=True):
        assert np.array_equal(whole.gates[index], one.gates[0])
        assert one.near_range_m == whole.near_range_m


def test_beyond_the_gates_only_the_tail_is_left() -> None:
    assert np.abs(_echo(RADAR.near_range_m - 60.0)).max() < 0.02
    assert np.abs(_echo(RADAR.near_range_m + 300.0)).max() < 0.02


@pytest.mark.parametrize(("heading_deg", "right"), [(0.0, [0.0, 1.0]), (90.0, [-1.0, 0.0]), (200.0, [0.3420, -0.9397])])
def test_the_scene_is_broadside_to_the_right_on_the_ground(heading_deg: float, right: list[float]) -> None:
    heading = np.radians(heading_deg)
    velocity = 250.0 * np.array([np.cos(heading), np.sin(heading), 0.0])
    start = np.array([1000.0, -2000.0, -3000.0])
    targets = scene(RADAR, start, velocity)
    middle = start + 5.0 * velocity
    sight = targets - middle
    assert np.linalg.norm(sight[0]) == pytest.approx(45_000.0, abs=1e-6)
    assert sight[0] @ velocity == pytest.approx(0.0, abs=1e-6)
    assert sight[0, :2] / np.linalg.norm(sight[0, :2]) == pytest.approx(right, abs=1e-4)
    assert targets[:, 2] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert sight @ velocity / 250.0 == pytest.approx([0.0, 100.0, -100.0], abs=1e-6)
