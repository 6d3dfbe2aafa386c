"""Overlapping Allan deviation of rate samples, with gaps and confidence intervals.

A gap is a sample that is NaN. Every difference of averages that touches one is left out; nothing is filled in, so a
gap costs differences and widens the interval but shifts nothing. The equivalent degrees of freedom are those of an
unbroken record with as many differences, of the power law that the record follows.

Source: Riley, Handbook of Frequency Stability Analysis, NIST SP 1065 (2008), sections 5.2.4, 5.2.5 and 5.3 to 5.5; IEEE
Std 952-1997 annex C for gyroscopes, where rate takes the place of frequency and angle that of phase; Riley and
Greenhall, Power law noise identification using the lag 1 autocorrelation, 18th European Frequency and Time Forum
(2004); Greenhall and Riley, Uncertainty of stability variances based on finite differences, 35th PTTI (2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, special

from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError

WHITE_ANGLE, FLICKER_ANGLE, WHITE_RATE, FLICKER_RATE, RANDOM_WALK = 2, 1, 0, -1, -2
_FEWEST_AVERAGES = 30  # fewer do not tell one power law from the next
_MIXED, _POWERS, _WHITE = (WHITE_ANGLE, WHITE_RATE, FLICKER_RATE, RANDOM_WALK), (-2.0, -1.0, 0.0, 1.0), 1
_FEWEST_CURVE = 6  # averaging times that tell four power laws
_REWEIGHTINGS, _MORE = 4, 0.5
_PROBABILITY = 0.95  # of the two-sided interval
_CORRELATED = 3  # averages over which differences are correlated, flicker noise nearly


@dataclass(frozen=True)
class AllanDeviation:
    """Deviation over averaging time.

    Attributes:
        interval_s: time between samples.
        factors: samples in an average, (k,).   tau_s: averaging times, (k,).
        deviation: (k,), unit of the rate.   low, high: 95 % confidence limits, (k,).
        differences: that the deviation is made of, (k,).   dof: equivalent degrees of freedom, (k,).
        exponents: power of frequency in the rate's spectrum that was found at each averaging time, (k,): 2 white
            noise of the angle, 1 its flicker noise, 0 white noise of the rate, -1 flicker noise, -2 random walk. Where
            fewer than 30 averages fit, that of the largest part of what the whole curve shows.
    """

    interval_s: float
    factors: Integers
    tau_s: Floats
    deviation: Floats
    low: Floats
    high: Floats
    differences: Integers
    dof: Floats
    exponents: Integers

    def behind(self, first: int) -> AllanDeviation:
        """Return the same without the first averaging times."""
        parts = (getattr(self, name)[first:] for name in _COLUMNS)
        return replace(self, **dict(zip(_COLUMNS, parts, strict=True)))


_COLUMNS = ("factors", "tau_s", "deviation", "low", "high", "differences", "dof", "exponents")


def allan_deviation(rate: Floats, interval_s: float, *, factors: Sequence[int] | None = None) -> AllanDeviation:
    """Return overlapping Allan deviation with chi-squared confidence limits.

    Args:    rate: mean rates over successive intervals, (n,), any unit; NaN marks a gap.   interval_s: of one sample.
             factors: samples per average; by default powers of two as far as two averages fit.
    Returns: AllanDeviation; averaging times that gaps leave without a difference are dropped.
    Raises:  FitError B-FIT-031 if no averaging time is left.
    Source:  NIST SP 1065 equations (10), (14) and (45); Greenhall and Riley (2003) for the degrees of freedom.
    """
    rate = np.asarray(rate, np.float64)
    points = _variances(rate, factors)
    if not points:
        raise FitError(
            "B-FIT-031",
            f"{int(np.isfinite(rate).sum())} good samples of {rate.size} leave no averaging time of an Allan deviation",
            next_step="take at least three samples without a gap between them, or shorter averaging times",
        )
    used, variance, differences = (np.array(column) for column in zip(*points, strict=True))
    exponents = noise_exponents(rate, used)
    dof = np.array([
        degrees_of_freedom(int(m), int(count), int(alpha))
        for m, count, alpha in zip(used, differences, exponents, strict=True)
    ])  # fmt: skip
    exponents, dof = _at_few_averages(rate.size, used, variance, differences, exponents, dof)
    return _with_limits(interval_s, used, np.sqrt(variance), differences, dof, exponents)


def _with_limits(
    interval_s: float, factors: Integers, deviation: Floats, differences: Integers, dof: Floats, exponents: Integers
) -> AllanDeviation:
    low, high = confidence_limits(deviation, dof)
    tau_s = np.asarray(factors * interval_s, np.float64)
    return AllanDeviation(interval_s, factors, tau_s, deviation, low, high, differences, dof, exponents)


def confidence_limits(deviation: Floats, dof: Floats) -> tuple[Floats, Floats]:
    """Return two-sided 95 % limits of a deviation whose square has a chi-squared distribution.

    Args:    deviation: (k,).   dof: equivalent degrees of freedom, (k,).
    Returns: lower and upper limits, (k,) each.
    Source:  NIST SP 1065 equation (45).
    """
    tail = (1.0 - _PROBABILITY) / 2.0
    return deviation * np.sqrt(dof / special.chdtri(dof, tail)), deviation * np.sqrt(
        dof / special.chdtri(dof, 1.0 - tail)
    )


def _variances(rate: Floats, factors: Sequence[int] | None) -> list[tuple[int, float, int]]:
    """Return factor, variance and differences of every factor that leaves a difference."""
    wanted = [2**k for k in range(rate.size.bit_length())] if factors is None else sorted(set(factors))
    fitting = [factor for factor in wanted if factor >= 1 and 2 * factor <= rate.size]
    points = [(factor, *_variance(rate, factor)) for factor in fitting]
    return [point for point in points if point[2] > 0]


def _variance(rate: Floats, factor: int) -> tuple[float, int]:
    """Return Allan variance and the number of differences in it; intervals cancel, so they are counted as one."""
    good = np.isfinite(rate)
    mean = rate[good].mean() if good.any() else 0.0
    angle = np.concatenate(([0.0], np.cumsum(np.where(good, rate - mean, 0.0))))
    gaps = np.concatenate(([0], np.cumsum(~good)))
    difference = angle[2 * factor :] - 2.0 * angle[factor:-factor] + angle[: -2 * factor]
    whole = gaps[2 * factor :] == gaps[: gaps.size - 2 * factor]
    squared = float(np.square(difference[whole]).mean()) if whole.any() else 0.0
    return squared / (2.0 * float(factor) ** 2), int(whole.sum())


def noise_exponents(rate: Floats, factors: Integers) -> Integers:
    """Return power law of the rate's spectrum at each averaging factor.

    Args:    rate: (n,), NaN in gaps.   factors: samples per average, ascending, (k,).
    Returns: exponents from -2 to 2, (k,). Where fewer than 30 averages fit, that of the last factor with enough;
             white noise of the rate if there is none.
    Source:  Riley and Greenhall (2004); NIST SP 1065 section 5.5.6.
    """
    exponents, last = [], WHITE_RATE
    for factor in factors.tolist():
        if rate.size // factor >= _FEWEST_AVERAGES:
            blocks = rate[: rate.size // factor * factor].reshape(-1, factor)
            last = _exponent(blocks.mean(axis=1), last)
        exponents.append(last)
    return np.array(exponents, np.int64)


def _exponent(averages: Floats, otherwise: int) -> int:
    """Return differences until the lag-1 autocorrelation is that of a stationary fractional process; no gaps."""
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


def _at_few_averages(
    samples: int, factors: Integers, variance: Floats, differences: Integers, exponents: Integers, dof: Floats
) -> tuple[Integers, Floats]:
    """Return exponents and degrees of freedom, those of few averages from the noise that all averaging times show.

    Fewer than 30 averages do not tell their own power law, and that of shorter times need not go on: quantisation ends
    in random walk. So powers of the averaging time are fitted to the whole curve, and the degrees of freedom are those
    of the mixture. A rate random walk that only begins there is counted with half of its standard uncertainty on top.
    """
    few = samples // factors < _FEWEST_AVERAGES
    if not few.any() or factors.size < _FEWEST_CURVE:
        return exponents, dof
    shares = _shares(factors.astype(np.float64), variance, dof)
    exponents, dof = exponents.copy(), dof.copy()
    for at in np.flatnonzero(few):
        exponents[at] = _MIXED[int(np.argmax(shares[at]))]
        dof[at] = _mixed_dof(int(factors[at]), int(differences[at]), shares[at])
    return exponents, dof


def _shares(factor: Floats, variance: Floats, dof: Floats) -> Floats:
    """Return part of each power law in the Allan variances, (k, 4)."""
    laws = np.column_stack([factor**power for power in _POWERS])
    model, squares = variance, np.zeros(len(_POWERS))
    for _ in range(_REWEIGHTINGS):
        weight = np.sqrt(dof / 2.0) / model
        scaled = laws * weight[:, None]
        length = np.linalg.norm(scaled, axis=0)
        squares = optimize.nnls(scaled / length, variance * weight)[0] / length
        model = laws @ squares
        if not (model > 0.0).all():
            return np.tile(np.eye(len(_POWERS))[_WHITE], (factor.size, 1))
    unit = scaled / length
    squares[-1] += _MORE * float(np.sqrt(np.linalg.inv(unit.T @ unit)[-1, -1])) / length[-1]
    parts = laws * squares
    return np.asarray(parts / parts.sum(axis=1, keepdims=True))


def _mixed_dof(factor: int, differences: int, share: Floats) -> float:
    """Return degrees of freedom of an Allan variance of several power laws; ``share`` of each in it, (4,)."""
    covariance = np.zeros(1)
    for exponent, part in zip(_MIXED, share.tolist(), strict=True):
        of_one = _covariance(factor, differences, exponent)
        covariance = covariance + part * of_one / of_one[0]
    return _equivalent(covariance, differences)


def expected_curve(
    interval_s: float, samples: int, factors: Integers, deviation: Floats, exponents: Integers | None = None
) -> AllanDeviation:
    """Return what a record without gaps shows on average of a deviation at some averaging times, (k,) both.

    Degrees of freedom and limits are those of the power laws ``exponents``, (k,); by default of white noise of the
    rate.
    """
    exponents = np.full(factors.size, WHITE_RATE) if exponents is None else exponents
    differences = samples - 2 * factors + 1
    places = zip(factors.tolist(), differences.tolist(), exponents.tolist(), strict=True)
    dof = np.array([degrees_of_freedom(*place) for place in places])
    return _with_limits(interval_s, factors, deviation, differences, dof, exponents)


def degrees_of_freedom(factor: int, differences: int, exponent: int) -> float:
    """Return equivalent chi-squared degrees of freedom of an overlapping Allan variance.

    The angle is known at the ends of the samples and the rates are its true means, so noise of the rate has the
    covariances of the continuous angle from the first factor on; noise of the angle is that of its samples.

    Args:    factor: samples per average.   differences: overlapping differences in the variance.
             exponent: power of frequency in the rate's spectrum, 2 to -2.
    Returns: degrees of freedom, >= 1.
    Source:  Greenhall and Riley (2003), the sum taken term by term up to the length of the correlation.
    """
    return _equivalent(_covariance(factor, differences, exponent), differences)


def _covariance(factor: int, differences: int, exponent: int) -> Floats:
    """Return covariances of the differences of one power law at lags 0 to the length of its correlation."""
    length = min(differences, _CORRELATED * factor)
    lags = np.arange(-factor, length + factor + 1)
    return _difference_covariance(lags, factor, exponent)[factor : factor + length + 1]


def _equivalent(covariance: Floats, differences: int) -> float:
    """Return degrees of freedom of a mean square of differences whose covariances at lags 0 to l are these."""
    length = covariance.size - 1
    shared = np.square(covariance / covariance[0])
    weight = 2.0 * (1.0 - np.arange(length + 1) / differences)
    weight[0] = 1.0
    weight[-1] *= 0.5
    return float(max(1.0, differences / (weight @ shared)))


def _difference_covariance(lags: Integers, factor: int, exponent: int) -> Floats:
    """Return covariance of second differences of the angle over ``factor`` samples, up to its size."""
    far = angle_covariance(lags - 2 * factor, exponent) + angle_covariance(lags + 2 * factor, exponent)
    near = angle_covariance(lags - factor, exponent) + angle_covariance(lags + factor, exponent)
    return np.asarray(6.0 * angle_covariance(lags, exponent) - 4.0 * near + far)


def angle_covariance(lags: Integers | Floats, exponent: int) -> Floats:
    """Return generalised covariance of the angle at lags in samples or any unit of time, up to its size."""
    t = np.abs(lags).astype(np.float64)
    if exponent == WHITE_ANGLE:
        return np.asarray((t == 0.0).astype(np.float64))
    if exponent == FLICKER_ANGLE:  # limited to the band of the samples by a mean over one of them
        return 2.0 * _flicker(t) - _flicker(t - 1.0) - _flicker(t + 1.0)
    if exponent == WHITE_RATE:
        return -t
    return _flicker(t) if exponent == FLICKER_RATE else t**3


def _flicker(t: Floats) -> Floats:
    size = np.abs(t)
    return np.asarray(np.square(size) * np.log(np.where(size > 0.0, size, 1.0)))
