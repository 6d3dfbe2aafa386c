"""How well a function of estimated variances is known: by the chi-square laws of these, not by its slope.

A time or a power is a variance, or a ratio of several: its law is skewed, its standard uncertainty in proportion to the
value, and an interval by Student's t holds the truth too seldom.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy import special

from bench.maths.arrays import Floats

PROBABILITY = 0.95
_OF_ONE, _OF_SEVERAL = 1000, 300  # parts of equal probability of the law of each variance


def of_variances(function: Callable[..., Floats], *dof: float) -> tuple[float, float]:
    """Return standard deviation and half-width of a function of independent estimated variances.

    Args:    function: of one array (n,) for each variance, factors on what was estimated, to (n,); it is the estimate
             where all factors are 1, and infinite where it has no value.
             dof: degrees of freedom of each variance, above zero; infinite for one that is known.
    Returns: standard deviation of the estimate, if the true variances are as estimated; half of the interval about the
             estimate that holds the true value with 95 %. Both in the unit of the function, infinite where it may be.
    Raises:  nothing.
    Source:  s^2 dof / sigma^2 is a chi-square; propagation of distributions, JCGM 101:2008 section 5.2. For a power of
             one variance the interval is exact.
    """
    count = _OF_ONE if sum(map(math.isfinite, dof)) < 2 else _OF_SEVERAL
    axes = np.meshgrid(*(_estimated_over_true(number, count) for number in dof), indexing="ij")
    factors = [axis.ravel() for axis in axes]
    estimate = float(function(*(np.ones(1) for _ in dof))[0])
    drawn, true = function(*factors), function(*(1.0 / factor for factor in factors))
    if not (math.isfinite(estimate) and np.isfinite(drawn).all()):
        return math.inf, math.inf
    within = np.sort(np.abs(true - estimate))
    return float(np.std(drawn)), float(within[math.ceil(PROBABILITY * within.size) - 1])


def _estimated_over_true(dof: float, count: int) -> Floats:
    """Return (count,) ratios of an estimated variance to the true one, each as probable as the others."""
    if math.isinf(dof):
        return np.ones(1)
    return np.asarray(special.chdtri(dof, 1.0 - (np.arange(count) + 0.5) / count) / dof)
