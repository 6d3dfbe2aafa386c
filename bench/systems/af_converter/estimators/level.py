"""What the constant of a fit means where the noise is a random walk: the mean over the readings.

Source: Cressie, Statistics for Spatial Data (1993), section 3.4 (universal kriging); docs/decisions/0006.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Level:
    """The mean of the walk over the readings: its covariance with every reading, (m,), and its variance."""

    covariance: Array
    variance: float

    def referred(self, covariance: Array, design_product: Array, square: float) -> Array:
        """Covariance (n, n) of the parameters when the first one holds the mean of the walk, best predicted.

        Args:    covariance: (n, n) of the generalised least squares.   design_product: X' V^-1 c, (n,).
                 square: c' V^-1 c, with c = ``self.covariance``.
        Source:  Cressie (1993), equation 3.4.5: the variance of universal kriging.
        """
        turned = -design_product
        turned[0] += 1.0
        mixed = covariance @ turned
        referred = covariance.copy()
        referred[0, :] = referred[:, 0] = mixed
        referred[0, 0] = turned @ mixed + max(self.variance - square, 0.0)
        return referred


def mean_of_walk(start_s: Array, end_s: Array, walk_A_rth: float) -> Level:
    """Level of a random walk that starts with the first gate, averaged over gates that do not overlap.

    Args:    start_s, end_s: (m,), in order of time, second.   walk_A_rth: standard deviation after one hour.
    Returns: Level; the covariance of two gates is sigma^2 times the earlier middle, a sixth of a gate less for one
             with itself.
    Source:  integral of min(t, t') over two gates.
    """
    m = start_s.size
    middle_s = (start_s + end_s) / 2.0 - start_s[0]
    earlier = np.cumsum(middle_s) + middle_s * (m - 1 - np.arange(m)) - (end_s - start_s) / 6.0
    shared = walk_A_rth**2 / 3600.0 * earlier / m
    return Level(shared, float(np.mean(shared)))
