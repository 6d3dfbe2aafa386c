"""Focusing of all pulses one by one: the image that sums over blocks of pulses are held against."""

from __future__ import annotations

import numpy as np

from bench.systems.time_sync.estimators.sar.focus import Complex128, focus_sums
from bench.systems.time_sync.estimators.sar.pulses import Array, Complex, Pulses, sums_of


def focus(
    gates: Complex,
    near_range_m: float | Array,
    spacing_m: float,
    wavelength_m: float,
    positions_m: Array,
    pixels_m: Array,
) -> Complex128:
    """Image of points, each of all pulses one by one: the mean over the pulses, so that a target keeps its amplitude.

    Args:    gates: (n, g).   near_range_m: slant range of the first gate, one for all or (n,).   spacing_m: of gates.
             wavelength_m: of the carrier.   positions_m: (n, 3) antenna at the pulses as navigation knows it.
             pixels_m: (q, 3).
    Returns: (q,), unit of the gates.
    Source:  Carrara, Goodman, Majewski, Spotlight Synthetic Aperture Radar (1995), appendix on backprojection.
    """
    pulses = Pulses(gates, near_range_m, spacing_m, wavelength_m)
    return focus_sums(sums_of(pulses, positions_m, np.mean(pixels_m, axis=0), 0.0), pixels_m)
