"""Responses and pieces of radar images as a report draws them: decibels against a reference, down to a floor."""

from __future__ import annotations

import numpy as np

from bench.systems.time_sync.estimators.sar.focus import Complex128
from bench.systems.time_sync.estimators.sar.pulses import Array

FLOOR_dB = -80.0


def levels_dB(value: Complex128 | Array, reference: float, floor_dB: float = FLOOR_dB) -> Array:
    """Levels of a cut or a piece of an image: the paper's figures 8, 9, 12 and 13.

    Args:    value: of any shape, complex or its magnitude.   reference: magnitude that is 0 dB, > 0.   floor_dB: what
             is lower is drawn there.
    Returns: decibels, of the shape of ``value``.
    Source:  20 log10 of the magnitude.
    """
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(value) / reference, 10.0 ** (floor_dB / 20.0))))
