"""Average run lengths of EWMA and CUSUM charts of normal scores: how many points until the first signal.

A chart plots scores that are standard normal while nothing has changed. A score is made with an estimated standard
deviation: ``x / ratio`` takes its place in Student's distribution of the degrees of freedom, and the score has the
same place in the normal one. For a known standard deviation the score is x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import special

from bench.maths.arrays import Floats
from bench.maths.tests import SMALLEST

EWMA_WEIGHT = 0.2  # of the newest score
CUSUM_REFERENCE = 0.5  # half the shift, in standard deviations, that a CUSUM is quickest for
_STATES, _COARSE = 81, 41  # of a chain; odd: the middle one is zero
_FARTHEST = 8.2  # scores beyond it have no place in the normal distribution of doubles
_GRID = 4001


@dataclass(frozen=True)
class Scores:
    """The distribution of plotted scores.

    ``shift`` of the mean in true standard deviations; ``ratio`` of the estimated standard deviation to the true one,
    of an estimate with ``dof`` degrees of freedom (infinite: known, and the ratio is one).
    """

    shift: float = 0.0
    ratio: float = 1.0
    dof: float = math.inf

    def below(self, score: Floats) -> Floats:
        """Return the probability of a score not above each of ``score``, any shape."""
        return np.asarray(special.ndtr(self.ratio * _quotients(score, self.dof) - self.shift))

    def mirrored(self) -> Scores:
        """Return the distribution of the negative scores."""
        return Scores(-self.shift, self.ratio, self.dof)


def normal_scores(quotient: Floats, dof: Floats) -> Floats:
    """Return scores that are standard normal if the quotients follow Student's distribution.

    Args:    quotient: reading minus prediction over its estimated standard deviation, any shape.
             dof: degrees of freedom of that estimate, the same shape; infinite where it is known.
    Returns: scores, -8.2 to 8.2, NaN where a quotient is NaN.
    Raises:  nothing.
    Source:  C. P. Quesenberry, Journal of Quality Technology 23 (1991) 213 (Q statistics).
    """
    known = np.isinf(dof)
    tail = np.where(known, special.ndtr(-np.abs(quotient)), special.stdtr(np.where(known, 1.0, dof), -np.abs(quotient)))
    return np.asarray(np.sign(quotient) * np.minimum(-special.ndtri(np.maximum(tail, SMALLEST)), _FARTHEST))


def ewma_run_length(limit: float, scores: Scores, weight: float = EWMA_WEIGHT) -> float:
    """Return the average run length of ``e = (1 - weight) e + weight score`` from e = 0, two-sided, by a Markov chain.

    Two chains of different width, extrapolated: one alone gives up to 1 % less where the weight is small.

    Args:    limit: in standard deviations of e after many points, ``sqrt(weight / (2 - weight))``.
             scores: their distribution.   weight: of the newest score, 0 to 1.
    Returns: points until the first signal, on average.
    Raises:  nothing.
    Source:  J. M. Lucas, M. S. Saccucci, Technometrics 32 (1990) 1, appendix (Markov chain).
    """
    coarse, fine = (_ewma_chain(limit, scores, weight, states) for states in (_COARSE, _STATES))
    return fine + (fine - coarse) / ((_STATES / _COARSE) ** 2 - 1.0)  # its error goes with the width squared


def _ewma_chain(limit: float, scores: Scores, weight: float, states: int) -> float:
    half = limit * ewma_std(weight)
    edges = np.linspace(-half, half, states + 1)
    centres = 0.5 * (edges[1:] + edges[:-1])
    below = scores.below((edges[None, :] - (1.0 - weight) * centres[:, None]) / weight)
    return _steps_to_leave(np.diff(below, axis=1))[states // 2]


def ewma_std(weight: float = EWMA_WEIGHT) -> float:
    """Return the standard deviation of an EWMA of standard normal scores after many points. Raises: nothing."""
    return math.sqrt(weight / (2.0 - weight))


def cusum_run_length(limit: float, scores: Scores) -> float:
    """Return the average run length of a two-sided CUSUM from zero, by a Markov chain for each side.

    Each side is ``s = max(0, s + score - CUSUM_REFERENCE)``, the other one with negative scores; a signal is s > limit.

    Args:    limit: decision interval in standard deviations.   scores: their distribution.
    Returns: points until the first signal, on average; of both sides by 1 / L = 1 / L+ + 1 / L-.
    Raises:  nothing.
    Source:  D. Brook, D. A. Evans, Biometrika 59 (1972) 539 (chain); J. M. Lucas, R. B. Crosier, Technometrics 24
             (1982) 199 (both sides).
    """
    return 1.0 / sum(1.0 / _one_sided(limit, side) for side in (scores, scores.mirrored()))


def _one_sided(limit: float, scores: Scores) -> float:
    width = 2.0 * limit / (2 * _STATES - 1)
    steps = np.arange(1 - _STATES, _STATES + 1, dtype=np.float64) - 0.5  # edges of the states, seen from each other
    below = scores.below(steps * width + CUSUM_REFERENCE)
    place = np.arange(_STATES)[None, :] - np.arange(_STATES)[:, None] + _STATES - 1
    moves = below[place + 1] - below[place]
    moves[:, 0] = below[place[:, 0] + 1]  # all that falls below is zero
    return _steps_to_leave(moves)[0]


def _steps_to_leave(moves: Floats) -> list[float]:
    """Return how many steps a chain takes on average to leave its states, from each of them."""
    left: list[float] = np.linalg.solve(np.eye(moves.shape[0]) - moves, np.ones(moves.shape[0])).tolist()
    return left


def _quotients(score: Floats, dof: float) -> Floats:
    """Return the quotients of scores, the inverse of ``normal_scores``."""
    if math.isinf(dof):
        return score
    at, quotients = _table(dof)
    return np.interp(score, at, quotients)


@cache
def _table(dof: float) -> tuple[Floats, Floats]:
    at = np.linspace(-_FARTHEST, _FARTHEST, _GRID)
    return at, np.sign(at) * -special.stdtrit(dof, special.ndtr(-np.abs(at)))
