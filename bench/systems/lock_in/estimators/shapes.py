"""What lock-in adds to the phase round a dither turnaround: Fresnel integrals of the time from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from bench.systems.lock_in.estimators.motion import DitherMotion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LockInShapes:
    """Integrals from the zero-rate instant, second, and half of what they grow to from before to behind.

    ``sine``, ``cosine`` (u, k): of sin and cos of the phase over time, at the crossings; lock-in adds
    -kc ``sine`` - ks ``cosine`` with kc = kappa cos(beta), ks = kappa sin(beta).
    ``sine_end``, ``cosine_end`` (u,): far behind the turnaround; far before it they are the negative.
    """

    sine: Array
    cosine: Array
    sine_end: Array
    cosine_end: Array


def lock_in_shapes(time_s: Array, motion: DitherMotion) -> LockInShapes:
    """Integrals of sin(psi) and cos(psi) over time for psi = psi0 + s a x^2 / 2, with the first term of 1/A.

    Without an input rate x = (2 / w) sin(w (t - t0) / 2), so dt = dx (1 + w^2 x^2 / 8 + ...); a rate adds terms odd in
    x, which leave no jump.

    Args:    time_s: of the crossings, (u, k).   motion: of the u turnarounds.
    Returns: LockInShapes.
    Source:  Abramowitz and Stegun 7.3.1, 7.3.2 (Fresnel integrals); the second term by parts.
    """
    curvature, s, psi0 = motion.curvature_rad_s2[:, None], motion.sign[:, None], motion.psi0_rad[:, None]
    x = motion.parabolic(time_s)
    fresnel_s, fresnel_c = special.fresnel(x * np.sqrt(curvature / np.pi))
    wide, sin0, cos0 = np.sqrt(np.pi / curvature), np.sin(psi0), np.cos(psi0)
    sine, cosine = wide * (sin0 * fresnel_c + s * cos0 * fresnel_s), wide * (cos0 * fresnel_c - s * sin0 * fresnel_s)
    psi = psi0 + s * curvature * x**2 / 2.0
    small = s * motion.omega_rad_s**2 / (8.0 * curvature)
    sine_end, cosine_end = wide * (sin0 + s * cos0) / 2.0, wide * (cos0 - s * sin0) / 2.0
    return LockInShapes(
        sine=sine + small * (cosine - x * np.cos(psi)),
        cosine=cosine - small * (sine - x * np.sin(psi)),
        sine_end=(sine_end + small * cosine_end)[:, 0],
        cosine_end=(cosine_end - small * sine_end)[:, 0],
    )
