"""The closed loop between the two ends of a ramp: width at a temperature, curves of both branches, and the crossings.

Source: geometry of the play operator (bench.maths.play); docs/decisions/0006-bias-and-hysteresis.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.af_converter.estimators.hysteresis.fit import HALF_WIDTH, HysteresisFit
from bench.systems.af_converter.estimators.hysteresis.model import WIDTH

Array = NDArray[np.float64]


def width_at(fit: HysteresisFit, temperature_degC: float) -> tuple[float, float]:
    """Falling minus rising branch at one temperature, with its standard uncertainty; 0 at the ends of the loop.

    After a reversal 2 r must be crossed before the play moves, so within 2 r of an end the loop is narrower.

    Args:    fit: the joint fit.   temperature_degC: lagged temperature.
    Returns: width and standard uncertainty in the unit of the readings; the covariance of width and r is in it.
    Raises:  nothing.
    Source:  width = W min(1, d / (2 r)) with d the distance from the nearer end, of a loop wider than 2 r.
    """
    low, high = fit.loop_degC
    twice = 2.0 * fit.value(HALF_WIDTH)
    crossed = np.clip(min(temperature_degC - low, high - temperature_degC, high - low - twice) / twice, 0.0, 1.0)
    weights = np.zeros(fit.parameters.size)
    weights[fit.names.index(WIDTH)] = crossed
    if crossed < 1.0:
        weights[fit.names.index(HALF_WIDTH)] = -fit.value(WIDTH) * crossed / fit.value(HALF_WIDTH)
    return float(fit.value(WIDTH) * crossed), float(np.sqrt(weights @ fit.covariance @ weights))


def branch_curves(fit: HysteresisFit, temperature_degC: Array) -> tuple[Array, Array]:
    """Rising and falling branch of the closed loop at lagged temperatures, (k,) each.

    Args:    temperature_degC: (k,).
    Raises:  nothing.
    Source:  play between the ends of the loop: P = max(T - r, low + r) rising, min(T + r, high - r) falling.
    """
    low, high = fit.loop_degC
    r = fit.value(HALF_WIDTH)
    centre = np.polynomial.polynomial.polyval(temperature_degC - fit.reference_degC, fit.parameters[: fit.order + 1])
    slope = fit.value(WIDTH) / (2.0 * r)
    rising = np.minimum(np.maximum(temperature_degC - r, low + r), temperature_degC + r)
    falling = np.maximum(np.minimum(temperature_degC + r, high - r), temperature_degC - r)
    return np.asarray(centre + slope * (rising - temperature_degC)), np.asarray(
        centre + slope * (falling - temperature_degC)
    )


def crossed_over(fit: HysteresisFit) -> NDArray[np.bool_]:
    """True for the readings in which the play follows: outside the 2 r after a reversal; (m,).

    Source: |P - T| = r where the play follows.
    """
    return np.asarray(np.abs(fit.play_column) > 0.5 * (1.0 - 1e-6))
