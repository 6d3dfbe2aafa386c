"""The arrays that estimators take and give, by what is in them, and their root mean square."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.model.arrays import Flags, Floats, Integers

__all__ = ["Flags", "Floats", "Integers", "rms"]


def rms(values: ArrayLike) -> float:
    """Return the root mean square of all values, in their unit."""
    return float(np.sqrt(np.mean(np.square(values))))
