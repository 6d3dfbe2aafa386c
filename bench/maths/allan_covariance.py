"""Covariance between the Allan variances of one record.

Variances at neighbouring averaging times rest on the same samples and are far from independent; a fit that takes them
as independent states too small uncertainties. For Gaussian noise their covariance follows from that of the second
differences of the angle, which a generalised covariance function of the angle gives in closed form.

Source: Isserlis' theorem; generalised covariances as in Greenhall and Riley (2003), their sizes from the Allan
variances of IEEE Std 952-1997 annex C.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]

SCATTERING = ("quantisation_noise", "white_noise", "bias_instability", "random_walk")
_REACH = 4  # differences this many times the sum of both averages apart are independent; but for flicker noise exactly
_SECOND_DIFFERENCE = ((0, 1.0), (1, -2.0), (2, 1.0))


@dataclass(frozen=True)
class VarianceCovariance:
    """Covariance of k Allan variances as a function of the squared coefficients of the noise.

    ``products`` (k, k, 4, 4): part of each product of two squares in the order of SCATTERING; ``ramp`` (k, k, 4): of
    the product of a square and that of the rate ramp, which does not scatter itself but takes the others' scatter up.
    """

    products: Array
    ramp: Array

    def matrix(self, squares: Mapping[str, float]) -> Array:
        """(k, k), fourth power of the rate's unit; names as in ``bench.maths.allan_terms.TERMS``, 0 if not there."""
        noise = np.array([squares.get(name, 0.0) for name in SCATTERING])
        return np.asarray(self.products @ noise @ noise + squares.get("rate_ramp", 0.0) * (self.ramp @ noise))


def variance_covariance(factors: Int64, differences: Int64, interval_s: float) -> VarianceCovariance:
    """Return covariance of overlapping Allan variances of one record of Gaussian noise.

    Args:    factors: samples per average, (k,).   differences: in each variance, (k,).   interval_s: of one sample.
    Returns: VarianceCovariance.
    Source:  Isserlis' theorem for Gaussian noise.
    """
    size, kinds = factors.size, len(SCATTERING)
    angle = _angle_covariance(interval_s, (_REACH + 2) * 2 * int(factors.max()))
    products, ramp = np.empty((size, size, kinds, kinds)), np.empty((size, size, kinds))
    for i in range(size):
        for j in range(i + 1):
            pair, counts = factors[[i, j]], differences[[i, j]]
            lags, covariance = _difference_covariance(angle, pair, interval_s)
            pairs = np.minimum(counts[0] - 1, counts[1] - 1 + lags) - np.maximum(0, lags) + 1
            share = np.maximum(pairs, 0) / (4.0 * counts[0] * counts[1])
            products[i, j] = products[j, i] = 2.0 * (share * covariance) @ covariance.T
            ramp[i, j] = ramp[j, i] = 4.0 * float(np.prod(pair * interval_s)) * (covariance @ share)
    return VarianceCovariance(products, ramp)


def _angle_covariance(interval_s: float, length: int) -> Array:
    """Generalised covariances of the angle at lags 0 ... length samples for coefficients of one, (4, length + 1)."""
    t_s = interval_s * np.arange(length + 1)
    found = np.zeros((len(SCATTERING), length + 1))
    found[0, 0] = 1.0
    found[1] = -t_s / 2.0
    found[2, 1:] = np.square(t_s[1:]) * np.log(t_s[1:]) / (2.0 * np.pi)
    found[3] = t_s**3 / 12.0
    return found


def _difference_covariance(angle: Array, pair: Int64, interval_s: float) -> tuple[Int64, Array]:
    """Lags in samples, and the covariances (4, lags) of the differences of averages over ``pair`` samples."""
    reach = _REACH * int(pair.sum())
    lags = np.arange(-reach, reach + 1)
    total = np.zeros((len(angle), lags.size))
    for first, one in _SECOND_DIFFERENCE:
        for second, other in _SECOND_DIFFERENCE:
            total += one * other * angle[:, np.abs(lags + first * pair[0] - second * pair[1])]
    return lags, total / float(np.prod(pair * interval_s))
