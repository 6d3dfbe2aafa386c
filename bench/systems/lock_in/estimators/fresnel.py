"""Lock-in error of each dither turnaround with the ripple in the model and nothing known of other turnarounds."""

from __future__ import annotations

import numpy as np

from bench.systems.lock_in.estimators.dither_shape import jumps_of, stepped_motion
from bench.systems.lock_in.estimators.motion import DitherMotion, dither_columns, solve_rows
from bench.systems.lock_in.estimators.shapes import lock_in_shapes
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds

_FLOOR_rad = 1e-3  # of the noise of a crossing that a tagger's clock does not make
_ROUNDS = 4  # each takes the error of the shapes down by the size of a lock-in error, 0.03 to 0.1


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
