"""How a temperature comes to rest: the lag of its approach, and how far it is at most from where it is going.

Behind air that stands still, whatever is warmed by it approaches its end as a sum of exponentials, one for each mass on
the way of its heat; self-heating and the error of a sensor move the end and change no lag. One lag is fitted and,
beside it, each slower one in turn: as long as the readings do not rule out that a slow part is still to come, it
counts. Neighbouring residuals are alike where a chamber wanders, or the model lacks something: the variance of a mean
is larger by (1 + r) / (1 - r), r their correlation.

Source: heat balance of linear masses, C dT/dt = G (air - T), whose free solutions are exponentials; Gauss and Newton's
method: Björck, Numerical Methods for Least Squares Problems, section 9.2; variance where the correlation falls by r
from one value to the next: Bayley and Hammersley (1946), J. R. Stat. Soc. Suppl. 8, 184.

Whether a temperature has settled: every sample of a window, and the chance that it leaves its band soon after.

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

from bench.maths.arrays import Floats

_LEAST = 10  # means
_COVERAGE = 3.0  # 99.7 % of one look, because a soak is looked at again and again and ends at the first that fits
_OTHERWISE = 0.05  # of a lag: by so much air and convection may change it from one temperature to another
_UNFITTED = 0.1  # of what is left: by so much parts that are faster than the lag, and not fitted, may move it
_ALONE = 0.2  # of a lag: by so much a slow part that is not seen may be in that of one exponential alone
_GRID = 300  # places where a lag of which nothing is known is looked for, from the time of one mean to the longest
_SLOWER, _RIVALS = 1.5, 12  # the least slow rival, in lags, and how many there are up to the longest
_RULED_OUT = 9.0  # variances by which a rival explains less than the best: 99.7 % too
_ROUNDS, _STEP, _CONVERGED = 12, 0.2, 1e-4  # of the logarithm of the lag
_AHEAD = (0.0, 1.0, 2.0, 4.0)  # lags from now, at which the distance from the end is looked at
_BLOCKS = 10
_LEVEL = 3  # blocks that tell where the temperature is now
_GROWTH = math.sqrt(2.0)  # of a random walk, from half a window to a whole one
_DOF = 8  # of the wandering seen in one window; with fewer nothing is ever stable, with more too much is
_SCATTER, _SCATTER_CHANCE = 4.15, 0.01  # of 300 independent samples of either sign, as many standard deviations off


@dataclass(frozen=True)
class Lag:
    """A lag and its standard uncertainty, ``share`` of it, whatever slow part is beside it."""

    lag_s: float
    share: float


@dataclass(frozen=True)
class Relaxation:
    """What is left of an approach at a moment: ``residual_degC``, where it is minus where it goes, by the best fit.

    ``bound_degC``: how far from its end it is, or will still be, at most, with every slow part that is not ruled out.
    """

    residual_degC: float
    bound_degC: float
    lag: Lag


@dataclass(frozen=True)
class _Fit:
    """End, amplitude, change of the logarithm of the lag, amplitude of the slower part; covariance; sum of squares."""

    parameters: Floats
    covariance: Floats
    square: float
    slower_s: float


def relaxation_of(t_s: Floats, degC: Floats, now_s: float, longest_s: float, known: Lag | None) -> Relaxation | None:
    """Return how far a temperature is from its end; None if there are too few means to tell.

    Args:    t_s, degC: means over times of one length, (n,), rising, behind air that stands still.   now_s: the moment.
             longest_s: the slowest lag that may be there.   known: the lag by earlier approaches; None: what one
             exponential alone says.
    Source:  see the module.
    """
    if t_s.size < _LEAST:
        return None
    since_s = t_s - t_s[0]
    known = Lag(_one_lag(since_s, degC, longest_s), _ALONE) if known is None else known
    lag_s = known.lag_s
    for _ in range(_ROUNDS):
        fits, variance = _fits(since_s, degC, lag_s, longest_s, known)
        best = min(fits, key=lambda fit: fit.square)
        step = float(np.clip(best.parameters[2], -_STEP, _STEP))
        if abs(step) < _CONVERGED:
            break
        lag_s *= math.exp(step)
    possible = [fit for fit in fits if fit.square <= best.square + _RULED_OUT * variance]
    moments = [now_s - float(t_s[0]) + ahead * lag_s for ahead in _AHEAD]
    ends = [end for fit in possible for end in _left(fit, lag_s, moments)]
    bound = max((1.0 + _UNFITTED) * abs(left) + _COVERAGE * std for left, std in ends)
    ((residual, _),) = _left(best, lag_s, moments[:1])
    share = max(math.hypot(float(fit.parameters[2]), math.sqrt(float(fit.covariance[2, 2]))) for fit in possible)
    return Relaxation(residual, bound, Lag(lag_s, share))


def _one_lag(t_s: Floats, degC: Floats, longest_s: float) -> float:
    """Return the lag of one exponential that explains most."""
    lags_s = np.geomspace(t_s[1], longest_s, _GRID)
    columns = np.exp(-t_s / lags_s[:, None])
    columns -= columns.mean(axis=1, keepdims=True)
    explained = (columns @ degC) ** 2 / (columns**2).sum(axis=1)
    return float(lags_s[int(explained.argmax())])


def _fits(t_s: Floats, degC: Floats, lag_s: float, longest_s: float, known: Lag) -> tuple[list[_Fit], float]:
    """Return the fit with each slower rival, near a lag, and the variance of a mean; what is known counts as a reading.

    The variance is that of the fit which leaves least by the means alone.
    """
    decay = np.exp(-t_s / lag_s)
    line = np.column_stack((np.ones_like(t_s), decay))
    amplitude = np.linalg.lstsq(line, degC, rcond=None)[0][1]
    rivals_s = np.geomspace(_SLOWER * lag_s, max(longest_s, 2.0 * _SLOWER * lag_s), _RIVALS)
    designs = np.empty((_RIVALS, t_s.size + 1, 4))  # below the means, what is known of the lag
    designs[:, :-1] = np.column_stack((line, amplitude * decay * t_s / lag_s, decay))
    designs[:, :-1, 3] = np.exp(-t_s / rivals_s[:, None])
    lefts = degC - (designs[:, :-1] @ (np.linalg.pinv(designs[:, :-1]) @ degC)[:, :, None])[:, :, 0]
    variance = _variance(lefts[int((lefts**2).sum(axis=1).argmin())])
    weight = math.sqrt(variance) / max(_OTHERWISE, known.share)
    designs[:, -1] = 0.0, 0.0, weight, 0.0
    readings = np.append(degC, weight * math.log(known.lag_s / lag_s))
    inverses = np.linalg.pinv(designs)
    parameters = inverses @ readings
    squares = ((readings - (designs @ parameters[:, :, None])[:, :, 0]) ** 2).sum(axis=1)
    covariances = variance * inverses @ inverses.transpose(0, 2, 1)
    rivals = zip(parameters, covariances, squares.tolist(), rivals_s.tolist(), strict=True)
    return [_Fit(*rival) for rival in rivals], variance


def _variance(left: Floats) -> float:
    """Return the variance of residuals, as large as their likeness to their neighbours makes it."""
    free, square = 5, float(left @ left)
    alike = float(left[1:] @ left[:-1]) / max(square, 1e-300)
    alike += free * (1.0 + max(alike, 0.0)) / left.size  # a fit takes with it what is alike
    alike = min(max(alike, 0.0), 1.0 - 2.0 / left.size)
    return square / (left.size - free) * (1.0 + alike) / (1.0 - alike)


def _left(fit: _Fit, lag_s: float, moments_s: list[float]) -> list[tuple[float, float]]:
    """Return how far it is from its end at moments, and the standard uncertainties."""
    found = []
    for moment_s in moments_s:
        decay = math.exp(-moment_s / lag_s)
        of_lag = fit.parameters[1] * decay * moment_s / lag_s
        slopes = np.array([0.0, decay, of_lag, math.exp(-moment_s / fit.slower_s)])
        std = math.sqrt(float(slopes @ fit.covariance @ slopes))
        found.append((float(slopes @ fit.parameters), std))
    return found


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


def window_of(t_s: Floats, degC: Floats, low_degC: float, high_degC: float) -> Window:
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


def _means(t_s: Floats, degC: Floats) -> Floats | None:
    """Return means of tenths of the window; None if one has fewer than two samples."""
    edges = np.linspace(t_s[0], t_s[-1], _BLOCKS + 1)
    starts = np.searchsorted(t_s, edges[:-1])
    if (np.diff(np.append(starts, t_s.size)) < 2).any():
        return None
    return np.add.reduceat(degC, starts) / np.diff(np.append(starts, t_s.size))


def _rise(blocks: Floats) -> float:
    """Return the slope of the line through the means, in degC per block."""
    places = np.arange(_BLOCKS) - (_BLOCKS - 1) / 2.0
    return float(places @ blocks / (places @ places))


def _chance(blocks: Floats, rise: float, scatter: float, low_degC: float, high_degC: float) -> float:
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
