"""Focusing against the image that plain double-precision sums over the ranges give."""

from __future__ import annotations

import numpy as np
import pytest
from focusing import focus
from sar_rig import ALONG, EDGE, RADAR, SIGHT, MIDDLE_m, TRACK_m, by_sums, pulses

from bench.systems.time_sync.estimators.sar.focus import focus_sums
from bench.systems.time_sync.estimators.sar.pulses import Pulses, at_places, finer, sums_of

AZIMUTH_m = np.linspace(-3.0, 3.0, 61)
RANGE_m = np.linspace(-32.0, 32.0, 61)
PIXELS_m = np.concatenate([MIDDLE_m + AZIMUTH_m[:, None] * ALONG, MIDDLE_m + RANGE_m[:, None] * SIGHT])


def test_gates_and_backprojection_give_the_image_of_the_plain_sums() -> None:
    one = pulses()
    image = focus(one.gates, one.near_range_m, one.spacing_m, one.wavelength_m, TRACK_m, PIXELS_m)
    assert np.abs(image - by_sums(PIXELS_m)).max() < 5e-4  # -66 dB of the peak


def test_blocks_of_pulses_give_the_image_of_all_pulses() -> None:
    one = pulses()
    image = focus(one.gates, one.near_range_m, one.spacing_m, one.wavelength_m, TRACK_m, PIXELS_m)
    sums = sums_of(one, TRACK_m, MIDDLE_m, 2.4)
    assert len(sums.fine) < 1100
    assert np.abs(focus_sums(sums, PIXELS_m) - image).max() < 5e-5


def test_positions_of_a_bent_track_focus_alike() -> None:
    bent = TRACK_m + np.outer(EDGE**2, [0.0, 3.0, -2.0])
    one = pulses()
    image = focus(one.gates, one.near_range_m, one.spacing_m, one.wavelength_m, bent, PIXELS_m)
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
