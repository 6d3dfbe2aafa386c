"""Lock-in error of each dither turnaround from one dither motion fitted to both sides, with a step between them.

Amplitude and zero-rate instant are shared, so the timing errors of all crossings go into few unknowns. The ripple of
lock-in on the crossings is neglected, as in the parabolas. Errors of time count alike, as a tagger's clock makes them;
so the crossings near the turnaround, which move slowly, count most, and these carry the ripple. Phases that count alike
would do better against it: at 28 cm and 100 MHz 0.25 of the error instead of 0.31 is left with 4 crossings and a
backscatter phase of 90 degrees, 0.60 instead of 0.79 at 40 degrees; 0.18 instead of 0.49 with 16 crossings at 40.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bench.systems.lock_in.estimators.motion import DitherMotion, dither_columns, rms, solve_rows
from bench.systems.lock_in.estimators.turnarounds import Jumps, Turnarounds, spread

Array = NDArray[np.float64]


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
    found = (step, motion.psi0_rad, motion.curvature_rad_s2, motion.zero_rate_s, rms(residual))
    return Jumps(method, *(spread(usable, column) for column in found))
