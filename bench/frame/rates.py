"""Rates of what frames count: the mean over ``MEAN_S``. A mean that lacks half of its frames or more is NaN: a gap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.frame.signals import MEAN_S, Signal
from bench.model.clock import NS

Array = NDArray[np.float64]


def means(sums: Array, counts: NDArray[np.intp], rate_Hz: Array | float) -> Array:
    """Return sums over ``MEAN_S`` as means, (m, k); NaN where not more than half of the frames came.

    Args: sums: (m, k).   counts: of the frames in each sum, (m, k) or (m, 1).   rate_Hz: of the frames, (k,) or one.
    """
    enough = counts * 2 > np.asarray(rate_Hz) * MEAN_S
    found: Array = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=enough)
    return found


def trailing_means(t_ns: NDArray[np.int64], signals: Sequence[Signal], values: Array) -> Array:
    """Return values of frames with those of rates replaced by their mean over ``MEAN_S`` up to each frame, (n, k).

    Args: t_ns: of the frames, (n,), never falling.   signals: (k,).   values: as ``columns`` gives them, (n, k).
    """
    places = rates_among(signals)
    if not len(places) or not len(t_ns):
        return values
    first = np.searchsorted(t_ns, t_ns - round(MEAN_S * NS), side="right")
    total = np.concatenate((np.zeros((1, len(places))), np.cumsum(values[:, places], axis=0)))
    sums = total[1:] - total[first]
    found = values.copy()
    found[:, places] = means(sums, (np.arange(1, len(t_ns) + 1) - first)[:, None], rates_Hz(signals)[places])
    return found


def rates_among(signals: Sequence[Signal]) -> NDArray[np.intp]:
    """Return places of the rates among signals."""
    return np.flatnonzero(rates_Hz(signals))


def rates_Hz(signals: Sequence[Signal]) -> Array:
    """Return ``rate_Hz`` of each signal, (k,)."""
    return np.array([signal.rate_Hz for signal in signals], np.float64)
