"""Tests that analyses share: tail probabilities, one odd reading or step among many, a trend.

No probability is smaller than ``SMALLEST``: one that is lost in the arithmetic is still one, and 0 is a certainty.
Source: NIST/SEMATECH e-Handbook of Statistical Methods, sections 1.3.6.6 and 1.3.6.7, for the distributions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from bench.maths.arrays import Floats

SMALLEST = 1e-300
FEWEST = 4  # readings from which on a trend or an odd reading can be told from noise
Number = TypeVar("Number", float, Floats)


def chi2_tail(chi2: Number, dof: ArrayLike) -> Number:
    """Return the probability of a chi-square at least as large; 1 without degrees of freedom."""
    from scipy import special  # what needs no probability is done before this is loaded

    probability: Number = _probability(np.where(np.asarray(dof) > 0, special.chdtrc(dof, chi2), 1.0))
    return probability


def chi2_both(chi2: float, dof: float) -> float:
    """Return the probability of a chi-square at least as far on its side, on either side."""
    from scipy import special

    return float(_probability(2.0 * min(special.chdtr(dof, chi2), special.chdtrc(dof, chi2))))


def f_tail(ratio: Number, dof: ArrayLike, of_dof: ArrayLike) -> Number:
    """Return the probability of a ratio of two mean squares at least as large.

    Args: dof, of_dof: of the mean square above and of that below; where ``of_dof`` is infinite its variance is known.
    """
    from scipy import special

    known = np.isinf(of_dof)
    of_known = special.chdtrc(dof, np.multiply(ratio, dof))
    probability: Number = _probability(np.where(known, of_known, special.fdtrc(dof, np.where(known, 1, of_dof), ratio)))
    return probability


def t_both(score: Number, dof: ArrayLike = math.inf) -> Number:
    """Return the probability of a value at least as far from zero, in its standard uncertainties, on either side.

    Args: dof: of Student's t; infinite is the normal distribution.
    """
    from scipy import special

    known, far = np.isinf(dof), -np.abs(score)
    below = np.where(known, special.ndtr(far), special.stdtr(np.where(known, 1, dof), far))
    probability: Number = _probability(2.0 * below)
    return probability


def of_many(probability: float, count: int) -> float:
    """Return the probability of one at least as odd among ``count`` places. Source: union bound."""
    return min(1.0, count * probability)


def _probability(value: Any) -> Any:
    bounded = np.clip(value, SMALLEST, 1.0)
    return bounded if bounded.ndim else float(bounded)


@dataclass(frozen=True)
class Oddness:
    """How odd readings are: the ``size`` of it in their unit, and the ``probability`` of as much by chance."""

    size: float
    probability: float


def trend(t_s: Floats, readings: Floats) -> Oddness | None:
    """Test readings for a straight drift in time.

    Args:    t_s: times, (n,), seconds.   readings: (n,), any unit.
    Returns: change from the first reading to the last along the line, and the two-sided probability of a slope at least
             as steep in readings that do not drift; None below four readings, at one time, or without any scatter.
    Raises:  nothing.
    Source:  Student's t of the slope of a straight line, Draper and Smith, Applied Regression Analysis, section 1.4.
    """
    if readings.size < FEWEST or np.ptp(t_s) == 0.0 or np.ptp(readings) == 0.0:
        return None
    at, off = t_s - t_s.mean(), readings - readings.mean()
    squares = float(at @ at)
    slope = float(at @ off) / squares
    left = off - slope * at
    freedom = readings.size - 2
    std = math.sqrt(float(left @ left) / freedom / squares)
    probability = 0.0 if std == 0.0 else t_both(slope / std, freedom)
    return Oddness(slope * float(np.ptp(t_s)), probability)


def odd_one(readings: Floats) -> Oddness | None:
    """Test whether the reading that is farthest from the mean belongs to the others.

    Args:    readings: (n,), any unit.
    Returns: by how much the mean changes without it, and the probability of one at least as far among n readings of one
             normal distribution (at most, by the union bound); None below four readings or without any scatter.
    Raises:  nothing.
    Source:  F. E. Grubbs, Technometrics 11 (1969) 1, by the externally studentised residual.
    """
    n = readings.size
    if n < FEWEST or np.ptp(readings) == 0.0:
        return None
    off = readings - readings.mean()
    worst = int(np.argmax(np.abs(off)))
    others = np.delete(readings, worst)
    move = float(others.mean() - readings.mean())
    scatter = float(others.std(ddof=1))
    distance = float(readings[worst] - others.mean())
    if scatter == 0.0:
        return Oddness(move, 0.0)
    studentised = distance / (scatter * math.sqrt(n / (n - 1.0)))
    return Oddness(move, of_many(t_both(studentised, n - 2), n))
