"""Phase round a dither turnaround: the motion that a dither gives it, and what lock-in adds to that.

Small linear fits by the thousand, one per turnaround, are written out for speed: one numpy call solves all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]
Int64 = NDArray[np.int64]
_ROWS = 1000


def solve_rows(design: Array, values: Array, weight: Array | None = None) -> tuple[Array, Array]:
    """Least squares of each row, by normal equations of columns of length one.

    Args:    design: (u, k, p).   values: (u, k).   weight: (u, k), of a residual (not of its square); None: all alike.
    Returns: parameters (u, p), residuals (u, k) without the weight.
    Source:  normal equations.
    """
    if len(design) > _ROWS:  # some at a time: in between they take four times as much room
        cuts = [slice(at, at + _ROWS) for at in range(0, len(design), _ROWS)]
        parts = [solve_rows(design[cut], values[cut], None if weight is None else weight[cut]) for cut in cuts]
        solutions, residuals = zip(*parts, strict=True)
        return np.concatenate(solutions), np.concatenate(residuals)
    scaled = design if weight is None else design * weight[:, :, None]
    length = np.sqrt(np.einsum("ukp,ukp->up", scaled, scaled))
    unit = scaled / length[:, None, :]
    across = unit.transpose(0, 2, 1)
    right = values if weight is None else values * weight
    solution = np.linalg.solve(across @ unit, across @ right[:, :, None])[:, :, 0] / length
    return np.asarray(solution), np.asarray(values - (design @ solution[:, :, None])[:, :, 0])


def rms(residual: Array) -> Array:
    """Root mean square of each row, (u,).

    Source: definition.
    """
    return np.asarray(np.sqrt(np.mean(np.square(residual), axis=1)))


@dataclass(frozen=True)
class DitherMotion:
    """Phase about a turnaround, constant + even (1 - cos w t) / w^2 + odd sin(w t) / w + rate t, u turnarounds.

    ``coefficients`` (u, 3): constant, even, odd in rad, rad/s^2, rad/s.   ``sign`` (u,): of the curvature.
    ``omega_rad_s``: w.   ``rate_rad_s``: of the phase beside the dither, from the input rate.
    """

    coefficients: Array
    sign: Int64
    omega_rad_s: float
    rate_rad_s: float

    def phase(self, time_s: Array) -> Array:
        """Return phase at times (u, k), rad."""
        moving = np.einsum("ukp,up->uk", dither_columns(time_s, self.omega_rad_s), self.coefficients[:, 1:])
        return np.asarray(self.coefficients[:, :1] + moving + self.rate_rad_s * time_s)

    @cached_property
    def zero_rate_s(self) -> Array:
        """Where the phase turns round, (u,): the dither's own instant, and what the input rate shifts it by."""
        omega = self.omega_rad_s
        cosine, sine = self.sign * self.coefficients[:, 1], -self.sign * self.coefficients[:, 2] * omega
        shift = -self.sign * self.rate_rad_s * omega / np.hypot(sine, cosine)
        return np.asarray((np.arctan2(sine, cosine) + np.arcsin(np.clip(shift, -1.0, 1.0))) / omega)

    @cached_property
    def curvature_rad_s2(self) -> Array:
        """Size of the second derivative of the phase where it turns round, (u,)."""
        turn = self.omega_rad_s * self.zero_rate_s
        odd = self.coefficients[:, 2] * self.omega_rad_s
        return np.asarray(self.sign * (self.coefficients[:, 1] * np.cos(turn) - odd * np.sin(turn)))

    @cached_property
    def psi0_rad(self) -> Array:
        """Phase where it turns round, (u,)."""
        return self.phase(self.zero_rate_s[:, None])[:, 0]

    def parabolic(self, time_s: Array) -> Array:
        """Time x, (u, k), of which the phase is an exact parabola, psi0 + s a x^2 / 2."""
        risen = self.sign[:, None] * (self.phase(time_s) - self.psi0_rad[:, None])
        x = np.sqrt(2.0 * np.maximum(risen, 0.0) / self.curvature_rad_s2[:, None])
        return np.asarray(np.copysign(x, time_s - self.zero_rate_s[:, None]))


def dither_columns(time_s: Array, omega_rad_s: float) -> Array:
    """Return columns (1 - cos w t) / w^2 and sin(w t) / w: with a constant they are any dither about any instant.

    Args:    time_s: (u, k).   omega_rad_s: of the dither.
    Returns: (u, k, 2).
    Source:  s A (1 - cos w(t - t0)) is linear in s A cos(w t0) and s A sin(w t0).
    """
    turn = omega_rad_s * time_s
    return np.stack((2.0 * np.sin(turn / 2.0) ** 2 / omega_rad_s**2, np.sin(turn) / omega_rad_s), axis=-1)


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

    @property
    def columns(self) -> Array:
        """Return what lock-in adds at the crossings per kc and ks, (u, k, 2)."""
        return -np.stack((self.sine, self.cosine), axis=-1)

    def jump(self, constants: Array) -> Array:
        """Return what lock-in adds from far before to far behind by kc and ks, (u, 2): (u,), rad."""
        return np.asarray(-2.0 * (constants[:, 0] * self.sine_end + constants[:, 1] * self.cosine_end))


def lock_in_shapes(time_s: Array, motion: DitherMotion) -> LockInShapes:
    """Integrals of sin(psi) and cos(psi) over time for psi = psi0 + s a x^2 / 2, to the first order of 1/A.

    Without an input rate x = (2 / w) sin(w (t - t0) / 2), so dt = dx / r with r = cos(w (t - t0) / 2); a rate adds
    terms odd in x, which leave no jump.

    Args:    time_s: of the crossings, (u, k).   motion: of the u turnarounds.
    Source:  Abramowitz and Stegun 7.3.1, 7.3.2 (Fresnel integrals); that of 1 / r - 1 once by parts.
    """
    curvature, s, psi0 = motion.curvature_rad_s2[:, None], motion.sign[:, None], motion.psi0_rad[:, None]
    x = motion.parabolic(time_s)
    fresnel_s, fresnel_c = special.fresnel(x * np.sqrt(curvature / np.pi))
    wide, sin0, cos0 = np.sqrt(np.pi / curvature), np.sin(psi0), np.cos(psi0)
    sine, cosine = wide * (sin0 * fresnel_c + s * cos0 * fresnel_s), wide * (cos0 * fresnel_c - s * sin0 * fresnel_s)
    psi = psi0 + s * curvature * x**2 / 2.0
    small = s * motion.omega_rad_s**2 / (8.0 * curvature)
    r = np.sqrt(np.maximum(1.0 - (motion.omega_rad_s * x / 2.0) ** 2, 0.5))  # 1/2 at the pick-off's edges
    wider = 2.0 * x / (r * (1.0 + r))  # x with all orders of 1 / r: 8 % more at the last crossing of 15 cm
    sine_end, cosine_end = wide * (sin0 + s * cos0) / 2.0, wide * (cos0 - s * sin0) / 2.0
    return LockInShapes(
        sine=sine + small * (cosine - wider * np.cos(psi)),
        cosine=cosine - small * (sine - wider * np.sin(psi)),
        sine_end=(sine_end + small * cosine_end)[:, 0],
        cosine_end=(cosine_end - small * sine_end)[:, 0],
    )
