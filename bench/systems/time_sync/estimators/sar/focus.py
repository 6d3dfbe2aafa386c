"""Focusing of radar pulses on points by backprojection, with the antenna positions a navigation solution gives.

Convention: errors are estimate - truth. Where the positions are ahead of the antenna along the track, the image moves
ahead by as much; a velocity error along the line of sight from the antenna to the target moves it by -(R0 / v) times
that error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.sar.pulses import Array, Sums, at_places, turns

Complex128 = NDArray[np.complex128]

_ELEMENTS_AT_ONCE = 1 << 15  # pulses times pixels that stay in the processor's cache


def focus_sums(sums: Sums, pixels_m: Array) -> Complex128:
    """Image of points near the sums' reference point.

    Args:    sums: of the pulses.   pixels_m: (q, 3).
    Returns: (q,), unit of the gates.
    Source:  Carrara, Goodman, Majewski, Spotlight Synthetic Aperture Radar (1995), appendix on backprojection.
    """
    offset = np.asarray(pixels_m, np.float64) - sums.reference_m
    offset_2 = np.einsum("ij,ij->i", offset, offset)
    from_reference = sums.positions_m - sums.reference_m
    reference_2 = np.einsum("ij,ij->i", from_reference, from_reference)
    reference_m = np.sqrt(reference_2)
    total = np.zeros(len(offset), np.complex128)
    rows = max(1, _ELEMENTS_AT_ONCE // len(offset))
    for begin in range(0, len(sums.fine), rows):
        some = slice(begin, begin + rows)
        range_2 = np.add.outer(reference_2[some], offset_2)
        for axis in range(3):  # no matrix product: one of three columns is slower on several threads than on one
            range_2 -= np.multiply.outer(from_reference[some, axis], 2.0 * offset[:, axis])
        range_m = np.sqrt(range_2)
        values = at_places(sums.fine[some], (range_m - sums.near_range_m[some, None]) * (1.0 / sums.spacing_m))
        values *= turns((range_m - reference_m[some, None]) * (2.0 / sums.wavelength_m), values.dtype)
        total += values.sum(axis=0)
    return total / sums.pulses
