"""Propagation of distributions by Monte Carlo, and the check of an uncertainty budget with it.

Source: JCGM 101:2008 sections 7.5 to 7.7 (method), 7.9.2 (tolerance) and 8.1 (validation of the GUM interval).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.maths.arrays import Floats

Draw = Callable[[np.random.Generator, int], Floats]  # (generator, trials) -> values of the result, (trials,)
Statement = Literal["agrees", "not resolved", "differs"]
BLOCK = 10_000  # trials: at least 100 / (1 - p), JCGM 101:2008 section 7.9.4
_PROBABILITY = 0.95
_NEARLY = 1.05


@dataclass(frozen=True)
class Distribution:
    """Result of Monte Carlo trials, in the unit of the result; ``low`` and ``high`` bound the shortest 95 % interval.

    The numerical standard deviations of the two ends come from the scatter of blocks of trials.
    """

    mean: float
    std: float
    low: float
    high: float
    trials: int
    low_numerical_std: float
    high_numerical_std: float


@dataclass(frozen=True)
class Check:
    """Comparison of the interval of a budget with that of the trials.

    ``statement``: "agrees" if both ends differ by no more than ``tolerance``, "differs" if an end differs by more than
    that and twice its numerical standard deviation, else "not resolved": more trials would be due.
    """

    low_difference: float
    high_difference: float
    tolerance: float
    statement: Statement


def shortest_interval(values: Floats) -> tuple[float, float]:
    """Return shortest interval that holds 95 % of the trials.

    The smallest of all lengths settles only with the cube root of the number of trials, because near it they hardly
    differ. So a parabola through all lengths that are at most 5 % longer says where the shortest one begins; its ends
    settle with the square root. For a skewed distribution the interval is up to 0.1 % longer than the shortest.

    Args:    values: (n,), any order.
    Returns: lower and upper end, both of them trials.
    Raises:  ValueError for fewer trials than one beyond the interval.
    Source:  JCGM 101:2008 section 7.7.
    """
    ordered = np.sort(values)
    held = int(_PROBABILITY * ordered.size + 0.5)
    if held >= ordered.size:
        raise ValueError(f"{ordered.size} trials do not give an interval of {_PROBABILITY:g}")
    first = _lowest(ordered[held:] - ordered[: ordered.size - held])
    return float(ordered[first]), float(ordered[first + held])


def _lowest(lengths: Floats) -> int:
    """Place of the vertex of a parabola through the small lengths; of the smallest one where there is no vertex."""
    smallest = int(np.argmin(lengths))
    near = np.flatnonzero(lengths <= _NEARLY * lengths[smallest])
    reach = max(int(np.abs(near - smallest).max()), 1)
    if near.size < 3:
        return smallest
    _, slope, curvature = np.polynomial.polynomial.polyfit((near - smallest) / reach, lengths[near], 2)
    if curvature <= 0:
        return smallest
    return int(np.clip(round(smallest - reach * slope / (2.0 * curvature)), near[0], near[-1]))


def numerical_tolerance(std: float, digits: int = 2) -> float:
    """Return half a unit in the last of the significant digits of a standard uncertainty.

    Args:    std: standard uncertainty, > 0.   digits: significant digits that count.
    Returns: tolerance in the unit of ``std``.
    Raises:  ValueError for a standard uncertainty that is not positive.
    Source:  JCGM 101:2008 section 7.9.2.
    """
    if not std > 0:
        raise ValueError(f"a standard uncertainty of {std:g} has no digits")
    exponent = int(f"{std:.{digits - 1}e}".split("e")[1])  # of the rounded number: 9.96 has the digits 10
    return 0.5 * 10.0 ** (exponent - digits + 1)


def propagate(draw: Draw, seed: int, trials: int) -> Distribution:
    """Fixed number of trials.

    Args:    draw: the model; gets a seeded generator and the number of trials, returns values (n,).
             seed: the same seed gives the same numbers.   trials: at least two blocks of 10,000, rounded up to blocks.
    Returns: Distribution over all trials.
    Raises:  nothing of its own.
    Source:  JCGM 101:2008 sections 7.2 to 7.7.
    """
    generator = np.random.default_rng(seed)
    blocks = [draw(generator, BLOCK) for _ in range(max(2, math.ceil(trials / BLOCK)))]
    return _summary(blocks)


def check_interval(value: float, std: float, expanded: float, distribution: Distribution, digits: int = 2) -> Check:
    """Compare value +- U of a budget with the shortest interval of the trials.

    Args:    value, std, expanded: result, standard and expanded uncertainty of the budget.   found: the trials.
             digits: significant digits of ``std`` that must hold.
    Returns: Check.
    Raises:  ValueError for a standard uncertainty that is not positive.
    Source:  JCGM 101:2008 section 8.1.
    """
    low, high = abs(value - expanded - distribution.low), abs(value + expanded - distribution.high)
    tolerance = numerical_tolerance(std, digits)
    ends = ((low, distribution.low_numerical_std), (high, distribution.high_numerical_std))
    statement: Statement = "not resolved"
    if low <= tolerance and high <= tolerance:
        statement = "agrees"
    elif any(difference > tolerance + 2.0 * noise for difference, noise in ends):
        statement = "differs"
    return Check(low, high, tolerance, statement)


def _summary(blocks: list[Floats]) -> Distribution:
    ends = np.array([shortest_interval(block) for block in blocks])
    noise = np.std(ends, axis=0, ddof=1) / math.sqrt(len(blocks))
    values = np.concatenate(blocks)
    low, high = shortest_interval(values)
    return Distribution(
        mean=float(np.mean(values)),
        std=float(np.std(values, ddof=1)),
        low=low,
        high=high,
        trials=values.size,
        low_numerical_std=float(noise[0]),
        high_numerical_std=float(noise[1]),
    )
