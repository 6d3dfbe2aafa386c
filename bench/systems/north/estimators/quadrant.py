"""North by the paper's algebra with the quadrants kept; for comparison with least squares.

With s = (U11 - U13)/2, c = (U12 - U14)/2, c' = (U21 - U23)/2, s' = (U24 - U22)/2: phi + f2 = atan2(s, c),
phi + f5 = atan2(s', c'), d = f2 - f5 their difference, and
``phi = atan2(U1 - U2 sin d, U2 cos d) - f5``, U1 = (U11 - f3) f4, U2 = (U21 - f6) f1.

The eight samples determine phi + f2 and phi + f5, never phi: one placement must be known, 0 by construction or from a
calibration. The two quadrants are right only while |f2 - f5| < 90 degrees.

Source: FOG paper (002) equations (15) to (21), with atan2 in place of the arctan, and hypot in place of (19), (20).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from bench.systems.north.estimators.eight_samples import LARGEST_deg
from bench.systems.north.estimators.phasors import (
    DOF,
    Array,
    Complex,
    North,
    angle_deg,
    eight,
    left_over,
    lock_in_phasors,
    wrapped_deg,
)

METHOD = "quadrant"
_STEP = 1e-6  # of the amplitude, for derivatives


def quadrant_north(u1: ArrayLike, u2: ArrayLike, *, f5_deg: float = 0.0) -> North:
    """Return phase by (21) with both quadrants kept; noisier than least squares, and off where the amplitude drifts.

    Args:    u1, u2: oriented samples, (..., 4).   f5_deg: placement of the index pulse of lock-in 2.
    Returns: North, NaN in the rows whose samples say |f2 - f5| >= 90 degrees; noise as of least squares.
    Raises:  FitError B-FIT-110 for another shape.
    Source:  see the head of this file.
    """
    first, second = eight(u1, u2)
    of_1, of_2 = lock_in_phasors(first, second)
    apart_deg = wrapped_deg(np.rad2deg(np.angle(of_1) - np.angle(of_2)))
    phasor = np.where(np.abs(apart_deg) < LARGEST_deg, _quadrant(first, second), np.nan)
    phasor = phasor * np.exp(-1j * np.deg2rad(f5_deg))
    noise, std_deg = propagated(_quadrant, first, second)
    std_deg = np.where(np.isfinite(phasor), std_deg, np.nan)
    return North(METHOD, angle_deg(phasor), std_deg, DOF, phasor, noise, first.mean(-1), second.mean(-1))


def propagated(phasor_of: Callable[[Array, Array], Complex], u1: Array, u2: Array) -> tuple[Array, Array]:
    """Noise of one output and what it makes of the angle of a phasor, by first derivatives.

    Args:    phasor_of: samples (..., 4) of both lock-ins to a phasor (...).   u1, u2: (..., 4).
    Returns: noise (...), unit of the samples, 4 degrees of freedom; standard deviation of the angle (...), degrees.
    Source:  JCGM 100:2008 section 5.1.2, the eight samples independent.
    """
    of_1, of_2 = lock_in_phasors(u1, u2)
    common = (of_1 + of_2) / 2.0
    noise = left_over(u1, u2, common, common)
    both = np.concatenate((u1, u2), axis=-1)
    step = _STEP * np.maximum(np.abs(common), 1e-300)[..., None]
    slopes = []
    with np.errstate(divide="ignore", invalid="ignore"):
        for which in np.eye(8):
            up, down = both + step * which, both - step * which
            turned = phasor_of(up[..., :4], up[..., 4:]) / phasor_of(down[..., :4], down[..., 4:])
            slopes.append(np.angle(turned) / (2.0 * step[..., 0]))
        std_deg = np.rad2deg(noise * np.sqrt(np.square(slopes).sum(0)))
    return noise, np.asarray(std_deg)


def _quadrant(u1: Array, u2: Array) -> Complex:
    """Phasor at the angle phi + f5, as long as the mean of both amplitudes."""
    of_1, of_2 = lock_in_phasors(u1, u2)
    apart = np.angle(of_1) - np.angle(of_2)
    big_1 = (u1[..., 0] - u1.mean(-1)) * np.abs(of_2)
    big_2 = (u2[..., 0] - u2.mean(-1)) * np.abs(of_1)
    towards = big_2 * np.cos(apart) + 1j * (big_1 - big_2 * np.sin(apart))
    length = np.abs(towards)
    mean = (np.abs(of_1) + np.abs(of_2)) / 2.0
    return np.asarray(np.where(length > 0.0, towards / np.where(length > 0.0, length, 1.0) * mean, 0.0))
