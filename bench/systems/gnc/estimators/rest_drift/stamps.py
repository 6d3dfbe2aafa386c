"""When the samples of a log were taken: evenly, with gaps, or in bursts whose stamps say when they were written.

Source: a crystal keeps its rate within 1e-4, so increments far from the usual one are the recorder's, not the sensor's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError

Array = NDArray[np.float64]
_CROWDED = 0.5  # of the mean interval: stamped closer than this, samples come in a burst
_BURSTY = 0.01  # share of crowded samples from which the stamps are no times of samples
_GAP = 1.5  # of the usual interval


@dataclass(frozen=True)
class SampleStamps:
    """``rate_Hz`` of the samples.   ``breaks`` (k,): samples in front of which others are missing.   ``missing``: how
    many, by the stamps.   ``crowded``: share of samples stamped less than half an interval behind the one before.
    ``worst_s``: largest distance of a stamp from even spacing.
    """

    rate_Hz: float
    breaks: NDArray[np.int64]
    missing: int
    crowded: float
    worst_s: float

    @property
    def bursty(self) -> bool:
        """Whether the samples have to be counted, because the stamps are not their times."""
        return self.crowded > _BURSTY


def sample_stamps(t_s: Array) -> SampleStamps:
    """Return rate and gaps from the stamps of a log.

    Stamps in bursts give the mean rate of the whole log and no gaps: one sample more or less cannot be told.

    Args:    t_s: (n,) stamps in order, n >= 3.
    Returns: SampleStamps.
    Raises:  FitError B-FIT-141 if all stamps are the same or there are fewer than three.
    Source:  see the head of this file.
    """
    if len(t_s) < 3 or not t_s[-1] > t_s[0]:
        raise FitError(
            "B-FIT-141",
            f"{len(t_s)} time stamps over {float(t_s[-1] - t_s[0]) if len(t_s) else 0.0:g} s tell no rate",
            next_step="map the column that says when a row was taken, or 'format: rows' with the rate of the recorder",
        )
    increments = np.diff(t_s)
    mean = float(t_s[-1] - t_s[0]) / len(increments)
    crowded = float(np.mean(increments < _CROWDED * mean))
    if crowded > _BURSTY:
        even = t_s[0] + mean * np.arange(len(t_s))
        return SampleStamps(1.0 / mean, np.empty(0, np.int64), 0, crowded, float(np.abs(t_s - even).max()))
    usual = float(np.median(increments))
    gap = increments > _GAP * usual
    usual = float(np.mean(increments[~gap]))
    missing = int(np.rint(increments[gap] / usual - 1.0).sum())
    worst = float(np.abs(np.cumsum(np.where(gap, 0.0, increments - usual))).max())
    return SampleStamps(1.0 / usual, np.flatnonzero(gap).astype(np.int64) + 1, missing, crowded, worst)
