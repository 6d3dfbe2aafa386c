"""Lock-in error of each dither turnaround from its own crossings: parabolas, the dither's own shape, Fresnel's ripple.

The parabolas, as published, neglect the ripple that lock-in leaves on the crossings near the turnaround: unless the
backscatter phase is near 90 degrees they find errors larger than those that there are. The dither's shape neglects it
too, but shares amplitude and zero-rate instant between both sides, so the timing errors of all crossings go into few
unknowns. Errors of time count alike, as a tagger's clock makes them; so the crossings near the turnaround, which move
slowly, count most, and these carry the ripple. Phases that count alike would do better against it: at 28 cm and 100 MHz
0.25 of the error instead of 0.31 is left with 4 crossings and a backscatter phase of 90 degrees, 0.60 instead of 0.79
at 40 degrees; 0.18 instead of 0.49 with 16 crossings at 40. The third fit has the ripple in its model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.lock_in.estimators.motion import DitherMotion, dither_columns, lock_in_shapes, rms, solve_rows
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, spread

Array = NDArray[np.float64]
_FLOOR_rad = 1e-3  # of the noise of a crossing that a tagger's clock does not make
_ROUNDS = 4  # each takes the error of the shapes down by the size of a lock-in error, 0.03 to 0.1


def parabolas(turns: Turnarounds, crossings: int = 4) -> Jumps:
    """Return two parabolas, carried on to the instant midway between their vertices; their difference is the jump.

    Args:    turns: at least that many crossings a side.   crossings: on each side, 3 or 4.
    Returns: Jumps, method "parabolas".
    Source:  lock-in paper equations (7) to (9); Lim, EP 0103080 A2 (1982).
    """
    time_s, phase = turns.inner(crossings)
    before, left = _parabola(time_s[:, :crossings], phase[:, :crossings])
    behind, right = _parabola(time_s[:, crossings:], phase[:, crossings:])
    zero = (_vertex(before) + _vertex(behind)) / 2.0
    at_before, at_behind = _value(before, zero), _value(behind, zero)
    columns = (
        at_behind - at_before,
        (at_before + at_behind) / 2.0,
        np.abs(before[:, 2] + behind[:, 2]),
        zero,
        rms(np.column_stack((left, right))),
    )
    return Jumps("parabolas", *(spread(turns.usable, column) for column in columns))


def _parabola(time_s: Array, phase: Array) -> tuple[Array, Array]:
    """Return coefficients (u, 3) and residuals of one side."""
    return solve_rows(np.stack((np.ones_like(time_s), time_s, time_s**2), axis=-1), phase)


def _vertex(coefficients: Array) -> Array:
    return np.asarray(-coefficients[:, 1] / (2.0 * coefficients[:, 2]))


def _value(coefficients: Array, time_s: Array) -> Array:
    return np.asarray(coefficients[:, 0] + time_s * (coefficients[:, 1] + time_s * coefficients[:, 2]))


def dither_shape(turns: Turnarounds, crossings: int = 4) -> Jumps:
    """Return phase = (c before | c behind) + s A (1 - cos w (t - t0)) + input rate, four unknowns, all linear.

    Args:    turns: at least that many crossings a side.   crossings: on each side, 4 or 16.
    Returns: Jumps, method "dither_shape", or "dither_shape_16" with 16 crossings.
    Source:  lock-in paper section III with the dither's own shape in place of the parabola; least squares in time.
    """
    step, motion, residual = stepped_motion(turns, crossings)
    name = "dither_shape" if crossings == 4 else f"dither_shape_{crossings}"
    return jumps_of(name, turns.usable, step, motion, residual)


def stepped_motion(turns: Turnarounds, crossings: int) -> tuple[Array, DitherMotion, Array]:
    """Step (u,), motion midway between both sides, and residuals (u, 2 crossings) of the usable turnarounds.

    Source: as ``dither_shape``.
    """
    time_s, phase = turns.inner(crossings)
    weight = 1.0 / np.abs(np.where(time_s == 0.0, 0.5 / turns.clock_Hz, time_s))  # the rate grows with time
    side = np.zeros((*time_s.shape, 2))
    side[:, :, 0] = 1.0
    side[:, :crossings, 1], side[:, crossings:, 1] = -0.5, 0.5
    design = np.concatenate((side, dither_columns(time_s, turns.omega_rad_s)), axis=-1)
    solved, residual = solve_rows(design, phase - turns.rate_rad_s * time_s, weight)
    motion = DitherMotion(solved[:, [0, 2, 3]], turns.sign[turns.usable], turns.omega_rad_s, turns.rate_rad_s)
    return solved[:, 1], motion, residual


def jumps_of(method: str, usable: NDArray[np.bool_], step: Array, motion: DitherMotion, residual: Array) -> Jumps:
    """Jumps from what was found of the usable turnarounds, (u,).

    Source: none; bookkeeping.
    """
    columns = (step, motion.psi0_rad, motion.curvature_rad_s2, motion.zero_rate_s, rms(residual))
    return Jumps(method, *(spread(usable, column) for column in columns))


def fresnel(turns: Turnarounds) -> Jumps:
    """Dither (c, A, t0) and two free lock-in amplitudes, the shapes found again from the fit until they settle.

    A crossing counts by its phase noise: that of one tick at its rate, and 1e-3 rad besides.

    Args:    turns: with 16 crossings a side, at least 4.
    Returns: Jumps, method "fresnel".
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
        solved, residual = solve_rows(design, phase - turns.rate_rad_s * time_s, weight)
        motion = DitherMotion(solved[:, :3], motion.sign, motion.omega_rad_s, motion.rate_rad_s)
    step = 2.0 * (solved[:, 3] * lock_in.sine_end + solved[:, 4] * lock_in.cosine_end)
    return jumps_of("fresnel", turns.usable, step, motion, residual)
