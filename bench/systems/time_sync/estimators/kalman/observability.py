"""How much the measurements have told about each state: eigenvalues of the covariance, normalised by its begin.

An eigenvalue near 1 belongs to a direction nothing is known of beyond what was known at the begin, near 0 to a well
observed one. The eigenvalue "associated" with the time offset is the one whose eigenvector has the largest component
of the offset. That association is a convention with a trap: in level flight position and offset are seen only as p - v
T_d. Where the first position uncertainty is below v times that of the offset (1 m against 3 m at 100 m/s and 30 ms) the
largest component of the offset is in that well-seen direction, and the eigenvalue is small for any manoeuvre although
nothing is known of the offset. With 10 m it is in the other one. The normalised variance of the offset itself,
``offset_variance``, has no such trap; look at both, and at ``component``.

Source: Ham and Brown, Observability, eigenvalues and Kalman filtering, IEEE Trans. AES 19(2), 1983; Lee et al. 2020,
equation (14), P' = P0^-1/2 P P0^-1/2 with the symmetric root of a diagonal P0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.systems.time_sync.estimators.kalman.setup import OFFSET

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observability:
    """``eigenvalues`` (m, G, 16) ascending.   ``associated`` (m, G): the one of the offset.   ``component`` (m, G): of
    the offset in its eigenvector, 0 to 1; near 0.7 two directions share it.   ``offset_variance`` (m, G): P'_TdTd.
    NaN in groups where the offset is not a state.
    """

    eigenvalues: Array
    associated: Array
    component: Array
    offset_variance: Array


def observability(covariance: Array, first: Array) -> Observability:
    """Normalise covariances by the first one and take them apart.

    Args:    covariance: (m, G, 16, 16).   first: (G, 16, 16), diagonal.
    Returns: Observability.
    Source:  see the head of this file.
    """
    root = np.sqrt(np.diagonal(first, axis1=-2, axis2=-1))
    state = root[:, OFFSET] > 0.0
    scale = np.where(root > 0.0, root, 1.0)
    values, vectors = np.linalg.eigh(covariance / (scale[:, :, None] * scale[:, None, :]))
    sizes = np.abs(vectors[..., OFFSET, :])
    which = np.argmax(sizes, axis=-1)[..., None]
    associated = np.take_along_axis(values, which, axis=-1)[..., 0]
    component = np.take_along_axis(sizes, which, axis=-1)[..., 0]
    variance = covariance[..., OFFSET, OFFSET] / scale[:, OFFSET] ** 2
    values[:, ~state], associated[:, ~state], component[:, ~state], variance[:, ~state] = (np.nan,) * 4
    return Observability(values, associated, component, variance)
