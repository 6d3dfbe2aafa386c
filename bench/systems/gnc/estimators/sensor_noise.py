"""Noise of a sensor as its data sheet declares it: what of it is in the mean of a record, before there is a record.

The output has white noise, the rounding to its steps, and parts of the bias that wander and return (first-order
Gauss-Markov). A bias is that of its records, so what they share of the wandering is no error of it.

Source: IEEE Std 952-1997 annex C (angle random walk; correlated noise, whose covariance is integrated here); Tippett,
Biometrika 17 (1925) 364 (range of a sample).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from bench.maths.arrays import Flags, Floats


@dataclass(frozen=True)
class SensorNoise:
    """``walk``: white noise, unit times sqrt(s).   ``wandering``: standard deviation and correlation time in seconds of
    each part.   ``step``: of the output.   ``interval_s``: between samples.
    """

    walk: float
    wandering: Sequence[tuple[float, float]]
    step: float
    interval_s: float

    @property
    def density(self) -> float:
        """Variance of the mean of a second by white noise and rounding, unit squared times s."""
        return self.walk**2 + self.step**2 / 12.0 * self.interval_s

    @property
    def sample_std(self) -> float:
        """Standard deviation of a sample before rounding."""
        return float(np.sqrt(self.walk**2 / self.interval_s + sum(size**2 for size, _ in self.wandering)))

    def wander(self, begin_s: Floats, length_s: Floats) -> Floats:
        """Return covariance of the mean wandering of records.

        Args:    begin_s, length_s: (n,), of records that do not overlap, in any order.
        Returns: (n, n), unit squared.
        Source:  exp(-|t - t'| / T) integrated over both records.
        """
        total = np.zeros((begin_s.size,) * 2)
        apart_s = np.maximum(begin_s[:, None] - (begin_s + length_s), begin_s - (begin_s + length_s)[:, None])
        for size, time_s in self.wandering:
            times = length_s / time_s
            share = -np.expm1(-times) / times
            together = np.outer(share, share) * np.exp(-np.maximum(apart_s, 0.0) / time_s)
            np.fill_diagonal(together, 2.0 / times * (1.0 - share))
            total += size**2 * together
        return total

    def of_means(self, begin_s: Floats, length_s: Floats) -> Floats:
        """Return covariance of the means of records, white noise and rounding in it.

        Args, Returns, Source: as ``wander``.
        """
        return np.diag(self.density / length_s) + self.wander(begin_s, length_s)

    def allan_variance(self, tau_s: float) -> float:
        """Return the expected Allan variance: half of that of the difference of two means that follow each other.

        Args:    tau_s: averaging time.
        Returns: unit squared.
        Source:  its definition, IEEE Std 952-1997 annex C.
        """
        both = self.of_means(np.array([0.0, tau_s]), np.full(2, tau_s))
        return float(both[0, 0] - both[0, 1])

    def wander_about_mean(self, begin_s: Floats, length_s: Floats, of: Flags | None = None) -> Floats:
        """Return the same for the wandering less its mean over the records ``of``, (n,); by default over all of them.

        Args, Returns: as ``wander``.
        Source:  linear propagation.
        """
        weight = length_s * (1.0 if of is None else of)
        centred = np.eye(begin_s.size) - weight / weight.sum()
        return np.asarray(centred @ self.wander(begin_s, length_s) @ centred.T)


def expected_range(count: int) -> float:
    """Return the mean range of so many independent normal readings, in their standard deviations.

    Args:    count: of the readings, 2 at the least.
    Returns: 1.128 for two, 4.498 for fifty.
    Source:  Tippett (1925): integral of 1 - F^n - (1 - F)^n.
    """
    at = np.linspace(-8.0, 8.0, 3201)
    below = special.ndtr(at)
    return float(np.trapezoid(1.0 - below**count - (1.0 - below) ** count, at))
