"""North by the paper's formulas exactly as printed, and which of them fail where.

Every arctan of (17), (18) and (21) knows an angle to a half turn only: the north found is 180 degrees off on half of
the circle. Near phi + f2 = 90 degrees noise throws the four terms of (17) to different branches, and their mean is
anything. (19) and (20) divide nothing by nothing at the four cardinal directions, (21) divides by U2 = 0.

Source: FOG paper (002) equations (15) to (21).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.systems.north.estimators.phasors import DOF, Array, North, angle_deg, eight, lock_in_phasors, wrapped_deg
from bench.systems.north.estimators.quadrant import quadrant_north

METHOD = "literal"
_NOTHING = 1e-9  # relative: below it a quotient is of rounding errors
_WRONG_AMPLITUDE = 0.1


@dataclass(frozen=True)
class LiteralFailures:
    """What failed in each set, (...).

    Attributes:
        half_turn: the north found is on the wrong half of the circle, as seen by the formulas with quadrants.
        flipped_17, flipped_18: terms of four on another branch than the angle itself, modulo a half turn.
        amplitude_19, amplitude_20: f1, f4 is nothing over nothing, or its size more than 10 % off.
        u2_zero: (21) divides by 0.
    """

    half_turn: NDArray[np.bool_]
    flipped_17: NDArray[np.int64]
    flipped_18: NDArray[np.int64]
    amplitude_19: NDArray[np.bool_]
    amplitude_20: NDArray[np.bool_]
    u2_zero: NDArray[np.bool_]

    @property
    def any(self) -> NDArray[np.bool_]:
        """Sets in which something failed, (...)."""
        flipped = (self.flipped_17 > 0) | (self.flipped_18 > 0)
        return np.asarray(self.half_turn | flipped | self.amplitude_19 | self.amplitude_20 | self.u2_zero)


@dataclass(frozen=True)
class LiteralNorth:
    """``north``: the result, its uncertainty that of noise alone where nothing fails; ``failures`` of each set."""

    north: North
    failures: LiteralFailures


def literal_north(u1: ArrayLike, u2: ArrayLike, *, f5_deg: float = 0.0) -> LiteralNorth:
    """Return phase by (15) to (21) as printed, with U_LA1 = U11, U_LA2 = U21.

    Args:    u1, u2: oriented samples, (..., 4).   f5_deg: what (21) takes off at its end; the eight samples do not
             contain it, and the paper does not say where it comes from.
    Returns: LiteralNorth; NaN where a formula gives none.
    Raises:  FitError B-FIT-110 for another shape.
    Source:  see the head of this file.
    """
    first, second = eight(u1, u2)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms_17, terms_18 = _terms(first, second)
        x, y = terms_17.mean(0), terms_18.mean(0)
        f1 = ((first[..., 0] - first[..., 2]) / np.sin(x) + (first[..., 1] - first[..., 3]) / np.cos(x)) / 4.0
        f4 = ((second[..., 0] - second[..., 2]) / np.cos(y) - (second[..., 1] - second[..., 3]) / np.sin(y)) / 4.0
        big_1 = (first[..., 0] - first.mean(-1)) * f4
        big_2 = (second[..., 0] - second.mean(-1)) * f1
        found = np.arctan((big_1 / big_2 - np.sin(x - y)) / np.cos(x - y))
    phi_deg = wrapped_deg(np.rad2deg(found) - f5_deg)
    safe = quadrant_north(first, second, f5_deg=f5_deg)
    of_1, of_2 = (np.abs(one) for one in lock_in_phasors(first, second))
    failures = LiteralFailures(
        half_turn=np.abs(wrapped_deg(phi_deg - safe.phi_deg)) > 90.0,
        flipped_17=_flipped(terms_17, angle_deg(lock_in_phasors(first, second)[0])),
        flipped_18=_flipped(terms_18, angle_deg(lock_in_phasors(first, second)[1])),
        amplitude_19=_amplitude_failed(f1, of_1, x),
        amplitude_20=_amplitude_failed(f4, of_2, y),
        u2_zero=np.abs(second[..., 0] - second.mean(-1)) <= _NOTHING * of_2,
    )
    phasor = np.asarray((of_1 + of_2) / 2.0 * np.exp(1j * np.deg2rad(phi_deg)), np.complex128)
    north = North(METHOD, phi_deg, safe.std_deg, DOF, phasor, safe.noise, safe.offset_1, safe.offset_2)
    return LiteralNorth(north, failures)


def _terms(u1: Array, u2: Array) -> tuple[Array, Array]:
    """Return the four signed terms of (17) and of (18), (4, ...) each, radian."""
    u11, u12, u13, u14 = np.moveaxis(u1 - u1.mean(-1, keepdims=True), -1, 0)
    u21, u22, u23, u24 = np.moveaxis(u2 - u2.mean(-1, keepdims=True), -1, 0)
    of_17 = (np.arctan(u11 / u12), -np.arctan(u11 / u14), np.arctan(u13 / u14), -np.arctan(u13 / u12))
    of_18 = (np.arctan(u24 / u21), -np.arctan(u22 / u21), np.arctan(u22 / u23), -np.arctan(u24 / u23))
    return np.array(of_17), np.array(of_18)


def _flipped(terms: Array, angle_deg: Array) -> NDArray[np.int64]:
    """Terms that are further than a quarter turn from the angle as an arctan gives it, (...)."""
    branch_deg = np.rad2deg(np.arctan(np.tan(np.deg2rad(angle_deg))))
    return np.asarray((np.abs(np.rad2deg(terms) - branch_deg) > 90.0).sum(0))


def _amplitude_failed(found: Array, right: Array, angle: Array) -> NDArray[np.bool_]:
    nothing = np.minimum(np.abs(np.sin(angle)), np.abs(np.cos(angle))) <= _NOTHING
    return np.asarray(nothing | ~(np.abs(np.abs(found) - right) <= _WRONG_AMPLITUDE * right))
