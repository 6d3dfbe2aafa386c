"""Single samples that no motion makes: far outside of what both neighbours on either side show.

A turn that begins or ends takes the samples behind it along, so its edge lies between its neighbours; a flipped bit or
a disturbed transfer does not. A bad sample is replaced by the mean of its neighbours, because an integral needs every
sample; they are few, or none is replaced.

Source: Rousseeuw and Croux, J. Am. Stat. Assoc. 88 (1993) 1273 (median absolute deviation as scale).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_FAR = 10.0  # standard deviations of the noise
_SECOND = 1.4826 / 6.0**0.5  # from the median of second differences to the standard deviation of a sample
_COARSE = 0.5  # of a step: noise of less is hidden in the steps
LARGEST_SHARE = 1e-3


def bad_samples(values: Array, step: float) -> NDArray[np.bool_]:
    """Return which samples stand alone outside of their neighbours.

    Args:    values: (n, k) outputs.   step: of the output, same unit.
    Returns: (n, k); at most one in a thousand of a column, or one. All false in a column where more stand out.
    Source:  see the head of this file.
    """
    bad = np.zeros(values.shape, np.bool_)
    if len(values) < 5:
        return bad
    around = np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]])
    beyond = np.maximum(values[2:-2] - around.max(axis=0), around.min(axis=0) - values[2:-2])
    noise = _SECOND * np.median(np.abs(np.diff(values, 2, axis=0)), axis=0)
    bad[2:-2] = beyond > _FAR * np.maximum(noise, _COARSE * step)
    bad[:, bad.sum(axis=0) > max(1.0, LARGEST_SHARE * len(values))] = False
    return bad


def bridged(values: Array, bad: NDArray[np.bool_]) -> Array:
    """Return the same with the mean of both neighbours in place of each bad sample, (n, k).

    Args:    values: (n, k).   bad: as ``bad_samples``.
    Returns: (n, k).
    Source:  linear interpolation.
    """
    mended = values.copy()
    rows, columns = np.nonzero(bad)
    mended[rows, columns] = (values[rows - 1, columns] + values[rows + 1, columns]) / 2.0
    return mended
