"""Shewhart, EWMA and CUSUM charts of one series of scores, and what they signal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.maths.control.limits import Limits
from bench.maths.control.run_lengths import CUSUM_REFERENCE, EWMA_WEIGHT, ewma_std

Array = NDArray[np.float64]


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

    shewhart: Array
    ewma: Array  # in its own standard deviations
    cusum_up: Array
    cusum_down: Array  # negative
    signals: tuple[Signal, ...]  # in order of the points


def chart(scores: Array, limits: Limits) -> Charts:
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


def _signals(kind: str, line: Array, limit: float) -> list[Signal]:
    """Return the first point of each stretch beyond the limits on one side."""
    beyond = np.where(np.abs(line) > limit, np.sign(line), 0.0)
    before = np.concatenate([[0.0], beyond[:-1]])
    begins = np.flatnonzero((beyond != 0.0) & (beyond != before))
    return [Signal(kind, int(point), float(line[point]), limit) for point in begins]
