"""Noise of known power laws for tests of the Allan deviation; nothing here comes from bench.fit."""

import numpy as np


def kasdin(rng: np.random.Generator, n: int, exponent: int) -> np.ndarray:
    """Fractionally integrated white noise, (n,): two-sided spectrum (2 sin(pi f))^exponent per sample.

    Kasdin, Proc. IEEE 83 (1995) 802: the filter (1 - z^-1)^(exponent / 2), here after a long lead-in.
    """
    length = 4 * n
    k = np.arange(1, length)
    taps = np.concatenate(([1.0], np.cumprod((k - 1 - exponent / 2) / k)))
    noise = rng.standard_normal(length)
    return np.fft.irfft(np.fft.rfft(taps, 2 * length) * np.fft.rfft(noise, 2 * length))[length - n : length]


def record(rng: np.random.Generator, n: int, interval_s: float, **coefficients: float) -> np.ndarray:
    """Mean rates over successive intervals, (n,), with the noise terms of IEEE Std 952 by name."""
    found = coefficients.get("white_noise", 0.0) / np.sqrt(interval_s) * rng.standard_normal(n)
    found += coefficients.get("quantisation_noise", 0.0) / interval_s * np.diff(rng.standard_normal(n + 1))
    found += coefficients.get("bias_instability", 0.0) * kasdin(rng, n, -1)
    step = coefficients.get("random_walk", 0.0) * np.sqrt(interval_s)
    end, within = step * rng.standard_normal((2, n))
    found += np.cumsum(end) - end / 2.0 + within / np.sqrt(12.0)  # mean of a Wiener process given its ends
    return np.asarray(found + coefficients.get("rate_ramp", 0.0) * interval_s * np.arange(n))
