"""Powers in twice the precision, as designs of the certified NIST problems need them."""

from __future__ import annotations

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.extended import Extended, stacked


def polynomial_columns(x: Floats, order: int) -> Extended:
    """Columns 1, x, x^2 ... x^order, each power right to about 31 digits; a power in doubles is right to 15.

    Args:    x: (m,), any unit, taken as exact.   order: highest power, >= 0.
    Returns: Extended (m, order + 1), a design for bench.maths.least_squares.solve.
    Source:  Dekker, Numer. Math. 18 (1971) 224.
    """
    base = Extended.of(np.asarray(x, np.float64)[None, :])
    powers = [Extended.of(np.ones(base.shape))]
    for _ in range(order):
        powers.append(powers[-1] * base)
    return stacked(*powers).transposed
