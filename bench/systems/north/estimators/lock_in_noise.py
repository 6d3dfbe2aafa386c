"""White noise behind the low-pass filters of a lock-in amplifier."""

from __future__ import annotations

import numpy as np

_GRID = 20_001


def lock_in_noise(noise: float, rate_Hz: float, time_constant_s: float, poles: int, mean_s: float = 0.0) -> float:
    """Return the standard deviation of X that white noise of the input leaves.

    Args:    noise: standard deviation of one sample of the input.   rate_Hz: of the samples.
             time_constant_s, poles: of the equal RC filters.   mean_s: over which the synchronous filter takes the mean
             before them, 0 for none.
    Returns: in the unit of ``noise``, RMS as X is: a sine of amplitude a reads a / sqrt 2.
    Source:  equivalent noise bandwidth of equal poles, integral of (1 + x^2)^-n (5/(64 T) for four: SR830 manual,
             chapter 3), with the power response sinc^2 of a mean; the reference sqrt 2 sin has a mean square of one.
    """
    angle = np.linspace(0.0, np.pi / 2.0, _GRID)
    x = np.tan(angle)  # frequency over that of one pole: dx = (1 + x^2) d(angle)
    power = (1.0 + x**2) ** (1.0 - poles) * np.sinc(x * mean_s / (2.0 * np.pi * time_constant_s)) ** 2
    bandwidth_Hz = float(np.trapezoid(power, angle)) / (2.0 * np.pi * time_constant_s)
    return float(noise * np.sqrt(2.0 * bandwidth_Hz / rate_Hz))
