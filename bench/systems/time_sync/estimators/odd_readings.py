"""Single readings of a smooth series that are unlike their neighbours, as one bad frame among thousands makes them.

Source: prediction by the cubic through two readings on either side; scatter by the median of the residuals, which a few
bad readings do not change. A kink, as where a turn begins, is no bad reading: its neighbours stay odd without it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]
MOST = 1e-3  # of the readings, one at the least
_SCATTERS = 40.0  # a smaller one does no harm, and a small kink looks like it
_LEFT = 0.12  # of what was odd, among the neighbours of a bad reading once it is replaced; of a kink a sixth is left
_WEIGHTS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
_STD = 1.4826
_RESOLUTION = 1e-13  # of the largest value: what arithmetic leaves
_KINKS = 50  # places that are looked at
_LEAST = 50  # readings, of which the scatter is told
_TINY = 1e-300


def odd_readings(values: Array, counter: Int64) -> Int64:
    """Return the places of bad readings in rising order, at most one in a thousand or one.

    Args:    values: (n, c).   counter: (n,), rising; only readings without a gap around them are judged.
    Source:  see the head of this file.
    """
    if len(values) < _LEAST:
        return np.zeros(0, np.int64)
    values, most = values.copy(), max(1, int(MOST * len(values)))
    off = _off(values)
    scale = _STD * np.median(np.abs(off), axis=0) + _RESOLUTION * np.abs(values).max(axis=0) + _TINY
    open_to_doubt = np.zeros(len(values), bool)
    open_to_doubt[2:-2] = counter[4:] - counter[:-4] == 4
    odd: list[int] = []
    for _ in range(_KINKS):
        score = np.where(open_to_doubt, np.abs(off / scale).max(axis=1), 0.0)
        at = int(np.argmax(score))
        if len(odd) == most or score[at] <= _SCATTERS:
            break
        replaced = values[at] - off[at]
        again = _off(np.concatenate((values[max(at - 5, 0) : at], [replaced], values[at + 1 : at + 6])))
        if np.abs(again / scale).max() < _LEFT * score[at]:
            odd.append(at)
            values[at] = replaced
            off = _off(values)
        else:
            open_to_doubt[max(at - 2, 0) : at + 3] = False
    return np.array(sorted(odd), np.int64)


def _off(values: Array) -> Array:
    """Return readings minus their prediction, (n, c); zero for two at either end."""
    out = np.zeros_like(values)
    count = len(values) - 4
    out[2:-2] = values[2:-2] - sum(weight * values[k : k + count] for k, weight in enumerate(_WEIGHTS))
    return out
