"""Aperture of the paper's radar over point targets, and an image of it that goes past gates and focusing."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.sar.image import Complex128, focus_sums
from bench.systems.time_sync.estimators.sar.pulses import Pulses, sums_of
from bench.systems.time_sync.estimators.sar.response import Response, impulse_response
from sim_instruments.worlds.time_sync.radar import Radar, echoes, scene

Array = NDArray[np.float64]

LIGHT_m_s = 299_792_458.0
SPEED_m_s = 250.0
RADAR = Radar()
PULSE_s: Array = (np.arange(10_000) - 4999.5) / 1000.0
TRACK_m: Array = np.stack([SPEED_m_s * PULSE_s, np.zeros(10_000), np.full(10_000, -3000.0)], axis=1)
TARGETS_m: Array = scene(RADAR, TRACK_m[0], np.array([SPEED_m_s, 0.0, 0.0]), ahead_s=-PULSE_s[0])
MIDDLE_m: Array = TARGETS_m[0]
ALONG: Array = np.array([1.0, 0.0, 0.0])
SIGHT: Array = (MIDDLE_m - [0.0, 0.0, -3000.0]) / 45_000.0  # antenna to target at the middle
EDGE: Array = PULSE_s / 5.0  # -1 to 1 over the aperture


@cache
def pulses(count: int = 1) -> Pulses:
    """Echoes of the scene's first targets, all of amplitude 1."""
    seen = echoes(RADAR, TRACK_m, TARGETS_m[:count], np.ones(count))
    return Pulses(seen.gates, seen.near_range_m, seen.spacing_m, RADAR.wavelength_m)


def spoilt(phase_rad: Array, weight: Array | float = 1.0) -> Response:
    """Response of the middle target with a phase error and a weight over the aperture."""
    one = pulses()
    gates = one.gates * (weight * np.exp(1j * phase_rad)).astype(np.complex64)[:, None]
    changed = Pulses(gates, one.near_range_m, one.spacing_m, one.wavelength_m)
    return impulse_response(changed, TRACK_m, MIDDLE_m)


def focused(positions_m: Array, count: int = 1, target: int = 0) -> Response:
    """Response of one target of the scene by positions that navigation gives."""
    return impulse_response(pulses(count), positions_m, TARGETS_m[target])


def by_sums(pixels_m: Array, positions_m: Array = TRACK_m) -> NDArray[np.complex128]:
    """Image of the middle target in double precision from ranges alone: no gates, no interpolation, no blocks."""
    out = np.empty(len(pixels_m), np.complex128)
    true_m = np.linalg.norm(TRACK_m - MIDDLE_m, axis=1)
    for index, pixel in enumerate(pixels_m):
        away_m = np.linalg.norm(positions_m - pixel, axis=1) - true_m
        pulse = np.sinc(away_m * 2.0 * 50e6 / LIGHT_m_s)
        out[index] = np.mean(pulse * np.exp(4j * np.pi * away_m * 9.6e9 / LIGHT_m_s))
    return out


def identity_shift_m(error_m: Array) -> float:
    """Along-track error - (R0 / v) dv_LOS of an error (n, 3) = estimate - truth over the aperture."""
    velocity_m_s = PULSE_s @ (error_m @ SIGHT) / (PULSE_s @ PULSE_s)
    return float((error_m @ ALONG).mean() - 45_000.0 / SPEED_m_s * velocity_m_s)


def focus(echo: Pulses, positions_m: Array, pixels_m: Array) -> Complex128:
    """Image of points (q, 3), each of all pulses one by one: what sums over blocks of pulses are held against."""
    return focus_sums(sums_of(echo, positions_m, np.mean(pixels_m, axis=0), 0.0), pixels_m)
