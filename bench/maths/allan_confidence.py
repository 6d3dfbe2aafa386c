"""Which power law a record follows, and how many degrees of freedom its Allan variance then has.

Source: Riley and Greenhall, Power law noise identification using the lag 1 autocorrelation, 18th European Frequency
and Time Forum (2004); Greenhall and Riley, Uncertainty of stability variances based on finite differences, 35th PTTI
(2003); both in NIST SP 1065, sections 5.5 and 5.4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]

WHITE_ANGLE, FLICKER_ANGLE, WHITE_RATE, FLICKER_RATE, RANDOM_WALK = 2, 1, 0, -1, -2
_FEWEST_AVERAGES = 30  # fewer do not tell one power law from the next
_CORRELATED = 3  # averages over which differences are correlated, flicker noise nearly


def noise_exponents(rate: Array, factors: Int64) -> Int64:
    """Return power law of the rate's spectrum at each averaging factor.

    Args:    rate: (n,), NaN in gaps.   factors: samples per average, ascending, (k,).
    Returns: exponents from -2 to 2, (k,). Where fewer than 30 averages fit, that of the last factor with enough;
             white noise of the rate if there is none.
    Source:  Riley and Greenhall (2004); NIST SP 1065 section 5.5.6.
    """
    found, last = [], WHITE_RATE
    for factor in factors.tolist():
        if rate.size // factor >= _FEWEST_AVERAGES:
            blocks = rate[: rate.size // factor * factor].reshape(-1, factor)
            last = _exponent(blocks.mean(axis=1), last)
        found.append(last)
    return np.array(found, np.int64)


def _exponent(averages: Array, otherwise: int) -> int:
    """Difference until the lag-1 autocorrelation is that of a stationary fractional process; pairs without a gap."""
    series = averages
    for differenced in (0, 1, 2):
        if np.isfinite(series[1:] * series[:-1]).sum() < _FEWEST_AVERAGES // 2:
            return otherwise
        series = series - np.nanmean(series)
        power = np.nanmean(np.square(series))
        if power == 0.0:
            return otherwise
        correlation = np.nanmean(series[1:] * series[:-1]) / power
        fractional = correlation / (1.0 + correlation)
        if fractional < 0.25:
            return int(np.clip(-np.rint(2.0 * fractional) - 2 * differenced, RANDOM_WALK, WHITE_ANGLE))
        series = np.diff(series)
    return otherwise


def degrees_of_freedom(factor: int, differences: int, exponent: int, *, modified: bool = False) -> float:
    """Equivalent chi-squared degrees of freedom of an overlapping (or modified) Allan variance.

    The angle is known at the ends of the samples and the rates are its true means, so noise of the rate has the
    covariances of the continuous angle from the first factor on; noise of the angle is that of its samples.

    Args:    factor: samples per average.   differences: overlapping differences in the variance.
             exponent: power of frequency in the rate's spectrum, 2 to -2.   modified: the modified variance.
    Returns: degrees of freedom, >= 1.
    Source:  Greenhall and Riley (2003), the sum taken term by term up to the length of the correlation.
    """
    length = min(differences, _CORRELATED * factor)
    lags = np.arange(-factor, length + factor + 1)
    covariance = _difference_covariance(lags, factor, exponent)
    if modified:
        covariance = _moving_sum(_moving_sum(covariance, factor), factor)[1 : length + 2]
    else:
        covariance = covariance[factor : factor + length + 1]
    shared = np.square(covariance / covariance[0])
    weight = 2.0 * (1.0 - np.arange(length + 1) / differences)
    weight[0] = 1.0
    weight[-1] *= 0.5
    return float(max(1.0, differences / (weight @ shared)))


def _difference_covariance(lags: Int64, factor: int, exponent: int) -> Array:
    """Return covariance of second differences of the angle over ``factor`` samples, up to its size."""
    far = _angle_covariance(lags - 2 * factor, exponent) + _angle_covariance(lags + 2 * factor, exponent)
    near = _angle_covariance(lags - factor, exponent) + _angle_covariance(lags + factor, exponent)
    return np.asarray(6.0 * _angle_covariance(lags, exponent) - 4.0 * near + far)


def _angle_covariance(lags: Int64, exponent: int) -> Array:
    """Generalised covariance of the angle at lags in samples, up to its size."""
    t = np.abs(lags).astype(np.float64)
    if exponent == WHITE_ANGLE:
        return np.asarray((t == 0.0).astype(np.float64))
    if exponent == FLICKER_ANGLE:  # limited to the band of the samples by a mean over one of them
        return 2.0 * _flicker(t) - _flicker(t - 1.0) - _flicker(t + 1.0)
    if exponent == WHITE_RATE:
        return -t
    return _flicker(t) if exponent == FLICKER_RATE else t**3


def _flicker(t: Array) -> Array:
    size = np.abs(t)
    return np.asarray(np.square(size) * np.log(np.where(size > 0.0, size, 1.0)))


def _moving_sum(values: Array, length: int) -> Array:
    total = np.concatenate(([0.0], np.cumsum(values)))
    return np.asarray(total[length:] - total[:-length])
