"""How many readings a mean needs, decided once, from the scatter of a first stage.

The variance of the first stage alone says how many readings are needed, and it alone is the variance of the mean
afterwards. So it is independent of the mean, and the interval has the coverage that it states. A rule that looks at the
running scatter again and again stops where the scatter happens to be small, and its interval is too short.
Source: C. Stein, A two-sample test for a linear hypothesis whose power is independent of the variance, Annals of
Mathematical Statistics 16 (1945) 243.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist, variance

LEAST_FIRST = 10  # readings of a first stage: with fewer, its variance says little
COVERAGE = 0.95
_NORMAL = NormalDist().inv_cdf(0.5 + COVERAGE / 2.0)


def widening(dof: int) -> float:
    """Return the 95 % factor of Student's t over that of the normal distribution, for ``dof`` of 9 and more.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.5: wrong by less than 1e-5 from 9 degrees of
    freedom on. A run stops points by it, and loads no library of special functions for that.
    """
    z = _NORMAL
    terms = (
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
        (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
    )
    return 1.0 + math.fsum(term / dof**power for power, term in enumerate(terms, start=1)) / z


def needed(first: Sequence[float], target: float) -> int:
    """Return how many readings the mean needs in all, those of the first stage included.

    Args:    first: readings of the first stage, at least ``LEAST_FIRST``, any unit.   target: standard uncertainty of
             the mean, same unit, positive.
    Returns: the least number of which the 95 % interval, with Student's t of the first stage's degrees of freedom, is
             no wider than that of a mean with the known standard uncertainty ``target``; never fewer than there are.
    Source:  Stein 1945, equation (2); see the module.
    """
    half_width = widening(len(first) - 1) * math.sqrt(variance(first))
    return max(len(first), math.ceil((half_width / target) ** 2))
