"""Stability of the bias of an inertial sensor over an hour, and its repeatability.

Stability is the standard deviation of 360 means of 10 s in 1 h, not that of the samples (30 to 40 times as large) and
not the lowest Allan deviation. Of a gyroscope it is mostly the angle random walk: N deg/sqrt(h) make 19.0 N deg/h.
The noise of the means is a white part and a part that wanders and returns, by the Whittle likelihood. How long the slow
part lasts is known badly from one record, so what depends on it is averaged over all durations and sizes, weighted with
their likelihood.

Repeatability is the scatter of the means of six windows of 10 min that lie at least 10 min apart. Windows without gaps
are parts of one record: their scatter is the noise of a long mean, not what returns after a pause.

Source: GNC paper (001) section 5.1 3); s = sqrt(sum (x - mean)^2 / (n - 1)) (JCGM 100:2008 4.2.2); Whittle, Ark. Mat.
2 (1953) 423 (likelihood of a periodogram); variance of quadratic forms of Gaussian noise by Isserlis' theorem.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.maths.arrays import Floats, Integers
from bench.model.errors import FitError
from bench.systems.gnc.estimators.sensor_noise import SensorNoise

AVERAGES, AVERAGE_s = 360, 10.0
LEAST_FILLED = 0.9  # of the samples of an average
_PROBABILITY = 0.95
_SHARES = np.concatenate(([0.0], np.geomspace(0.003, 1.0, 25)))  # slow part of the variance of a mean
_TIMES = 24  # correlation times tried, from half a mean to the whole record
WINDOWS, WINDOW_s, APART_s = 6, 600.0, 1200.0  # how many, how long at least, from start to start at least
_SLACK_s = 1.0  # of starts and lengths: commands and answers take their time


@dataclass(frozen=True)
class BiasStability:
    """Standard deviation of means of 10 s over 1 h, in the unit of the samples.

    Attributes:
        value: s.   dof: effective degrees of freedom.   mean: of the hour.   averages: (360,).
        missing: samples that were not there.
    """

    value: float
    dof: float
    mean: float
    averages: Floats
    missing: int

    @property
    def std(self) -> float:
        """Standard uncertainty of ``value``."""
        return self.value / math.sqrt(2.0 * self.dof)


def on_the_counter(counter: Integers, values: Floats) -> Floats:
    """Samples in their places, NaN where the counter says one is missing.

    Args:    counter: (n,), unwrapped, rising.   values: (n,) or (n, k).
    Returns: (m,) or (m, k), m = last - first + 1.
    """
    placed = np.full((int(counter[-1] - counter[0]) + 1, *values.shape[1:]), np.nan)
    placed[counter - counter[0]] = values
    return placed


def averages_of(samples: Floats, interval_s: float, averages: int = AVERAGES) -> Floats:
    """Means of contiguous parts of a record, from its beginning.

    Args:    samples: (m,), NaN where one is missing.   interval_s: between samples.   averages: how many,
             of 10 s.
    Returns: (averages,).
    Raises:  FitError B-FIT-092 if the record is too short or an average has fewer than 90 % of its samples.
    Source:  GNC paper section 5.1 3): n = 360 means of 10 s in 1 h, neither more nor fewer.
    """
    bounds = np.rint(np.arange(averages + 1) * AVERAGE_s / interval_s).astype(np.int64)
    short = int(bounds[-1]) - samples.size
    if 0 < short <= (1.0 - LEAST_FILLED) * (bounds[-1] - bounds[-2]):  # frames lost at the end are missing samples
        samples = np.concatenate((samples, np.full(short, np.nan)))
    if bounds[-1] > samples.size:
        raise FitError(
            "B-FIT-092",
            f"{samples.size * interval_s:.1f} s give {int(samples.size * interval_s / AVERAGE_s)} means of "
            f"{AVERAGE_s:g} s, {averages} are due",
            next_step=f"record {averages * AVERAGE_s:g} s without a break",
        )
    part = samples[: bounds[-1]]
    good = np.isfinite(part)
    counts = np.add.reduceat(good, bounds[:-1], dtype=np.int64)
    poor = np.flatnonzero(counts < LEAST_FILLED * np.diff(bounds))
    if poor.size:
        raise FitError(
            "B-FIT-092",
            f"{poor.size} of {averages} means lack more than {100 * (1 - LEAST_FILLED):.0f} % of their samples, the "
            f"first at {poor[0] * AVERAGE_s:g} s",
            next_step="look at the link's damaged frames; take the record again",
        )
    centre = float(part[good].mean())  # sums of deviations keep their digits
    return centre + np.add.reduceat(np.where(good, part - centre, 0.0), bounds[:-1]) / counts


def bias_stability(
    samples: Floats,
    interval_s: float,
    averages: int = AVERAGES,
    declared: SensorNoise | None = None,
) -> BiasStability:
    """Stability of the bias and its interval, means that hang together counted as fewer.

    ``value`` within 1.96 ``std`` held the expected value in 91 to 95 % of 150 simulated hours with random walk 0.3
    deg/sqrt(h) and 2 deg/h of slow noise that lasts 100 to 1,000 s, in 83 % where slow noise of 300 s makes nearly all
    of it, and in 63 % where that lasts 1,000 s: no hour shows how far a process of a third of an hour wanders.

    Args:    samples: (m,), NaN where one is missing, any unit.   interval_s: between samples, by the sample clock.
             averages: 360 of 10 s.   declared: noise of samples that hold none; ``value`` is then the
             expected one.
    Returns: BiasStability.
    Raises:  FitError B-FIT-092 as ``averages_of``.
    Source:  GNC paper section 5.1 3); degrees of freedom 2 E^2 / Var of a quadratic form of Gaussian noise
             (Satterthwaite, Biometrics Bulletin 2 (1946) 110), their covariance from ``dof_of_means``.
    """
    means = averages_of(samples, interval_s, averages)
    if declared is None:
        variance, dof = float(np.var(means, ddof=1)), dof_of_means(means)
    else:
        variance, dof = declared_variance(declared, averages, AVERAGE_s)
    used = samples[: round(averages * AVERAGE_s / interval_s)]
    return BiasStability(
        value=math.sqrt(variance),
        dof=dof,
        mean=float(means.mean()),
        averages=means,
        missing=int(np.isnan(used).sum()) + max(0, round(averages * AVERAGE_s / interval_s) - used.size),
    )


def declared_variance(noise: SensorNoise, count: int, average_s: float) -> tuple[float, float]:
    """Return expected variance of ``count`` means of ``average_s`` that follow each other, and its degrees of freedom.

    Args:    noise: of the sensor, declared.   count, average_s: of the means.
    Source:  as ``dof_of_means``, with one covariance that is known.
    """
    begin_s, length_s = average_s * np.arange(count, dtype=np.float64), np.full(count, average_s)
    lags = noise.of_means(begin_s, length_s)[0]
    total = _sums(lags)[1]
    dof = float(np.clip(1.0 / _inverse_dof_of(lags), 1.0, count - 1.0))
    return float((count * lags[0] - total / count) / (count - 1)), dof


def dof_of_means(means: Floats) -> float:
    """Return effective degrees of freedom of the variance of equally spaced means about their mean.

    Args:    means: (n,), n >= 8, whose noise has a white and a slow part.
    Source:  see the head of this file; degrees of freedom 2 E^2 / Var, their inverse averaged.
    """
    count = means.size
    power = np.square(np.abs(np.fft.rfft(means - means.mean())))[1 : (count + 1) // 2] / count
    turn = 2.0 * np.pi * np.arange(1, power.size + 1) / count
    kept = np.exp(-1.0 / np.geomspace(0.5, float(count), _TIMES))
    slow = (1.0 - kept[:, None] ** 2) / (1.0 - 2.0 * kept[:, None] * np.cos(turn) + kept[:, None] ** 2)
    shape = (1.0 - _SHARES)[None, :, None] + _SHARES[None, :, None] * slow[:, None, :]
    size = (power / shape).mean(axis=2)
    if not np.all(size > 0.0):
        return count - 1.0
    cost = power.size * np.log(size) + np.log(shape).sum(axis=2)
    weight = np.exp(cost.min() - cost)
    spread = float((weight * _inverse_dof(kept, count)).sum() / weight.sum())
    return float(np.clip(1.0 / spread, 1.0, count - 1.0))


def _inverse_dof(kept: Floats, count: int) -> Floats:
    """1 / degrees of freedom of the variance about the mean, by correlation time and share, (times, shares).

    With C = I - 1 1'/n and covariance V: Var / (2 E^2) = tr(CVCV) / tr(CV)^2, taken from the lags because V depends on
    them only.
    """
    covariance = _SHARES[None, :, None] * (kept[:, None, None] ** np.arange(count))
    covariance[:, :, 0] = 1.0
    return _inverse_dof_of(covariance)


def _inverse_dof_of(covariance: Floats) -> Floats:
    """Return the same of means with these covariances by their lag, (..., n)."""
    count, first = covariance.shape[-1], covariance[..., :1]
    pairs = np.where(np.arange(count) == 0, count, 2.0 * (count - np.arange(count)))
    rows, total = _sums(covariance)
    square = (pairs * covariance**2).sum(axis=-1) - 2.0 / count * (rows**2).sum(axis=-1) + (total / count) ** 2
    return np.asarray(square / (count * first[..., 0] - total / count) ** 2)


def _sums(covariance: Floats) -> tuple[Floats, Floats]:
    """Return sums of each row of a covariance that is given by its lags, and of the whole."""
    summed = np.cumsum(covariance, axis=-1)
    rows = summed + summed[..., ::-1] - covariance[..., :1]
    return rows, rows.sum(axis=-1)


@dataclass(frozen=True)
class BiasRepeatability:
    """``value``: standard deviation of the means, unit of the means; ``dof``: n - 1."""

    value: float
    dof: int

    @property
    def std(self) -> float:
        """Standard uncertainty of ``value``."""
        return self.value / math.sqrt(2.0 * self.dof)


def bias_repeatability(
    means: Sequence[float],
    starts_s: Sequence[float],
    lengths_s: Sequence[float],
    declared: SensorNoise | None = None,
) -> BiasRepeatability:
    """Return the repeatability of the means of windows.

    Args:    means: of the windows.   starts_s, lengths_s: of the windows.
             declared: noise of windows that hold none; ``value`` is then the expected one.
    Returns: BiasRepeatability.
    Raises:  FitError B-FIT-093 for fewer than six windows, one shorter than 10 min or starts less than 20 min apart.
    Source:  see the head of this file.
    """
    order = np.argsort(starts_s)
    starts, lengths = np.asarray(starts_s, np.float64)[order], np.asarray(lengths_s, np.float64)[order]
    _require(starts, lengths)
    values = np.asarray(means, np.float64)[order]
    dof = values.size - 1
    if declared is None:
        value = float(np.std(values, ddof=1))
    else:
        covariance = declared.of_means(starts, lengths)
        value = math.sqrt(float(np.trace(covariance) - covariance.sum() / values.size) / dof)
    return BiasRepeatability(value, dof)


def _require(starts: Floats, lengths: Floats) -> None:
    reason = ""
    if starts.size < WINDOWS:
        reason = f"{starts.size} windows, {WINDOWS} are due"
    elif lengths.min() < WINDOW_s - _SLACK_s:
        reason = f"window {int(np.argmin(lengths)) + 1} is {lengths.min():.0f} s long, {WINDOW_s:.0f} s are due"
    elif np.diff(starts).min() < APART_s - _SLACK_s:
        place = int(np.argmin(np.diff(starts)))
        reason = (
            f"windows {place + 1} and {place + 2} start {np.diff(starts)[place]:.0f} s apart, {APART_s:.0f} s are due"
        )
    if reason:
        raise FitError(
            "B-FIT-093",
            f"no repeatability of a bias: {reason}",
            next_step="take six windows of 10 min with pauses of at least 10 min between them",
        )
