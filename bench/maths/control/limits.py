"""Limits of control charts by the run length that is declared for all charts of a subject together.

The limits hold the error of the first phase: the standard deviation of the scores rests on it. Averaged over first
phases, the rate of false signals is the declared one.

Shewhart, EWMA and CUSUM charts of one series of scores, and what they signal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import special
from scipy.optimize import brentq

from bench.maths.arrays import Floats
from bench.maths.control.run_lengths import (
    CUSUM_REFERENCE,
    EWMA_WEIGHT,
    Scores,
    cusum_run_length,
    ewma_run_length,
    ewma_std,
)

KINDS = ("shewhart", "ewma", "cusum")
_NODES = 24
_NEGLIGIBLE = 1e-3  # part of the rate, given up at the end of the integral
_MOST = 200.0  # standard deviations, beyond every limit


@dataclass(frozen=True)
class Limits:
    """Limits of the three charts of one series of scores: of scores, of the EWMA in its own standard deviations, of the
    CUSUM in those of a score. ``run_length`` of each single chart; ``dof`` of the first phase."""

    shewhart: float
    ewma: float
    cusum: float
    run_length: float
    dof: float


def limits_for(run_length: float, series: int, dof: float = math.inf) -> Limits:
    """Return limits so that all charts of a subject together have a declared in-control run length.

    The rates of false signals of all charts are added, as if no two ever signalled together: charts of parameters that
    move together, and the three charts of one parameter, signal together, so the true run length is longer. Of a
    single chart the rate is averaged over first phases: ``E[1 / L(ratio)] = 1 / (3 series run_length)``, where L is the
    run length if the first phase gave ``ratio`` times the true standard deviation.

    Args:    run_length: points of the subject until the first false signal of any of its charts, > 1.
             series: of scores, each on three charts.   dof: degrees of freedom of the standard deviation, at least 1;
             only whole ones count.
    Returns: Limits.
    Raises:  nothing.
    Source:  W. Albers, W. C. M. Kallenberg, Metrika 59 (2004) 207 (error of the first phase in the rate of false
             signals); L. A. Jones, C. W. Champ, S. E. Rigdon, Technometrics 43 (2001) 156 (average over first phases).
    """
    return _limits(float(run_length) * series * len(KINDS), float(math.floor(dof)) if math.isfinite(dof) else math.inf)


@cache
def _limits(run_length: float, dof: float) -> Limits:
    shewhart = float(-special.ndtri(0.5 / run_length))  # scores are normal on average over first phases
    return Limits(
        shewhart=shewhart,
        ewma=_solved(ewma_run_length, run_length, dof),
        cusum=_solved(cusum_run_length, run_length, dof),
        run_length=run_length,
        dof=dof,
    )


def false_rate(chart: Callable[[float, Scores], float], limit: float, dof: float, least: float) -> float:
    """Return the rate of false signals of a chart, averaged over first phases.

    Args:    chart: run length by limit and scores.   limit: of that chart.   dof: of the first phase.
             least: a rate that matters; what is much rarer is left out of the average.
    Returns: signals for each point in control.
    Raises:  nothing.
    Source:  Jones, Champ and Rigdon 2001, equation (14), with the scale alone.
    """
    if math.isinf(dof):
        return 1.0 / chart(limit, Scores())
    low, high = (special.gammaincinv(dof / 2.0, tail) for tail in (_NEGLIGIBLE * least, 1.0 - 1e-4))
    at, weights = np.polynomial.legendre.leggauss(_NODES)
    middle, half = 0.5 * math.log(low * high), 0.5 * math.log(high / low)
    gamma = np.exp(middle + half * at)  # dof ratio^2 / 2 has a gamma distribution
    density = np.exp(dof / 2.0 * np.log(gamma) - gamma - special.gammaln(dof / 2.0))
    rates = [1.0 / chart(limit, Scores(ratio=math.sqrt(2.0 * value / dof), dof=dof)) for value in gamma.tolist()]
    return float(half * np.sum(weights * density * rates))


def _solved(chart: Callable[[float, Scores], float], run_length: float, dof: float) -> float:
    wanted = 1.0 / run_length

    def excess(limit: float) -> float:
        return math.log(false_rate(chart, limit, dof, wanted) / wanted)

    high = 6.0
    while excess(high) > 0.0 and high < _MOST:
        high *= 1.5
    return float(brentq(excess, 0.5, high, xtol=1e-4))


@dataclass(frozen=True)
class Signal:
    """A point beyond the limit of a chart, the first of those that follow each other; ``statistic`` has its sign."""

    kind: str  # "shewhart", "ewma" or "cusum"
    point: int
    statistic: float
    limit: float


@dataclass(frozen=True)
class Charts:
    """The three charts of a series of scores, (n,) each; NaN scores are passed over, their points repeat the state."""

    shewhart: Floats
    ewma: Floats  # in its own standard deviations
    cusum_up: Floats
    cusum_down: Floats  # negative
    signals: tuple[Signal, ...]  # in order of the points


def chart(scores: Floats, limits: Limits) -> Charts:
    """Plot scores on all three charts, from zero on; a chart goes on behind a signal.

    Args:    scores: (n,), standard normal in control, NaN where there is none.   limits: of the charts.
    Returns: Charts.
    Raises:  nothing.
    Source:  Montgomery, Introduction to Statistical Quality Control, sections 6.4, 9.1 (tabular CUSUM) and 9.2 (EWMA).
    """
    plotted = np.zeros((3, scores.size))
    ewma, up, down = 0.0, 0.0, 0.0
    for place, score in enumerate(scores.tolist()):
        if not math.isnan(score):
            ewma = (1.0 - EWMA_WEIGHT) * ewma + EWMA_WEIGHT * score
            up, down = max(0.0, up + score - CUSUM_REFERENCE), min(0.0, down + score + CUSUM_REFERENCE)
        plotted[:, place] = ewma / ewma_std(), up, down
    either = np.where(plotted[1] >= -plotted[2], plotted[1], plotted[2])
    lines = (("shewhart", scores, limits.shewhart), ("ewma", plotted[0], limits.ewma), ("cusum", either, limits.cusum))
    signals = [signal for kind, line, limit in lines for signal in _signals(kind, line, limit)]
    signals.sort(key=lambda signal: signal.point)
    return Charts(scores, plotted[0], plotted[1], plotted[2], tuple(signals))


def _signals(kind: str, line: Floats, limit: float) -> list[Signal]:
    """Return the first point of each stretch beyond the limits on one side."""
    beyond = np.where(np.abs(line) > limit, np.sign(line), 0.0)
    before = np.concatenate([[0.0], beyond[:-1]])
    begins = np.flatnonzero((beyond != 0.0) & (beyond != before))
    return [Signal(kind, int(point), float(line[point]), limit) for point in begins]
