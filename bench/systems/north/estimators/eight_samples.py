"""North by least squares of eight lock-in samples, the default: one phasor, no branch and no singular direction.

``Z = SUM_k (U2k + i U1k) (-i)^(k-1)``, phi = arg Z. Offsets cancel. Both lock-ins of one position are read at the same
time, so an amplitude that changes from position to position cancels as well: each position has the full phasor of its
own. Unlike gains and misplaced index pulses are first taken out by the inverse of
``[[f1 cos f2, f1 sin f2], [-f4 sin f5, f4 cos f5]]``, which takes (sin phi, cos phi) to (U1, U2).

Source: least squares of FOG paper (002) equations (13) and (14) in place of its (17) to (21).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.model.errors import FitError
from bench.systems.north.estimators.phasors import (
    DOF,
    TURNS,
    Array,
    Complex,
    North,
    angle_deg,
    eight,
    left_over,
    lock_in_phasors,
    wrapped_deg,
)

METHOD = "least_squares"
LARGEST_deg = 90.0  # between the two placements


def eight_sample_north(
    u1: ArrayLike, u2: ArrayLike, *, gains: tuple[float, float] | None = None, f2_deg: float = 0.0, f5_deg: float = 0.0
) -> North:
    """Return phase of the earth signal from eight samples.

    Args:    u1, u2: oriented samples of lock-in 1 and 2 by index position, (..., 4), one unit.
             gains: of lock-in 1 and 2 against their mean, from a calibration; None for alike.
             f2_deg, f5_deg: placement of their index pulses, from a calibration.
    Returns: North; ``std_deg`` = noise / (2 amplitude) for ideal lock-ins. It holds for noise that is independent
             between the eight samples; the calibration's own uncertainty is not in it.
    Raises:  FitError B-FIT-110 for another shape, B-FIT-111 if the pulses are 90 degrees or more off.
    Source:  see the head of this file.
    """
    first, second = eight(u1, u2)
    check_placement(f2_deg, f5_deg)
    from_1, from_2 = _unmixed(gains or (1.0, 1.0), f2_deg, f5_deg)
    phasor = np.asarray((from_1 * first + from_2 * second) @ TURNS / 4.0)
    noise = _noise(first, second, gains or (1.0, 1.0), f2_deg, f5_deg)
    spread = np.sqrt(2.0 * (abs(from_1) ** 2 + abs(from_2) ** 2)) / 4.0  # of either component of the phasor, per noise
    phi_deg = angle_deg(phasor)
    with np.errstate(divide="ignore", invalid="ignore"):
        std_deg = np.rad2deg(noise * spread / np.abs(phasor))
    return North(METHOD, phi_deg, np.asarray(std_deg), DOF, phasor, noise, first.mean(-1), second.mean(-1))


def check_placement(f2_deg: float, f5_deg: float) -> None:
    """Refuse index pulses that no longer tell the sine from the cosine.

    Raises:  FitError B-FIT-111 unless |f2 - f5| < 90 degrees.
    """
    apart = abs(float(wrapped_deg(f2_deg - f5_deg)))
    if not apart < LARGEST_deg:
        raise FitError(
            "B-FIT-111",
            f"the index pulses are {apart:.1f} degrees from being 90 degrees apart (f2 {f2_deg:.1f}, f5 {f5_deg:.1f}; "
            f"limit {LARGEST_deg:g}): sine and cosine of north cannot be told apart",
            next_step="check which index pulse goes to which lock-in, and the sense of rotation",
        )


def _unmixed(gains: tuple[float, float], f2_deg: float, f5_deg: float) -> tuple[complex, complex]:
    """Return what one unit of U1 and of U2 gives to cos phi + i sin phi: columns of the inverse 2 x 2 map."""
    f2, f5 = np.deg2rad(f2_deg), np.deg2rad(f5_deg)
    forward = np.array([
        [gains[0] * np.cos(f2), gains[0] * np.sin(f2)],
        [-gains[1] * np.sin(f5), gains[1] * np.cos(f5)],
    ])  # fmt: skip
    sine, cosine = np.linalg.inv(forward)
    return complex(cosine[0], sine[0]), complex(cosine[1], sine[1])


def _noise(first: Array, second: Array, gains: tuple[float, float], f2_deg: float, f5_deg: float) -> Array:
    """Return standard deviation of one output from the residuals of the fit with both lock-ins weighted alike."""
    scale_1 = gains[0] * np.exp(1j * np.deg2rad(f2_deg))
    scale_2 = gains[1] * np.exp(1j * np.deg2rad(f5_deg))
    seen_1, seen_2 = lock_in_phasors(first, second)
    common: Complex = (np.conj(scale_1) * seen_1 + np.conj(scale_2) * seen_2) / (gains[0] ** 2 + gains[1] ** 2)
    return left_over(first, second, scale_1 * common, scale_2 * common)
