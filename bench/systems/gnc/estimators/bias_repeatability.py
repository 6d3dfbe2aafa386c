"""Repeatability of a bias: scatter of the means of six windows of 10 min that lie at least 10 min apart.

Windows without gaps are parts of one record: their scatter is the noise of a long mean, not what returns after a pause.

Source: GNC paper (001) section 5.1 3); standard deviation with n - 1, interval by chi-square (JCGM 100:2008 4.2.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bench.model.errors import FitError

Array = NDArray[np.float64]
WINDOWS, WINDOW_s, APART_s = 6, 600.0, 1200.0  # how many, how long at least, from start to start at least
_SLACK_s = 1.0  # of starts and lengths: commands and answers take their time
_PROBABILITY = 0.95


@dataclass(frozen=True)
class BiasRepeatability:
    """``value``: standard deviation of the means, unit of the means; ``low``, ``high``: 95 % interval; ``dof``: n - 1.

    ``means`` (n,): of the windows.   ``noise_std``: what the uncertainty of the means alone leads to expect.
    """

    value: float
    low: float
    high: float
    dof: int
    means: Array
    noise_std: float

    @property
    def std(self) -> float:
        """Standard uncertainty of ``value``."""
        return self.value / math.sqrt(2.0 * self.dof)


def bias_repeatability(
    means: Sequence[float], stds: Sequence[float], starts_s: Sequence[float], lengths_s: Sequence[float]
) -> BiasRepeatability:
    """Repeatability and its interval.

    Args:    means, stds: of the windows and their standard uncertainties.   starts_s, lengths_s: of the windows.
    Returns: BiasRepeatability.
    Raises:  FitError B-FIT-093 for fewer than six windows, one shorter than 10 min or starts less than 20 min apart.
    Source:  see the head of this file.
    """
    order = np.argsort(starts_s)
    starts, lengths = np.asarray(starts_s, np.float64)[order], np.asarray(lengths_s, np.float64)[order]
    _require(starts, lengths)
    values = np.asarray(means, np.float64)[order]
    value, dof = float(np.std(values, ddof=1)), values.size - 1
    tails = stats.chi2.ppf([0.5 + _PROBABILITY / 2.0, 0.5 - _PROBABILITY / 2.0], dof)
    low, high = value * np.sqrt(dof / tails)
    noise_std = float(np.sqrt(np.mean(np.square(stds))))
    return BiasRepeatability(value, float(low), float(high), dof, values, noise_std)


def _require(starts: Array, lengths: Array) -> None:
    reason = ""
    if starts.size < WINDOWS:
        reason = f"{starts.size} windows, {WINDOWS} are due"
    elif lengths.min() < WINDOW_s - _SLACK_s:
        reason = f"window {int(np.argmin(lengths)) + 1} is {lengths.min():.0f} s long, {WINDOW_s:.0f} s are due"
    elif np.diff(starts).min() < APART_s - _SLACK_s:
        place = int(np.argmin(np.diff(starts)))
        reason = (
            f"windows {place + 1} and {place + 2} start {np.diff(starts)[place]:.0f} s apart, {APART_s:.0f} s are due"
        )
    if reason:
        raise FitError(
            "B-FIT-093",
            f"no repeatability of a bias: {reason}",
            next_step="take six windows of 10 min with pauses of at least 10 min between them",
        )
