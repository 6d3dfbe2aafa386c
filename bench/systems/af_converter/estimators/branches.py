"""The usual comparison of a rising and a falling ramp: one polynomial each, with no word about lag or play.

Shown beside the joint fit so that a reader sees what lag does: against the chamber's temperature the difference of the
branches holds 2 rate lag dy/dT on top of the hysteresis.
Source: docs/decisions/0006-bias-and-hysteresis.md; AF-converter paper section 4 (up and down ramp).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.maths.least_squares import solve

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def branch_difference(
    temperature_degC: Array, readings: Array, rising: Mask, falling: Mask, at_degC: Array, order: int = 3
) -> Array:
    """Falling minus rising polynomial at temperatures; NaN outside what both branches cover.

    Args:    temperature_degC, readings: (m,).   rising, falling: (m,) masks of the branches.   at_degC: (k,).
             order: degree of both polynomials; all readings weigh the same.
    Returns: (k,), unit of the readings; all NaN if a branch has no more readings than coefficients.
    Raises:  FitError B-FIT-001 if the temperatures of a branch do not determine its polynomial.
    Source:  see the module.
    """
    both = [(temperature_degC[mask], readings[mask]) for mask in (falling, rising)]
    if min(temperature.size for temperature, _ in both) <= order + 1:
        return np.full(at_degC.shape, np.nan)
    low = max(float(temperature.min()) for temperature, _ in both)
    high = min(float(temperature.max()) for temperature, _ in both)
    values = [_polynomial(temperature, y, order, at_degC) for temperature, y in both]
    return np.where((at_degC >= low) & (at_degC <= high), values[0] - values[1], np.nan)


def _polynomial(temperature_degC: Array, readings: Array, order: int, at_degC: Array) -> Array:
    middle, reach = float(np.mean(temperature_degC)), float(np.ptp(temperature_degC)) / 2.0 or 1.0
    basis, triangle = np.linalg.qr(np.vander((temperature_degC - middle) / reach, order + 1, increasing=True))
    names = [f"coefficient {k} of a branch" for k in range(order + 1)]
    fit = solve(triangle, basis.T @ readings, np.eye(order + 1), names)
    return np.asarray(np.polynomial.polynomial.polyval((at_degC - middle) / reach, fit.parameters))
