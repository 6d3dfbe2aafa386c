"""Bias stability that white noise and a Gauss-Markov process lead to expect: a second opinion for its estimator."""

from __future__ import annotations

import math

from bench.systems.gnc.estimators.bias_stability import AVERAGES, AVERAGE_s


def expected_stability(
    random_walk: float, slow_std: float = 0.0, slow_time_s: float = math.inf, averages: int = AVERAGES
) -> float:
    """Stability that white noise and a Gauss-Markov process lead to expect.

    Args:    random_walk: N, unit of the rate times sqrt(s) (deg/sqrt(h) times 60 for deg/h).   slow_std: standard
             deviation of the Gauss-Markov process, unit of the rate.   slow_time_s: its correlation time; infinite
             counts its whole variance, as a process that is slow against 10 s and quick against 1 h.
    Returns: square root of the expected variance of the means, unit of the rate.
    Source:  variance of a mean of T: N^2 / T (IEEE Std 952-1997 C.1.1); for the Gauss-Markov process
             2 q^2 (a - 1 + exp(-a)) / a^2 with a = T / time, less that of the mean of the hour.
    """
    white = random_walk**2 / AVERAGE_s
    if math.isinf(slow_time_s):
        return math.sqrt(white + slow_std**2)
    parts = [_mean_variance(length / slow_time_s) for length in (AVERAGE_s, averages * AVERAGE_s)]
    return math.sqrt(white + slow_std**2 * averages / (averages - 1.0) * (parts[0] - parts[1]))


def _mean_variance(span: float) -> float:
    """Variance of the mean of a Gauss-Markov process of unit variance over ``span`` correlation times."""
    return 2.0 * (span - 1.0 + math.exp(-span)) / span**2 if span > 1e-4 else 1.0 - span / 3.0
