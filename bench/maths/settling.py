"""Whether a temperature has settled: every sample of a window, and the chance that it leaves its band soon after.

What the next window brings is taken to be like what this one brought. Means of a tenth of the window show how far the
temperature wanders in half of it, its line is carried on, and the scatter from sample to sample, which is no wandering,
is kept from both edges of the band.

Source: docs/user-guide.md, Settling, with the measured share of verdicts that were contradicted; the distribution of
Student for an even number of degrees of freedom: Abramowitz and Stegun (1964), 26.7.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_BLOCKS = 10
_LEVEL = 3  # blocks that tell where the temperature is now
_GROWTH = math.sqrt(2.0)  # of a random walk, from half a window to a whole one
_DOF = 8  # of the wandering seen in one window; with fewer nothing is ever stable, with more too much is
_SCATTER, _SCATTER_CHANCE = 4.15, 0.01  # of 300 independent samples of either sign, as many standard deviations off


@dataclass(frozen=True)
class Window:
    """What the samples of a window say: ``slope_degC_min`` of their line, ``spread_degC`` from least to greatest.

    ``chance``: that the temperature leaves its band within a window from now on; None if too few samples tell.
    """

    samples: int
    mean_degC: float
    slope_degC_min: float
    spread_degC: float
    chance: float | None


def window_of(t_s: Array, degC: Array, low_degC: float, high_degC: float) -> Window:
    """Return what a window says.

    Args:    t_s, degC: all samples, (n,), in order of time, at least one.   low_degC, high_degC: the band.
    Source:  see the module.
    """
    spread = float(np.ptp(degC))
    blocks = _means(t_s, degC)
    if blocks is None:
        slope = float(degC[-1] - degC[0]) / (float(t_s[-1] - t_s[0]) / 60.0) if t_s[-1] > t_s[0] else math.nan
        return Window(degC.size, float(degC.mean()), slope, spread, None)
    rise = _rise(blocks)
    slope = rise * _BLOCKS / (float(t_s[-1] - t_s[0]) / 60.0)
    chance = _chance(blocks, rise, float(np.sqrt(np.mean(np.diff(degC) ** 2) / 2.0)), low_degC, high_degC)
    return Window(degC.size, float(degC.mean()), slope, spread, chance)


def _means(t_s: Array, degC: Array) -> Array | None:
    """Return means of tenths of the window; None if one has fewer than two samples."""
    edges = np.linspace(t_s[0], t_s[-1], _BLOCKS + 1)
    starts = np.searchsorted(t_s, edges[:-1])
    if (np.diff(np.append(starts, t_s.size)) < 2).any():
        return None
    return np.asarray(np.add.reduceat(degC, starts) / np.diff(np.append(starts, t_s.size)))


def _rise(blocks: Array) -> float:
    """Return the slope of the line through the means, in degC per block."""
    places = np.arange(_BLOCKS) - (_BLOCKS - 1) / 2.0
    return float(places @ blocks / (places @ places))


def _chance(blocks: Array, rise: float, scatter: float, low_degC: float, high_degC: float) -> float:
    half = _BLOCKS // 2
    wander = _GROWTH * math.sqrt(float(np.mean((blocks[half:] - blocks[:-half] - half * rise) ** 2)))
    level = float(blocks[-_LEVEL:].mean()) + _LEVEL / 2.0 * rise  # carried on from the middle of these blocks to now
    ahead = level + _BLOCKS * rise
    edge = _SCATTER * scatter
    up, down = high_degC - edge - max(level, ahead), min(level, ahead) - low_degC - edge
    beyond = 2.0 * sum(_tail(room, wander) for room in (up, down))  # a walk that ends inside may have been outside
    return min(1.0, _SCATTER_CHANCE + beyond)


def _tail(room: float, std: float) -> float:
    """Return the probability that a deviation of a standard deviation known from ``_DOF`` exceeds a room."""
    if std == 0.0:
        return 0.0 if room > 0.0 else 1.0
    angle = math.atan(room / std / math.sqrt(_DOF))
    square = math.cos(angle) ** 2
    inside = math.sin(angle) * (1.0 + square / 2.0 * (1.0 + square * 3.0 / 4.0 * (1.0 + square * 5.0 / 6.0)))
    return 0.5 * (1.0 - inside)
