"""Lock-in error of each dither turnaround from its own crossings: parabolas, the dither's own shape, Fresnel's ripple.

The parabolas, as published, neglect the ripple that lock-in leaves on the crossings near the turnaround: unless the
backscatter phase is near 90 degrees they find errors larger than those that there are. The dither's shape neglects it
too, but shares amplitude and zero-rate instant between both sides, so the timing errors of all crossings go into few
unknowns. Errors of time count alike, as a tagger's clock makes them; so the crossings near the turnaround, which move
slowly, count most, and these carry the ripple. Phases that count alike would do better against it: at 28 cm and 100 MHz
0.25 of the error instead of 0.31 is left with 4 crossings and a backscatter phase of 90 degrees, 0.60 instead of 0.79
at 40 degrees; 0.18 instead of 0.49 with 16 crossings at 40. The third fit has the ripple in its model.

Phase round a dither turnaround: the motion that a dither gives it, and what lock-in adds to that.

Small linear fits by the thousand, one per turnaround, are written out for speed: one numpy call solves all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from bench.maths.arrays import Flags, Floats, Integers
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, spread

_ROWS = 1000
_FLOOR_rad = 1e-3  # of the noise of a crossing that a tagger's clock does not make
_ROUNDS = 4  # each takes the error of the shapes down by the size of a lock-in error, 0.03 to 0.1


def solve_rows(design: Floats, values: Floats, weight: Floats | None = None) -> Floats:
    """Least squares of each row, by normal equations of columns of length one.

    Args:    design: (u, k, p).   values: (u, k).   weight: (u, k), of a residual (not of its square); None: all alike.
    Returns: parameters (u, p).
    Source:  normal equations.
    """
    if len(design) > _ROWS:  # some at a time: in between they take four times as much room
        cuts = [slice(at, at + _ROWS) for at in range(0, len(design), _ROWS)]
        parts = [solve_rows(design[cut], values[cut], None if weight is None else weight[cut]) for cut in cuts]
        return np.concatenate(parts)
    scaled = design if weight is None else design * weight[:, :, None]
    length = np.sqrt(np.einsum("ukp,ukp->up", scaled, scaled))
    unit = scaled / length[:, None, :]
    across = unit.transpose(0, 2, 1)
    right = values if weight is None else values * weight
    return np.asarray(np.linalg.solve(across @ unit, across @ right[:, :, None])[:, :, 0] / length)


@dataclass(frozen=True)
class DitherMotion:
    """Phase about a turnaround, constant + even (1 - cos w t) / w^2 + odd sin(w t) / w + rate t, u turnarounds.

    ``coefficients`` (u, 3): constant, even, odd in rad, rad/s^2, rad/s.   ``sign`` (u,): of the curvature.
    ``omega_rad_s``: w.   ``rate_rad_s``: of the phase beside the dither, from the input rate.
    """

    coefficients: Floats
    sign: Integers
    omega_rad_s: float
    rate_rad_s: float

    def phase(self, time_s: Floats) -> Floats:
        """Return phase at times (u, k), rad."""
        moving = np.einsum("ukp,up->uk", dither_columns(time_s, self.omega_rad_s), self.coefficients[:, 1:])
        return np.asarray(self.coefficients[:, :1] + moving + self.rate_rad_s * time_s)

    @cached_property
    def zero_rate_s(self) -> Floats:
        """Where the phase turns round, (u,): the dither's own instant, and what the input rate shifts it by."""
        omega = self.omega_rad_s
        cosine, sine = self.sign * self.coefficients[:, 1], -self.sign * self.coefficients[:, 2] * omega
        shift = -self.sign * self.rate_rad_s * omega / np.hypot(sine, cosine)
        return (np.arctan2(sine, cosine) + np.arcsin(np.clip(shift, -1.0, 1.0))) / omega

    @cached_property
    def curvature_rad_s2(self) -> Floats:
        """Size of the second derivative of the phase where it turns round, (u,)."""
        turn = self.omega_rad_s * self.zero_rate_s
        odd = self.coefficients[:, 2] * self.omega_rad_s
        return self.sign * (self.coefficients[:, 1] * np.cos(turn) - odd * np.sin(turn))

    @cached_property
    def psi0_rad(self) -> Floats:
        """Phase where it turns round, (u,)."""
        return self.phase(self.zero_rate_s[:, None])[:, 0]

    def parabolic(self, time_s: Floats) -> Floats:
        """Time x, (u, k), of which the phase is an exact parabola, psi0 + s a x^2 / 2."""
        risen = self.sign[:, None] * (self.phase(time_s) - self.psi0_rad[:, None])
        x = np.sqrt(2.0 * np.maximum(risen, 0.0) / self.curvature_rad_s2[:, None])
        return np.copysign(x, time_s - self.zero_rate_s[:, None])


def dither_columns(time_s: Floats, omega_rad_s: float) -> Floats:
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

    sine: Floats
    cosine: Floats
    sine_end: Floats
    cosine_end: Floats

    @property
    def columns(self) -> Floats:
        """Return what lock-in adds at the crossings per kc and ks, (u, k, 2)."""
        return -np.stack((self.sine, self.cosine), axis=-1)

    def jump(self, constants: Floats) -> Floats:
        """Return what lock-in adds from far before to far behind by kc and ks, (u, 2): (u,), rad."""
        return -2.0 * (constants[:, 0] * self.sine_end + constants[:, 1] * self.cosine_end)


def lock_in_shapes(time_s: Floats, motion: DitherMotion) -> LockInShapes:
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


def parabolas(turns: Turnarounds, crossings: int = 4) -> Jumps:
    """Return two parabolas, carried on to the instant midway between their vertices; their difference is the jump.

    Args:    turns: at least that many crossings a side.   crossings: on each side, 3 or 4.
    Returns: Jumps.
    Source:  lock-in paper equations (7) to (9); Lim, EP 0103080 A2 (1982).
    """
    time_s, phase = turns.inner(crossings)
    before = _parabola(time_s[:, :crossings], phase[:, :crossings])
    behind = _parabola(time_s[:, crossings:], phase[:, crossings:])
    zero = (_vertex(before) + _vertex(behind)) / 2.0
    at_before, at_behind = _value(before, zero), _value(behind, zero)
    columns = (at_behind - at_before, (at_before + at_behind) / 2.0, np.abs(before[:, 2] + behind[:, 2]))
    return Jumps(*(spread(turns.usable, column) for column in columns))


def _parabola(time_s: Floats, phase: Floats) -> Floats:
    """Return coefficients (u, 3) of one side."""
    return solve_rows(np.stack((np.ones_like(time_s), time_s, time_s**2), axis=-1), phase)


def _vertex(coefficients: Floats) -> Floats:
    return -coefficients[:, 1] / (2.0 * coefficients[:, 2])


def _value(coefficients: Floats, time_s: Floats) -> Floats:
    return coefficients[:, 0] + time_s * (coefficients[:, 1] + time_s * coefficients[:, 2])


def dither_shape(turns: Turnarounds, crossings: int = 4) -> Jumps:
    """Return phase = (c before | c behind) + s A (1 - cos w (t - t0)) + input rate, four unknowns, all linear.

    Args:    turns: at least that many crossings a side.   crossings: on each side, 4 or 16.
    Returns: Jumps.
    Source:  lock-in paper section III with the dither's own shape in place of the parabola; least squares in time.
    """
    return jumps_of(turns.usable, *stepped_motion(turns, crossings))


def stepped_motion(turns: Turnarounds, crossings: int) -> tuple[Floats, DitherMotion]:
    """Step (u,), and motion midway between both sides, of the usable turnarounds.

    Source: as ``dither_shape``.
    """
    time_s, phase = turns.inner(crossings)
    weight = 1.0 / np.abs(np.where(time_s == 0.0, 0.5 / turns.clock_Hz, time_s))  # the rate grows with time
    side = np.zeros((*time_s.shape, 2))
    side[:, :, 0] = 1.0
    side[:, :crossings, 1], side[:, crossings:, 1] = -0.5, 0.5
    design = np.concatenate((side, dither_columns(time_s, turns.omega_rad_s)), axis=-1)
    solved = solve_rows(design, phase - turns.rate_rad_s * time_s, weight)
    motion = DitherMotion(solved[:, [0, 2, 3]], turns.sign[turns.usable], turns.omega_rad_s, turns.rate_rad_s)
    return solved[:, 1], motion


def jumps_of(usable: Flags, step: Floats, motion: DitherMotion) -> Jumps:
    """Jumps from what was found of the usable turnarounds, (u,).

    Source: none; bookkeeping.
    """
    columns = (step, motion.psi0_rad, motion.curvature_rad_s2)
    return Jumps(*(spread(usable, column) for column in columns))


def fresnel(turns: Turnarounds) -> Jumps:
    """Dither (c, A, t0) and two free lock-in amplitudes, the shapes found again from the fit until they settle.

    A crossing counts by its phase noise: that of one tick at its rate, and 1e-3 rad besides.

    Args:    turns: with 16 crossings a side, at least 4.
    Returns: Jumps.
    Source:  stationary phase of the ring laser's equation, lock-in paper (10); Abramowitz and Stegun 7.3.
    """
    time_s, phase = turns.inner(turns.crossings)
    motion = stepped_motion(turns, turns.crossings)[1]
    rate = motion.curvature_rad_s2[:, None] * (time_s - motion.zero_rate_s[:, None])
    weight = 1.0 / np.hypot(rate / (turns.clock_Hz * np.sqrt(12.0)), _FLOOR_rad)
    columns = np.concatenate((np.ones((*time_s.shape, 1)), dither_columns(time_s, turns.omega_rad_s)), axis=-1)
    for _ in range(_ROUNDS):
        lock_in = lock_in_shapes(time_s, motion)
        design = np.concatenate((columns, lock_in.sine[:, :, None], lock_in.cosine[:, :, None]), axis=-1)
        solved = solve_rows(design, phase - turns.rate_rad_s * time_s, weight)
        motion = DitherMotion(solved[:, :3], motion.sign, motion.omega_rad_s, motion.rate_rad_s)
    step = 2.0 * (solved[:, 3] * lock_in.sine_end + solved[:, 4] * lock_in.cosine_end)
    return jumps_of(turns.usable, step, motion)
