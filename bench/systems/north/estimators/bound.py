"""How well north can be known at all, and how long it takes.

Source: S. M. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, example 3.4 (phase of a sinusoid in
white noise); for the square reference, the Fourier series of FOG paper (002) equation (10).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from bench.model.errors import FitError
from bench.systems.north.estimators.phasors import Array

SQUARE_PENALTY = math.pi / math.sqrt(8.0)  # of the standard deviation: mean noise power 1, of the sine's share 8/pi^2


def north_bound_deg(ke_V: ArrayLike, sigma_V: ArrayLike, samples: ArrayLike) -> Array:
    """Cramer-Rao bound of the phase: the smallest standard deviation of an estimator without bias.

    Args:    ke_V: amplitude of the earth signal.   sigma_V: standard deviation of the white noise of one sample.
             samples: in all whole turns together.
    Returns: degrees, sqrt(2) sigma / (Ke sqrt(N)), the same whether amplitude and offset are known or not.
    Source:  Kay, equation (3.41) and example 3.14: offset and amplitude are orthogonal to the phase over whole turns.
    """
    share = np.asarray(sigma_V, np.float64) / np.asarray(ke_V, np.float64)
    return np.asarray(np.rad2deg(share * np.sqrt(2.0 / np.asarray(samples, np.float64))))


def time_to_accuracy_s(
    std_deg: ArrayLike, seconds: float, accuracy_deg: float, *, factor: float = 1.0, floor_deg: float = 0.0
) -> Array:
    """Time of turning until ``factor`` standard uncertainties are within the accuracy.

    Args:    std_deg: standard deviation by noise after ``seconds``: measured scatter or bound.
             seconds: of signal in it.   accuracy_deg: required, > 0.   factor: coverage factor, 1 for the standard one.
             floor_deg: standard uncertainty that no time takes away (calibration, tilt).
    Returns: seconds, like 1/accuracy^2; infinity where the floor alone is too much.
    Raises:  FitError B-FIT-114 unless accuracy and seconds are above zero.
    Source:  variance of a mean of independent white noise.
    """
    if not (accuracy_deg > 0.0 and seconds > 0.0):
        raise FitError(
            "B-FIT-114",
            f"required accuracy {accuracy_deg:g} deg after {seconds:g} s: both must be above zero",
            next_step="state the limit azimuth_error in degrees, above zero",
        )
    left = (accuracy_deg / factor) ** 2 - floor_deg**2
    if left <= 0.0:
        return np.full(np.shape(std_deg), math.inf)
    return np.asarray(seconds * np.square(np.asarray(std_deg, np.float64)) / left)
