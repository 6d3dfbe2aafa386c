"""Line of the least delay where receive stamps come in steps, because the bench looks at its ports at intervals.

A frame stamped r arrived between r - step and r. With the least delay on a line, an exponential excess delay and normal
noise of the tags, every frame has a probability, and the line is the most likely one.

Source: distribution of a normal plus an exponential variable, Grushka, Analytical Chemistry 44 (1972); covariance by
White, Econometrica 50 (1982), over blocks of time; JCGM 100:2008 section 4.3.7 for rectangular bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from bench.maths.arrays import Floats, Integers

_COMMON = 5  # times that a difference between stamps comes
_FINE_s = 1e-5  # steps below are none
_LEAST_NOISE = 0.003  # of a step: below, the likelihood has corners
_LEAST_EXCESS = 0.1  # of a step: below, most frames of a stretch say the same
_BLOCKS = 40
_STARTS = (0.02, 0.35, 0.7)  # of a step below the lowest delays
_TINY = 1e-300
_BOUND = np.diag([1.0 / 12.0, 1.0 / 6.0, 1.0 / 12.0])  # of a step, rectangular; what a level hides is taken for jitter


@dataclass(frozen=True)
class Grid:
    """``place``: -1 to 1 over the recording, (n,).   ``delay_s``: (n,).   ``step_s``: of the stamps.
    ``noise_s``: of the tags.
    """

    place: Floats
    delay_s: Floats
    step_s: float
    noise_s: float


def grid_s(received_ns: Integers) -> float:
    """Step of receive stamps, 0 if there is none above 10 us.

    Args:    received_ns: (n,), of all ports that the bench looks at together.
    Returns: second: the greatest common divisor of the differences that come more than once in a while.
    Source:  a clock that is read at any time repeats no difference.
    """
    differences, counts = np.unique(np.diff(np.sort(received_ns)), return_counts=True)
    often = differences[(counts >= _COMMON) & (differences > 0)]
    step_s = float(np.gcd.reduce(often)) * 1e-9 if often.size else 0.0
    return step_s if step_s >= _FINE_s else 0.0


def grid_line(grid: Grid, level_s: float, slope_s: float) -> tuple[float, float, float, Floats]:
    """Most likely line of the least delay.

    Args:    grid: the delays.   level_s, slope_s: line below all of them, per unit of place.
    Returns: level, slope, mean excess delay, covariance (3, 3) of the three; seconds.
    Source:  see the head of this file.
    """
    delay = (grid.delay_s - level_s - slope_s * grid.place) / grid.step_s
    noise = max(grid.noise_s / grid.step_s, _LEAST_NOISE)
    excess = math.log(max(float(delay.mean()) - 0.5, 0.05))

    def cost(at: Floats) -> tuple[float, Floats]:
        value, scores = _log_likelihood(delay, grid.place, noise, at)
        return -float(value.mean()), -scores.mean(axis=0)

    solutions = [
        optimize.minimize(cost, np.array([-start, 0.0, excess]), jac=True, method="BFGS", options={"gtol": 1e-7})
        for start in _STARTS
    ]
    best = min(solutions, key=lambda solution: float(solution.fun))
    at = np.asarray(best.x, np.float64)
    jitter = math.exp(float(at[2]))
    covariance = _shown(_covariance(delay, grid.place, noise, at), jitter)
    if covariance is None:
        at, covariance = np.array([-0.5, 0.0, at[2]]), _BOUND
    level, slope = level_s + float(at[0]) * grid.step_s, slope_s + float(at[1]) * grid.step_s
    return level, slope, jitter * grid.step_s, covariance * grid.step_s**2


def expected_covariance(grid: Grid, jitter_s: float, frames: int) -> Floats:
    """Return what so many frames like those of a grid will tell of the line, with delays that count from it.

    Args:    grid: delays above the true line, (n,).   jitter_s: mean excess delay.   frames: of the recording.
    Returns: covariance (3, 3) of level, slope and mean excess delay, second squared, by what a likelihood has on the
             average.
    Source:  as ``grid_line``; information grows with the number of frames.
    """
    delay, noise = grid.delay_s / grid.step_s, max(grid.noise_s / grid.step_s, _LEAST_NOISE)
    jitter = jitter_s / grid.step_s
    inverse = _inverse(delay, grid.place, noise, np.array([0.0, 0.0, math.log(jitter)]))
    seen = None if inverse is None else inverse * delay.size / frames
    covariance = _shown(seen, jitter)
    return (_BOUND if covariance is None else covariance) * grid.step_s**2


def _shown(covariance: Floats | None, jitter: float) -> Floats | None:
    """Return the covariance with that of the jitter itself; None where nothing shows the place within a step."""
    if jitter < _LEAST_EXCESS or covariance is None or np.any(np.diag(covariance)[:2] > np.diag(_BOUND)[:2]):
        return None
    by_jitter = np.array([1.0, 1.0, jitter])
    return covariance * np.outer(by_jitter, by_jitter)


def _log_likelihood(delay: Floats, place: Floats, noise: float, at: Floats) -> tuple[Floats, Floats]:
    """Of each frame, (n,), and its derivatives by level, slope and logarithm of the excess, (n, 3); units of a step."""
    excess = math.exp(float(at[2]))
    late = delay - at[0] - at[1] * place
    survived, density, by_excess = _later(late - 1.0, noise, excess)
    more, more_density, more_by_excess = _later(late, noise, excess)
    probability = np.maximum(survived - more, _TINY)
    by_late = (more_density - density) / probability
    by_log = (by_excess - more_by_excess) * excess / probability
    return np.log(probability), np.stack([-by_late, -by_late * place, by_log], axis=1)


def _later(late: Floats, noise: float, excess: float) -> tuple[Floats, Floats, Floats]:
    """Probability of a longer delay, its density, and the derivative of the probability by the mean excess."""
    ratio = noise / excess
    u = late / noise
    exponent = np.minimum(0.5 * ratio**2 - late / excess, 700.0)
    tail = np.exp(exponent + special.log_ndtr(u - ratio))
    peak = np.exp(np.maximum(exponent - 0.5 * (u - ratio) ** 2, -700.0)) / math.sqrt(2.0 * math.pi)
    by_excess = tail * (late / excess**2 - noise**2 / excess**3) + peak * noise / excess**2
    return special.ndtr(-u) + tail, tail / excess, by_excess


def _covariance(delay: Floats, place: Floats, noise: float, at: Floats) -> Floats | None:
    """Of level, slope and logarithm of the excess, (3, 3): the larger of the two of a likelihood; None without a peak.

    The larger one by level and slope.
    """
    inverse = _inverse(delay, place, noise, at)
    if inverse is None:
        return None
    scores = _log_likelihood(delay, place, noise, at)[1]
    part = np.minimum(((place + 1.0) * 0.5 * _BLOCKS).astype(np.int64), _BLOCKS - 1)
    blocks = np.stack([np.bincount(part, scores[:, k], _BLOCKS) for k in range(3)], axis=1)
    robust = inverse @ (blocks.T @ blocks) @ inverse
    return max((inverse, robust), key=lambda covariance: float(np.trace(covariance[:2, :2])))


def _inverse(delay: Floats, place: Floats, noise: float, at: Floats) -> Floats | None:
    """Inverse of the information of a likelihood, (3, 3); None if it has no peak."""
    steps = np.diag([2e-3, 2e-3, 2e-3])

    def gradient(x: Floats) -> Floats:
        return np.asarray(_log_likelihood(delay, place, noise, x)[1].sum(axis=0))

    information = -np.array([(gradient(at + step) - gradient(at - step)) / (2.0 * 2e-3) for step in steps])
    information = 0.5 * (information + information.T)
    if not np.all(np.isfinite(information)) or np.linalg.eigvalsh(information)[0] <= 0.0:
        return None
    return np.linalg.inv(information)
