"""Bias of an inertial sensor: its mean, its stability over an hour, its repeatability, and the bias of a flip.

Stability is the standard deviation of 360 means of 10 s in 1 h, not that of the samples (30 to 40 times as large) and
not the lowest Allan deviation. Of a gyroscope it is mostly the angle random walk: N deg/sqrt(h) make 19.0 N deg/h.

Source: GNC paper (001) section 5.1 3); s = sqrt(sum (x - mean)^2 / (n - 1)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bench.model.errors import FitError
from bench.systems.gnc.estimators.mean_noise import MeanNoise, mean_noise

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]
AVERAGES, AVERAGE_s = 360, 10.0
LEAST_FILLED = 0.9  # of the samples of an average
_PROBABILITY = 0.95


@dataclass(frozen=True)
class BiasStability:
    """Standard deviation of means of 10 s over 1 h, in the unit of the samples.

    Attributes:
        value: s.   low, high: 95 % interval of the expected s of such an hour.   dof: effective degrees of freedom.
        mean: of the hour.   averages: (360,).   samples_std: standard deviation of the samples, for comparison only.
        noise: white and slow part of the averages' noise.   missing: samples that were not there.
    """

    value: float
    low: float
    high: float
    dof: float
    mean: float
    averages: Array
    samples_std: float
    noise: MeanNoise
    missing: int

    @property
    def std(self) -> float:
        """Standard uncertainty of ``value``."""
        return self.value / math.sqrt(2.0 * self.dof)


def on_the_counter(counter: Int64, values: Array) -> Array:
    """Samples in their places, NaN where the counter says one is missing.

    Args:    counter: (n,), unwrapped, rising.   values: (n,) or (n, k).
    Returns: (m,) or (m, k), m = last - first + 1.
    """
    placed = np.full((int(counter[-1] - counter[0]) + 1, *values.shape[1:]), np.nan)
    placed[counter - counter[0]] = values
    return placed


def averages_of(samples: Array, interval_s: float, averages: int = AVERAGES, average_s: float = AVERAGE_s) -> Array:
    """Means of contiguous parts of a record, from its beginning.

    Args:    samples: (m,), NaN where one is missing.   interval_s: between samples.   averages: how many.
             average_s: length of each.
    Returns: (averages,).
    Raises:  FitError B-FIT-092 if the record is too short or an average has fewer than 90 % of its samples.
    Source:  GNC paper section 5.1 3): n = 360 means of 10 s in 1 h, neither more nor fewer.
    """
    bounds = np.rint(np.arange(averages + 1) * average_s / interval_s).astype(np.int64)
    short = int(bounds[-1]) - samples.size
    if 0 < short <= (1.0 - LEAST_FILLED) * (bounds[-1] - bounds[-2]):  # frames lost at the end are missing samples
        samples = np.concatenate((samples, np.full(short, np.nan)))
    if bounds[-1] > samples.size:
        raise FitError(
            "B-FIT-092",
            f"{samples.size * interval_s:.1f} s give {int(samples.size * interval_s / average_s)} means of "
            f"{average_s:g} s, {averages} are due",
            next_step=f"record {averages * average_s:g} s without a break",
        )
    part = samples[: bounds[-1]]
    good = np.isfinite(part)
    counts = np.add.reduceat(good, bounds[:-1], dtype=np.int64)
    poor = np.flatnonzero(counts < LEAST_FILLED * np.diff(bounds))
    if poor.size:
        raise FitError(
            "B-FIT-092",
            f"{poor.size} of {averages} means lack more than {100 * (1 - LEAST_FILLED):.0f} % of their samples, the "
            f"first at {poor[0] * average_s:g} s",
            next_step="look at the link's damaged frames; take the record again",
        )
    centre = float(part[good].mean())  # sums of deviations keep their digits
    return np.asarray(centre + np.add.reduceat(np.where(good, part - centre, 0.0), bounds[:-1]) / counts)


def bias_stability(
    samples: Array, interval_s: float, averages: int = AVERAGES, average_s: float = AVERAGE_s
) -> BiasStability:
    """Stability of the bias and its interval, means that hang together counted as fewer.

    The 95 % interval held the expected value in 95 to 97 % of 400 simulated hours with random walk 0.3 deg/sqrt(h) and
    2 deg/h of slow noise that lasts 100 to 1,000 s, in 92 % where slow noise of 300 s makes nearly all of it, and in
    67 % where that lasts 1,000 s: no hour shows how far a process of a third of an hour wanders.

    Args:    samples: (m,), NaN where one is missing, any unit.   interval_s: between samples, by the sample clock.
             averages, average_s: 360 of 10 s.
    Returns: BiasStability.
    Raises:  FitError B-FIT-092 as ``averages_of``.
    Source:  GNC paper section 5.1 3); degrees of freedom 2 E^2 / Var of a quadratic form of Gaussian noise
             (Satterthwaite, Biometrics Bulletin 2 (1946) 110), its covariance from ``estimators.mean_noise``.
    """
    means = averages_of(samples, interval_s, averages, average_s)
    noise = mean_noise(means)
    value = float(np.std(means, ddof=1))
    dof = noise.dof_of_variance
    tails = stats.chi2.ppf([0.5 + _PROBABILITY / 2.0, 0.5 - _PROBABILITY / 2.0], dof)
    low, high = value * np.sqrt(dof / tails)
    used = samples[: round(averages * average_s / interval_s)]
    return BiasStability(
        value=value,
        low=float(low),
        high=float(high),
        dof=dof,
        mean=float(means.mean()),
        averages=means,
        samples_std=float(np.nanstd(used, ddof=1)),
        noise=noise,
        missing=int(np.isnan(used).sum()) + max(0, round(averages * average_s / interval_s) - used.size),
    )
