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

North by least squares of eight lock-in samples, the default: one phasor, no branch and no singular direction; and
the calibration that tells where the index pulses really are and what the lock-ins' gains are.

``Z = SUM_k (U2k + i U1k) (-i)^(k-1)``, phi = arg Z. Offsets cancel. Both lock-ins of one position are read at the same
time, so an amplitude that changes from position to position cancels as well: each position has the full phasor of its
own. Unlike gains and misplaced index pulses are first taken out by the inverse of
``[[f1 cos f2, f1 sin f2], [-f4 sin f5, f4 cos f5]]``, which takes (sin phi, cos phi) to (U1, U2).

Calibrated, each lock-in's phasor turned back by the known phase is f1 exp(i f2), f4 exp(i f5): the eight samples and
one azimuth known from elsewhere determine what the eight samples alone cannot.

Source: least squares of FOG paper (002) equations (13) and (14) in place of its (17) to (21), and the same solved for
f1, f2, f4, f5; JCGM 102:2011 section 6.2.
"""

from __future__ import annotations

import math
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
        phasor: amplitude times exp(i phi), unit of the samples; average these, never angles.
        std_deg: standard uncertainty of phi from what the eight samples leave over, ``DOF`` degrees of freedom.
        noise: standard deviation of one output of a lock-in.
    """

    phasor: Complex
    std_deg: Floats
    noise: Floats

    @property
    def phi_deg(self) -> Floats:
        """Phase, -180 (excluded) to 180; NaN where it is not determined."""
        return angle_deg(self.phasor)


def oriented(u1: ArrayLike, u2: ArrayLike, sense: int) -> tuple[Floats, Floats]:
    """Return samples as if pulse B led pulse A, whichever way the table turned; all estimators expect these.

    Args:    u1, u2: (..., 4).   sense: +1 if the table angle grew, -1 if it fell.
    Returns: u1, u2; at sense -1 the placements f2, f5 change their sign as well.
    Raises:  FitError B-FIT-110 for another shape; ValueError for another sense.
    Source:  see the head of this file.
    """
    first, second = np.asarray(u1, np.float64), np.asarray(u2, np.float64)
    if first.shape != second.shape or first.ndim == 0 or first.shape[-1] != POSITIONS:
        raise FitError(
            "B-FIT-110",
            f"samples of lock-in 1 and 2 have the shapes {first.shape} and {second.shape}; "
            f"each set needs {POSITIONS} index positions of both",
            next_step="leave out a set in which an index position is missing, or take that set again",
        )
    return _checked(sense) * first, second


def heading_deg(phi_deg: ArrayLike, sense: int) -> Floats:
    """Heading of the sensing axis at encoder zero, 0 to 360 degrees, by the convention ``index_to_north``.

    Args:    phi_deg: of oriented samples, or of raw samples against the encoder (which carries the sense: then +1).
             sense: +1 or -1.
    Returns: degrees clockwise from north.
    Source:  see the head of this file.
    """
    return np.mod(_checked(sense) * (90.0 - np.asarray(phi_deg, np.float64)), 360.0)


def phase_deg(heading_deg: ArrayLike, sense: int) -> Floats:
    """Phase that belongs to a known heading: the inverse of ``heading_deg``, -180 (excluded) to 180 degrees."""
    return wrapped_deg(90.0 - _checked(sense) * np.asarray(heading_deg, np.float64))


def wrapped_deg(angle_deg: ArrayLike) -> Floats:
    """Angle or difference of angles in -180 (excluded) to 180 degrees; never modulo 180, which hides half turns."""
    return 180.0 - np.mod(180.0 - np.asarray(angle_deg, np.float64), 360.0)


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
    first, second = _residuals(u1, u2, of_1, of_2)
    return np.asarray(np.sqrt((np.square(first).sum(-1) + np.square(second).sum(-1)) / DOF))


def _residuals(u1: Floats, u2: Floats, of_1: Complex, of_2: Complex) -> tuple[Floats, Floats]:
    """Return what offsets and the phasors of a fit, (...), leave of the samples of both lock-ins, (..., 4) each."""
    first = u1 - u1.mean(-1, keepdims=True) - (of_1[..., None] / TURNS).imag
    second = u2 - u2.mean(-1, keepdims=True) - (of_2[..., None] / TURNS).real
    return first, second


def angle_deg(phasor: Complex | complex) -> Floats:
    """Return angle of a phasor in -180 (excluded) to 180 degrees; NaN for one of no length, which points nowhere."""
    direction_deg = wrapped_deg(np.rad2deg(np.angle(phasor)))
    return np.where(np.abs(phasor) > 0.0, direction_deg, np.nan)


def half_width_deg(std_deg: float, dof: float, probability: float = 0.95) -> float:
    """Half a coverage interval of the direction of a phasor.

    Args:    std_deg: standard uncertainty of the component across the phasor over its length, degrees.
             dof: its degrees of freedom.   probability: of the interval.
    Returns: degrees, arcsin(t u); 180 where t u reaches the phasor's length: every direction is possible.
    Source:  Fieller's theorem for a direction: |Z| |sin(error)| <= t s; JCGM 100:2008 annex G for t.
    """
    sine = np.deg2rad(std_deg) * coverage_factor(dof, probability)
    return 180.0 if sine >= 1.0 else float(np.rad2deg(np.arcsin(sine)))


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
    return -np.rad2deg(1e-3 * about_north) * _tangent(latitude_deg)


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


LARGEST_deg = 90.0  # between the two placements
_WEIGHTS = {"least_squares": (0.5, 0.5), "quadrant": (0.0, 1.0), "literal": (0.0, 1.0)}


@dataclass(frozen=True)
class IndexCalibration:
    """Constants of (13) and (14).

    Attributes:
        f1, f4: amplitudes, unit of the samples.   f2_deg, f5_deg: placements.   f3, f6: mean offsets.
        covariance: (4, 4) of (f1, f2_deg, f4, f5_deg), from what the samples leave over with ``dof`` degrees of
            freedom.   sets: of eight samples.
    """

    f1: float
    f2_deg: float
    f3: float
    f4: float
    f5_deg: float
    f6: float
    covariance: Floats
    dof: float
    sets: int

    @property
    def gains(self) -> tuple[float, float]:
        """Amplitudes of lock-in 1 and 2 against their geometric mean."""
        mean = float(np.sqrt(self.f1 * self.f4))
        return self.f1 / mean, self.f4 / mean

    def std_deg(self, method: str) -> float:
        """Standard uncertainty that the placements give every azimuth of a method.

        Args:    method: "least_squares" (mean of f2 and f5), "quadrant" or "literal" (f5).
        Returns: degrees.
        Raises:  KeyError for another method.
        Source:  slope of the phasor of ``bench.systems.north.estimators.phasors`` over f2 and f5.
        """
        slope = np.array(_WEIGHTS[method])
        return float(np.sqrt(slope @ self.covariance[1::2, 1::2] @ slope))

    def variance_over_noise(self, method: str) -> float:
        """Variance that the placements give every azimuth of a method over that of one set by least squares.

        Args:    method: as ``std_deg``.
        Returns: by the design of the calibration alone, for gains that are alike: one over its sets for least squares.
        Raises:  KeyError for another method.
        Source:  as ``std_deg``, with the variance noise^2 / (2 sets amplitude^2) of either placement.
        """
        return 2.0 * float(np.sum(np.square(_WEIGHTS[method]))) / self.sets


IDEAL = IndexCalibration(1.0, 0.0, 0.0, 1.0, 0.0, 0.0, np.zeros((4, 4)), math.inf, 0)


def eight_sample_north(u1: Floats, u2: Floats, index: IndexCalibration = IDEAL, noise: float | None = None) -> North:
    """Return phase of the earth signal from eight samples.

    Args:    u1, u2: oriented samples of lock-in 1 and 2 by index position, (..., 4), one unit.
             index: gains of the lock-ins and placements of their index pulses.
             noise: declared standard deviation of one output; None for what the samples leave over.
    Returns: North; ``std_deg`` = noise / (2 amplitude) for ideal lock-ins. It holds for noise that is independent
             between the eight samples; the calibration's own uncertainty is not in it.
    Source:  see the head of this file.
    """
    from_1, from_2 = _unmixed(index)
    phasor = np.asarray((from_1 * u1 + from_2 * u2) @ TURNS / 4.0)
    seen = _noise(u1, u2, index) if noise is None else np.full(phasor.shape, noise)
    spread = np.sqrt(2.0 * (abs(from_1) ** 2 + abs(from_2) ** 2)) / 4.0  # of either component of the phasor, per noise
    with np.errstate(divide="ignore", invalid="ignore"):
        std_deg = np.rad2deg(seen * spread / np.abs(phasor))
    return North(phasor, np.asarray(std_deg), seen)


def alternating(u1: Floats, u2: Floats, index: IndexCalibration = IDEAL) -> tuple[Floats, Floats]:
    """Return what an amplitude that changes from position to position leaves alone of the noise, and the rest.

    Every position has the full phasor of its own. Its part across the mean phasor does not feel the amplitude, and the
    part of that which changes sign from position to position feels neither an offset nor a slow turn of the phase.
    Gains and placements that are not those of the calibration are in it: they go with twice the phase.

    Args:    as ``eight_sample_north``.
    Returns: that part, (...), degrees: its standard deviation is the standard uncertainty of phi; mean square of the
             other three degrees of freedom, in its square.
    Source:  discrete Fourier transform of four phasors: component 0 is the signal, 1 and 3 hold offsets and drifts.
    """
    from_1, from_2 = _unmixed(index)
    turned = (from_1 * u1 + from_2 * u2) * TURNS
    mean = turned.mean(-1)
    about: Complex = turned * np.conj(mean)[..., None]
    half = np.asarray(about @ np.array([0.5, -0.5, 0.5, -0.5]))
    opposite = np.asarray(about @ (0.5 * TURNS))  # turns with the index; the offsets turn against it
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.rad2deg(0.5) / np.square(np.abs(mean))
        rest_deg2 = (np.square(half.real) + np.square(np.abs(opposite))) * np.square(scale) / 3.0
        return np.asarray(half.imag * scale), np.asarray(rest_deg2)


def _unmixed(index: IndexCalibration) -> tuple[complex, complex]:
    """Return what one unit of U1 and of U2 gives to cos phi + i sin phi: columns of the inverse 2 x 2 map."""
    gains, f2, f5 = index.gains, np.deg2rad(index.f2_deg), np.deg2rad(index.f5_deg)
    forward = np.array([
        [gains[0] * np.cos(f2), gains[0] * np.sin(f2)],
        [-gains[1] * np.sin(f5), gains[1] * np.cos(f5)],
    ])  # fmt: skip
    sine, cosine = np.linalg.inv(forward)
    return complex(cosine[0], sine[0]), complex(cosine[1], sine[1])


def _noise(u1: Floats, u2: Floats, index: IndexCalibration) -> Floats:
    """Return standard deviation of one output from the residuals of the fit with both lock-ins weighted alike."""
    gains = index.gains
    scale_1 = gains[0] * np.exp(1j * np.deg2rad(index.f2_deg))
    scale_2 = gains[1] * np.exp(1j * np.deg2rad(index.f5_deg))
    seen_1, seen_2 = lock_in_phasors(u1, u2)
    common: Complex = (np.conj(scale_1) * seen_1 + np.conj(scale_2) * seen_2) / (gains[0] ** 2 + gains[1] ** 2)
    return left_over(u1, u2, scale_1 * common, scale_2 * common)


def calibrate_index(u1: Floats, u2: Floats, phi_deg: ArrayLike, noise: float | None = None) -> IndexCalibration:
    """Gains, placements and offsets of both lock-ins at a known azimuth.

    Args:    u1, u2: oriented samples, (sets, 4).   phi_deg: known phase of each set, one or (sets,); sets at headings
             90 degrees apart cancel an amplitude that changes between index positions.
             noise: declared standard deviation of one output; None for what the samples leave over.
    Returns: IndexCalibration; offsets may differ from set to set.
    Raises:  FitError B-FIT-111 if pulses or lock-ins are exchanged, so that they no longer tell the sine from the
             cosine, B-FIT-113 without a signal.
    Source:  see the head of this file.
    """
    sets = len(u1)
    back = np.exp(-1j * np.deg2rad(phi_deg))
    of_1, of_2 = lock_in_phasors(u1, u2)
    mean_1, mean_2 = (complex((phasors * back).mean()) for phasors in (of_1, of_2))
    if not (abs(mean_1) > 0.0 and abs(mean_2) > 0.0):  # nothing, or NaN
        raise FitError(
            "B-FIT-113",
            f"{sets} sets of eight samples at a known azimuth hold no signal, or a value that is missing",
            next_step="take the calibration again; check that the table turned and the gyroscope was on",
        )
    f2_deg, f5_deg = (float(np.rad2deg(np.angle(mean))) for mean in (mean_1, mean_2))
    apart_deg = abs(float(wrapped_deg(f2_deg - f5_deg)))
    if not apart_deg < LARGEST_deg:
        raise FitError(
            "B-FIT-111",
            f"the index pulses are {apart_deg:.1f} degrees from being 90 degrees apart (f2 {f2_deg:.1f}, "
            f"f5 {f5_deg:.1f}; limit {LARGEST_deg:g}): sine and cosine of north cannot be told apart",
            next_step="check which index pulse goes to which lock-in, and the sense of rotation",
        )
    dof = 6.0 * sets - 4.0  # eight samples and two offsets a set, four common parameters
    if noise is None:
        first, second = _residuals(u1, u2, mean_1 / back, mean_2 / back)
        square = float(np.square(first).sum() + np.square(second).sum()) / dof
    else:
        square = noise**2
    variance = square / (2.0 * sets)
    turn = np.rad2deg(1.0) ** 2
    covariance = variance * np.diag([1.0, turn / abs(mean_1) ** 2, 1.0, turn / abs(mean_2) ** 2])
    return IndexCalibration(
        abs(mean_1), f2_deg, float(u1.mean()), abs(mean_2), f5_deg, float(u2.mean()), covariance, dof, sets
    )
