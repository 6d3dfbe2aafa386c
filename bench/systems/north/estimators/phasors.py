"""North finding: the eight samples of two lock-ins as phasors, the convention between phase and heading, the result,
and what a tilted rotation axis does to it.

Lock-in 1 and 2 at index position k = 1..4: ``U1k = f1 sin(phi + f2 + (k-1) 90 deg) + f3`` and
``U2k = f4 cos(phi + f5 + (k-1) 90 deg) + f6``; f2, f5 are how far the index pulses are from where they should be.

Convention ``index_to_north``: headings clockwise from north, table angle theta counter-clockwise from above, pulse A at
theta = 0 (lock-in 2), pulse B at theta = 270 degrees (lock-in 1). The sensing axis points to H0 - theta, so the signal
is ``Ke cos(H0 - theta) = Ke sin(theta + 90 deg - H0)``: a table that turns counter-clockwise (sense +1) gives
phi = 90 deg - H0. Turning clockwise (sense -1) the reference runs against theta: phi = 90 deg + H0, and B follows A
instead of leading it, which turns the sign of lock-in 1.

The lock-ins see the component of the Earth's rate across the rotation axis. An axis that leans east by a small angle
(right-handed tilt about north) mixes some of the vertical rate, omega sin(latitude), into the plane, towards west: the
north that is found turns west by tilt times tan(latitude). A lean to the north changes the amplitude only.

Source: FOG paper (002) equations (1), (13), (14) and section IV.2; its phi is not the heading, as the abstract's "zero
at East and West" says. Tilt: projection of (0, cos lat, sin lat) on the plane across (tilt, 0, 1) to first order; what
equation (7) leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.maths.arrays import Floats
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError

Complex = NDArray[np.complex128]
POSITIONS = 4
PARAMETERS = 4  # of eight samples: two components of the signal, two offsets
DOF = 2.0 * POSITIONS - PARAMETERS
TURNS = np.array([1.0, -1.0j, -1.0, 1.0j])  # (-i)^(k-1): turns every position back to the first
INDEX_TO_NORTH = {1: "H0 = 90 deg − φ", -1: "H0 = φ − 90 deg"}
LARGEST_LATITUDE_deg = 89.0


@dataclass(frozen=True)
class North:
    """Phase of the earth signal from eight samples; every array has the shape of the sets given, (...).

    Attributes:
        method: its name.   phi_deg: -180 (excluded) to 180; NaN where it is not determined.
        std_deg: standard uncertainty from what the eight samples leave over, ``dof`` degrees of freedom.
        phasor: amplitude times exp(i phi), unit of the samples; average these, never angles.
        noise: standard deviation of one output of a lock-in.   offset_1, offset_2: f3 and f6.
    """

    method: str
    phi_deg: Floats
    std_deg: Floats
    dof: float
    phasor: Complex
    noise: Floats
    offset_1: Floats
    offset_2: Floats

    @property
    def amplitude(self) -> Floats:
        """Amplitude of the lock-ins' outputs, unit of the samples."""
        return np.asarray(np.abs(self.phasor))

    def half_width_deg(self, probability: float = 0.95) -> Floats:
        """Half the interval that covers phi with this probability, degrees; 180 where the signal drowns in noise."""
        return half_width_deg(self.std_deg, self.dof, probability)


def eight(u1: ArrayLike, u2: ArrayLike) -> tuple[Floats, Floats]:
    """Return samples of both lock-ins as arrays (..., 4).

    Raises:  FitError B-FIT-110 unless both have the same shape and four index positions.
    """
    first, second = np.asarray(u1, np.float64), np.asarray(u2, np.float64)
    if first.shape != second.shape or first.ndim == 0 or first.shape[-1] != POSITIONS:
        raise FitError(
            "B-FIT-110",
            f"samples of lock-in 1 and 2 have the shapes {first.shape} and {second.shape}; "
            f"each set needs {POSITIONS} index positions of both",
            next_step="leave out a set in which an index position is missing, or take that set again",
        )
    return first, second


def oriented(u1: ArrayLike, u2: ArrayLike, sense: int) -> tuple[Floats, Floats]:
    """Return samples as if pulse B led pulse A, whichever way the table turned; all estimators expect these.

    Args:    u1, u2: (..., 4).   sense: +1 if the table angle grew, -1 if it fell.
    Returns: u1, u2; at sense -1 the placements f2, f5 change their sign as well.
    Raises:  FitError B-FIT-110 for another shape; ValueError for another sense.
    Source:  see the head of this file.
    """
    first, second = eight(u1, u2)
    return _checked(sense) * first, second


def heading_deg(phi_deg: ArrayLike, sense: int) -> Floats:
    """Heading of the sensing axis at encoder zero, 0 to 360 degrees, by the convention ``index_to_north``.

    Args:    phi_deg: of oriented samples, or of raw samples against the encoder (which carries the sense: then +1).
             sense: +1 or -1.
    Returns: degrees clockwise from north.
    Source:  see the head of this file.
    """
    return np.asarray(np.mod(_checked(sense) * (90.0 - np.asarray(phi_deg, np.float64)), 360.0))


def phase_deg(heading_deg: ArrayLike, sense: int) -> Floats:
    """Phase that belongs to a known heading: the inverse of ``heading_deg``, -180 (excluded) to 180 degrees."""
    return wrapped_deg(90.0 - _checked(sense) * np.asarray(heading_deg, np.float64))


def wrapped_deg(angle_deg: ArrayLike) -> Floats:
    """Angle or difference of angles in -180 (excluded) to 180 degrees; never modulo 180, which hides half turns."""
    return np.asarray(180.0 - np.mod(180.0 - np.asarray(angle_deg, np.float64), 360.0))


def lock_in_phasors(u1: Floats, u2: Floats) -> tuple[Complex, Complex]:
    """f1 exp(i (phi + f2)) and f4 exp(i (phi + f5)) of the two lock-ins, each from its own four samples.

    Args:    u1, u2: (..., 4).
    Returns: (...) each; offsets have cancelled.
    Source:  FOG paper (13a-d), (14a-d): their component at one turn of the index.
    """
    return np.asarray(0.5j * (u1 @ TURNS)), np.asarray(0.5 * (u2 @ TURNS))


def left_over(u1: Floats, u2: Floats, of_1: Complex, of_2: Complex) -> Floats:
    """Standard deviation of one output, (...), from what two phasors of one common signal leave of the eight samples.

    Args:    u1, u2: (..., 4).   of_1, of_2: f1 exp(i (phi + f2)) and f4 exp(i (phi + f5)) of the fit, (...).
    Returns: with ``DOF`` = 4 degrees of freedom: eight samples less two components and two offsets.
    Source:  residual variance of linear least squares.
    """
    first = u1 - u1.mean(-1, keepdims=True) - (of_1[..., None] / TURNS).imag
    second = u2 - u2.mean(-1, keepdims=True) - (of_2[..., None] / TURNS).real
    return np.asarray(np.sqrt((np.square(first).sum(-1) + np.square(second).sum(-1)) / DOF))


def angle_deg(phasor: Complex) -> Floats:
    """Return angle of a phasor in -180 (excluded) to 180 degrees; NaN for one of no length, which points nowhere."""
    direction_deg = wrapped_deg(np.rad2deg(np.angle(phasor)))
    return np.asarray(np.where(np.abs(phasor) > 0.0, direction_deg, np.nan))


def half_width_deg(std_deg: ArrayLike, dof: ArrayLike, probability: float = 0.95) -> Floats:
    """Half a coverage interval of the direction of a phasor.

    Args:    std_deg: standard uncertainty of the component across the phasor over its length, degrees.
             dof: its degrees of freedom, one or as many.   probability: of the interval.
    Returns: degrees, arcsin(t u); 180 where t u reaches the phasor's length: every direction is possible.
    Source:  Fieller's theorem for a direction: |Z| |sin(error)| <= t s; JCGM 100:2008 annex G for t.
    """
    std, freedom = np.broadcast_arrays(np.asarray(std_deg, np.float64), np.asarray(dof, np.float64))
    each, which = np.unique(freedom, return_inverse=True)
    factors = np.array([coverage_factor(float(number), probability) for number in each])
    sine = np.deg2rad(std) * factors[which].reshape(std.shape)
    width = np.rad2deg(np.arcsin(np.minimum(sine, 1.0)))
    return np.asarray(np.where(sine >= 1.0, 180.0, width))


def _checked(sense: int) -> int:
    if sense not in INDEX_TO_NORTH:
        raise ValueError(f"sense of rotation {sense!r} is neither +1 nor -1")
    return sense


def tilt_correction_deg(x_mrad: ArrayLike, y_mrad: ArrayLike, heading_deg: ArrayLike, latitude_deg: float) -> Floats:
    """Correction of the heading found, for the tilt of the rotation axis.

    Args:    x_mrad: tilt about the direction of the sensing axis at encoder zero, right-handed.   y_mrad: about the
             direction 90 degrees clockwise of it.   heading_deg: of the sensing axis at encoder zero, as found.
             latitude_deg: north positive, at most 89 either way.
    Returns: degrees, to be added to the heading; of second order at most 0.0015 deg is left at 10 mrad and 37 degrees.
    Raises:  FitError B-FIT-115 nearer to a pole, where there is no north to find.
    Source:  see the head of this file: -(x cos H - y sin H) tan(latitude).
    """
    heading = np.deg2rad(np.asarray(heading_deg, np.float64))
    about_north = np.asarray(x_mrad, np.float64) * np.cos(heading) - np.asarray(y_mrad, np.float64) * np.sin(heading)
    return np.asarray(-np.rad2deg(1e-3 * about_north) * _tangent(latitude_deg))


def tilt_std_deg(level_std_mrad: float, latitude_deg: float) -> float:
    """Return standard uncertainty of the heading from that of the level, alike and independent on both axes: degrees.

    Raises:  FitError B-FIT-115 within one degree of a pole.
    """
    return float(np.rad2deg(1e-3 * level_std_mrad) * abs(_tangent(latitude_deg)))


def _tangent(latitude_deg: float) -> float:
    if not abs(latitude_deg) <= LARGEST_LATITUDE_deg:
        raise FitError(
            "B-FIT-115",
            f"latitude {latitude_deg:g} deg (limit {LARGEST_LATITUDE_deg:g}): the Earth's rate has no horizontal part",
            next_step="state latitude_deg of the site in degrees, north positive",
        )
    return float(np.tan(np.deg2rad(latitude_deg)))
