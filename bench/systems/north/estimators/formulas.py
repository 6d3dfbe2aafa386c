"""North by the paper's formulas: with the quadrants kept, and exactly as printed with what fails where; for comparison.

With s = (U11 - U13)/2, c = (U12 - U14)/2, c' = (U21 - U23)/2, s' = (U24 - U22)/2: phi + f2 = atan2(s, c),
phi + f5 = atan2(s', c'), d = f2 - f5 their difference, and
``phi = atan2(U1 - U2 sin d, U2 cos d) - f5``, U1 = (U11 - f3) f4, U2 = (U21 - f6) f1.

The eight samples determine phi + f2 and phi + f5, never phi: one placement must be known, 0 by construction or from a
calibration. The two quadrants are right only while |f2 - f5| < 90 degrees.

As printed, every arctan of (17), (18) and (21) knows an angle to a half turn only: the north found is 180 degrees off
on half of the circle. Near phi + f2 = 90 degrees noise throws the four terms of (17) to different branches, and their
mean is anything. (19) and (20) divide nothing by nothing at the four cardinal directions, (21) divides by U2 = 0.

Source: FOG paper (002) equations (15) to (21); with quadrants atan2 in place of the arctan, hypot in place
of (19) and (20).

White noise behind the low-pass filters of a lock-in amplifier.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.maths.arrays import Flags, Floats, Integers
from bench.systems.north.estimators.phasors import (
    Complex,
    LARGEST_deg,
    North,
    angle_deg,
    left_over,
    lock_in_phasors,
    wrapped_deg,
)

_STEP = 1e-6  # of the amplitude, for derivatives
_NOTHING = 1e-9  # relative: below it a quotient is of rounding errors
_WRONG_AMPLITUDE = 0.1
_GRID = 20_001


def quadrant_north(u1: Floats, u2: Floats, f5_deg: float = 0.0, noise: float | None = None) -> North:
    """Return phase by (21) with both quadrants kept; noisier than least squares, and off where the amplitude drifts.

    Args:    u1, u2: oriented samples, (..., 4).   f5_deg: placement of the index pulse of lock-in 2.
             noise: declared standard deviation of one output; None for what the samples leave over.
    Returns: North, NaN in the rows whose samples say |f2 - f5| >= 90 degrees; noise as of least squares.
    Source:  see the head of this file.
    """
    phasor = _placed(u1, u2, f5_deg)
    seen, std_deg = propagated(_quadrant, u1, u2, noise)
    return North(phasor, np.where(np.isfinite(phasor), std_deg, np.nan), seen)


def _placed(u1: Floats, u2: Floats, f5_deg: float) -> Complex:
    """Return the phasor of ``quadrant_north``."""
    of_1, of_2 = lock_in_phasors(u1, u2)
    apart_deg = wrapped_deg(np.rad2deg(np.angle(of_1) - np.angle(of_2)))
    phasor = np.where(np.abs(apart_deg) < LARGEST_deg, _quadrant(u1, u2), np.nan)
    return np.asarray(phasor * np.exp(-1j * np.deg2rad(f5_deg)))


def propagated(
    phasor_of: Callable[[Floats, Floats], Complex], u1: Floats, u2: Floats, declared: float | None = None
) -> tuple[Floats, Floats]:
    """Noise of one output and what it makes of the angle of a phasor, by first derivatives.

    Args:    phasor_of: samples (..., 4) of both lock-ins to a phasor (...).   u1, u2: (..., 4).
             declared: noise of one output; None for what the samples leave over.
    Returns: noise (...), unit of the samples, 4 degrees of freedom; standard deviation of the angle (...), degrees.
    Source:  JCGM 100:2008 section 5.1.2, the eight samples independent.
    """
    of_1, of_2 = lock_in_phasors(u1, u2)
    common = (of_1 + of_2) / 2.0
    noise = left_over(u1, u2, common, common) if declared is None else np.full(common.shape, declared)
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


def _quadrant(u1: Floats, u2: Floats) -> Complex:
    """Phasor at the angle phi + f5, as long as the mean of both amplitudes."""
    of_1, of_2 = lock_in_phasors(u1, u2)
    apart = np.angle(of_1) - np.angle(of_2)
    big_1 = (u1[..., 0] - u1.mean(-1)) * np.abs(of_2)
    big_2 = (u2[..., 0] - u2.mean(-1)) * np.abs(of_1)
    towards = big_2 * np.cos(apart) + 1j * (big_1 - big_2 * np.sin(apart))
    length = np.abs(towards)
    mean = (np.abs(of_1) + np.abs(of_2)) / 2.0
    return np.where(length > 0.0, towards / np.where(length > 0.0, length, 1.0) * mean, 0.0)


def literal_north(u1: Floats, u2: Floats, f5_deg: float = 0.0) -> tuple[Floats, dict[str, Flags | Integers]]:
    """Return phase by (15) to (21) as printed, with U_LA1 = U11, U_LA2 = U21.

    Args:    u1, u2: oriented samples, (..., 4).   f5_deg: what (21) takes off at its end; the eight samples do not
             contain it, and the paper does not say where it comes from.
    Returns: phase (...), degrees, NaN where a formula gives none; failures of each set, (...), by name.
             half_turn: the north found is on the wrong half of the circle, as seen by the formulas with quadrants.
             flipped_17, flipped_18: terms of four on another branch than the angle itself, modulo a half turn.
             amplitude_19, amplitude_20: f1, f4 is nothing over nothing, or its size more than 10 % off.
             u2_zero: (21) divides by 0.
    Source:  see the head of this file.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        terms_17, terms_18 = _terms(u1, u2)
        x, y = terms_17.mean(0), terms_18.mean(0)
        f1 = ((u1[..., 0] - u1[..., 2]) / np.sin(x) + (u1[..., 1] - u1[..., 3]) / np.cos(x)) / 4.0
        f4 = ((u2[..., 0] - u2[..., 2]) / np.cos(y) - (u2[..., 1] - u2[..., 3]) / np.sin(y)) / 4.0
        big_1 = (u1[..., 0] - u1.mean(-1)) * f4
        big_2 = (u2[..., 0] - u2.mean(-1)) * f1
        angle = np.arctan((big_1 / big_2 - np.sin(x - y)) / np.cos(x - y))
    phi_deg = wrapped_deg(np.rad2deg(angle) - f5_deg)
    of_1, of_2 = lock_in_phasors(u1, u2)
    return phi_deg, {
        "half_turn": np.abs(wrapped_deg(phi_deg - angle_deg(_placed(u1, u2, f5_deg)))) > 90.0,
        "flipped_17": _flipped(terms_17, angle_deg(of_1)),
        "flipped_18": _flipped(terms_18, angle_deg(of_2)),
        "amplitude_19": _amplitude_failed(f1, np.abs(of_1), x),
        "amplitude_20": _amplitude_failed(f4, np.abs(of_2), y),
        "u2_zero": np.abs(u2[..., 0] - u2.mean(-1)) <= _NOTHING * np.abs(of_2),
    }


def _terms(u1: Floats, u2: Floats) -> tuple[Floats, Floats]:
    """Return the four signed terms of (17) and of (18), (4, ...) each, radian."""
    u11, u12, u13, u14 = np.moveaxis(u1 - u1.mean(-1, keepdims=True), -1, 0)
    u21, u22, u23, u24 = np.moveaxis(u2 - u2.mean(-1, keepdims=True), -1, 0)
    of_17 = (np.arctan(u11 / u12), -np.arctan(u11 / u14), np.arctan(u13 / u14), -np.arctan(u13 / u12))
    of_18 = (np.arctan(u24 / u21), -np.arctan(u22 / u21), np.arctan(u22 / u23), -np.arctan(u24 / u23))
    return np.array(of_17), np.array(of_18)


def _flipped(terms: Floats, angle_deg: Floats) -> Integers:
    """Terms that are further than a quarter turn from the angle as an arctan gives it, (...)."""
    branch_deg = np.rad2deg(np.arctan(np.tan(np.deg2rad(angle_deg))))
    return np.asarray((np.abs(np.rad2deg(terms) - branch_deg) > 90.0).sum(0))


def _amplitude_failed(amplitude: Floats, right: Floats, angle: Floats) -> Flags:
    nothing = np.minimum(np.abs(np.sin(angle)), np.abs(np.cos(angle))) <= _NOTHING
    return nothing | ~(np.abs(np.abs(amplitude) - right) <= _WRONG_AMPLITUDE * right)


def lock_in_noise(noise: float, rate_Hz: float, time_constant_s: float, poles: int, mean_s: float = 0.0) -> float:
    """Return the standard deviation of X that white noise of the input leaves.

    Args:    noise: standard deviation of one sample of the input.   rate_Hz: of the samples.
             time_constant_s, poles: of the equal RC filters.   mean_s: over which the synchronous filter takes the mean
             before them, 0 for none.
    Returns: in the unit of ``noise``, RMS as X is: a sine of amplitude a reads a / sqrt 2.
    Source:  equivalent noise bandwidth of equal poles, integral of (1 + x^2)^-n (5/(64 T) for four: SR830 manual,
             chapter 3), with the power response sinc^2 of a mean; the reference sqrt 2 sin has a mean square of one.
    """
    angle = np.linspace(0.0, np.pi / 2.0, _GRID)
    x = np.tan(angle)  # frequency over that of one pole: dx = (1 + x^2) d(angle)
    power = (1.0 + x**2) ** (1.0 - poles) * np.sinc(x * mean_s / (2.0 * np.pi * time_constant_s)) ** 2
    bandwidth_Hz = float(np.trapezoid(power, angle)) / (2.0 * np.pi * time_constant_s)
    return float(noise * np.sqrt(2.0 * bandwidth_Hz / rate_Hz))
