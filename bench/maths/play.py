"""The play operator: the elementary rate-independent hysteresis, a piston with slack.

Source: Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989), section 2 (generalised play).
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def play(temperature_degC: Array, half_width_degC: float, start: float = 1.0) -> Array:
    """Output P of a play of half-width r: P moves only where it would otherwise be more than r away from T.

    On a rising branch P = T - r, on a falling one P = T + r; after a reversal 2 r is crossed before P moves.

    Args:    temperature_degC: T, (k,), in order of time; between two values it must be monotone.
             half_width_degC: r >= 0.   start: (P - T) / r at the first value, -1 to 1; 1 = it came from above.
    Returns: P, (k,), degC.
    Source:  Krasnosel'skii and Pokrovskii (1989), section 2: P_k = max(T_k - r, min(T_k + r, P_{k-1})).
    """
    if not temperature_degC.size:
        return np.empty(0)
    low, high = (temperature_degC - half_width_degC).tolist(), (temperature_degC + half_width_degC).tolist()
    first = float(temperature_degC[0]) + start * half_width_degC

    def step(before: float, limits: tuple[float, float]) -> float:
        floor, ceiling = limits
        return floor if before < floor else min(before, ceiling)

    return np.fromiter(accumulate(zip(low[1:], high[1:], strict=True), step, initial=first), np.float64, len(low))


def cell_means(temperature_degC: Array, output_degC: Array) -> Array:
    """Mean of P between neighbouring values, (k - 1,), exact where T is a straight line between them.

    P stands still for a part of the cell and follows T for the rest, so the mean is not half the sum of the ends.

    Args:    temperature_degC, output_degC: T and P = play(T), (k,).
    Source:  algebra: P0 + dP |dP / dT| / 2.
    """
    moved, run = np.diff(output_degC), np.abs(np.diff(temperature_degC))
    share = np.abs(moved) / np.where(run > 0, run, 1.0)
    return np.asarray(output_degC[:-1] + moved * share / 2.0)
