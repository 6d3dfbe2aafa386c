"""Repeated readings of one quantity: whether they drift, and whether one of them is odd."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats

FEWEST = 4  # readings from which on a trend or an odd reading can be told from noise


@dataclass(frozen=True)
class Oddness:
    """What readings do against their noise: the ``size`` in their unit and its ``probability`` by chance."""

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
    probability = 0.0 if std == 0.0 else _two_sided(slope / std, freedom)
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
    return Oddness(move, min(1.0, n * _two_sided(studentised, n - 2)))


def _two_sided(t: float, freedom: int) -> float:
    from scipy import special

    return float(2.0 * special.stdtr(freedom, -abs(t)))
