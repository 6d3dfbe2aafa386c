"""The mean of readings that follow each other closely: how many independent ones they are worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEWEST = 2.0  # two readings are needed for any scatter


def independent_count(readings: Array) -> float:
    """Return how many independent readings give a mean as certain as that of serially correlated ones.

    Args:    readings: (n,), at equal intervals, any unit.
    Returns: n / (1 + 2 sum (1 - k/n) r_k) with the estimated autocorrelation r_k at the lags k before it first falls
             to zero, so that noise of the estimate is not summed up; 2 at least, n at most, and n where nothing varies.
    Raises:  nothing.
    Source:  A. Zieba, Metrology and Measurement Systems 17 (2010) 3; A. Zieba, P. Ramza, ibid. 18 (2011) 529
             (first transit through zero).
    """
    n = readings.size
    if n <= FEWEST or np.ptp(readings) == 0.0:
        return float(n)
    off = readings - readings.mean()
    size = 1 << (2 * n - 1).bit_length()  # padded, so that the two ends are not correlated
    power = np.abs(np.fft.rfft(off, size)) ** 2
    correlation = np.fft.irfft(power, size)[:n]
    correlation /= correlation[0]
    stop = int(np.argmax(correlation <= 0.0))  # they sum up to -1/2, so one of them is negative
    lags = np.arange(1, stop)
    return float(np.clip(n / (1.0 + 2.0 * np.sum((1.0 - lags / n) * correlation[1:stop])), FEWEST, n))
