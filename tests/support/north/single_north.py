"""North by one lock-in alone, for comparison with the methods that use both."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.systems.north.estimators.phasors import DOF, North, angle_deg, eight, lock_in_phasors
from bench.systems.north.estimators.quadrant import propagated


def single_north(u1: ArrayLike, u2: ArrayLike, *, f2_deg: float = 0.0) -> North:
    """Phase by (17) with atan2: lock-in 1 alone, as a scheme with one lock-in has it.

    Args:    u1, u2: oriented samples, (..., 4); lock-in 2 only for the noise.   f2_deg: placement of its index pulse.
    Returns: North.
    Raises:  FitError B-FIT-110 for another shape.
    Source:  FOG paper (002) equation (17).
    """
    first, second = eight(u1, u2)
    phasor = np.asarray(lock_in_phasors(first, second)[0] * np.exp(-1j * np.deg2rad(f2_deg)))
    noise, std_deg = propagated(lambda a, b: lock_in_phasors(a, b)[0], first, second)
    return North("single", angle_deg(phasor), std_deg, DOF, phasor, noise, first.mean(-1), second.mean(-1))
