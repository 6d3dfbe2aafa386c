"""The dense covariance that a whitener stands for; the product never forms it."""

from __future__ import annotations

import numpy as np

from bench.maths.arrays import Floats
from bench.systems.af_converter.estimators.gates import Whitener


def covariance_of(whitener: Whitener) -> Floats:
    """Return the covariance V itself, (m, m), in the unit of the readings squared."""
    rows = whitener.factor.shape[1]
    factor = sum(
        np.diag(diagonal[: rows - below], -below) for below, diagonal in enumerate(whitener.factor) if below < rows
    )
    return np.asarray(np.cumsum(np.cumsum(factor @ factor.T, axis=0), axis=1))
