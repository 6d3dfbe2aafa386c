"""Angle random walk and quantisation of a ring laser, what theory expects, and the alignment time that follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.maths.allan import AllanDeviation, allan_deviation
from bench.maths.allan_terms import fit_noise_terms
from bench.model.errors import FitError

Array = NDArray[np.float64]

WAVELENGTH_m = 632.8e-9
EARTH_RATE_deg_h = 15.041067
_SHORTEST_PERIODS = 5
_LONGEST_SHARE = 20
_FEWEST_TIMES = 4
_PER_OCTAVE = 2
_TERMS = ("quantisation_noise", "white_noise")


@dataclass(frozen=True)
class RandomWalk:
    """Angle random walk N and quantisation Q, fitted jointly to an overlapping Allan deviation.

    ``n_upper_deg_rth``: not exceeded with 95 % confidence; the standard uncertainties are NaN where a coefficient is
    0. ``deviation_deg_h`` with limits of 95 % and the fit, (k,), at ``tau_s``; ``dof``: of ``chi2``.
    """

    n_deg_rth: float
    n_std_deg_rth: float
    n_upper_deg_rth: float
    q_deg: float
    q_std_deg: float
    tau_s: Array
    deviation_deg_h: Array
    low_deg_h: Array
    high_deg_h: Array
    fitted_deg_h: Array
    chi2: float
    dof: int


def gyro_gain(path_length_m: float) -> float:
    """Phase of the beat for a rotation of one radian, of a square ring, K = 8 pi A / (lambda L) = pi L / (2 lambda).

    Args:    path_length_m: perimeter.   Returns: rad/rad.
    Source:  Sagnac effect; helium-neon line 632.8 nm.
    """
    return float(np.pi * path_length_m / (2.0 * WAVELENGTH_m))


def lock_in_rate_deg_s(kappa_rad_s: float, path_length_m: float) -> float:
    """Lock-in rate W_L = kappa / K, degree per second.

    Args:    kappa_rad_s: of ``GlobalConstants``.   path_length_m: perimeter.
    Source:  lock-in paper equation (10).
    """
    return float(np.rad2deg(kappa_rad_s / gyro_gain(path_length_m)))


def random_walk(increment_rad: Array, interval_s: float, path_length_m: float) -> RandomWalk:
    """N and Q from the phase that each dither period adds, over averaging times of 5 periods to a 20th of the record.

    Short times tell Q from N: over ten records of 20 s the walk of the uncompensated gyroscope scattered by 1.5 %, and
    by 5 % with averaging times from 0.05 s on. A constant rate cancels in the deviation, so the earth's turn and a bias
    need not be known.

    Args:    increment_rad: (c,), of ``cycle_increments``; NaN is a gap.   interval_s: dither period.
             path_length_m: perimeter of the ring.
    Returns: RandomWalk.
    Raises:  FitError B-FIT-099 for a record too short for four averaging times, 0.6 s at 400 Hz.
    Source:  IEEE Std 952-1997 annex C, equations C.7 to C.17 (N, Q).
    """
    first, last = _SHORTEST_PERIODS, increment_rad.size // _LONGEST_SHARE
    octaves = np.log2(last / first) if last > first else 0.0
    factors = np.unique(np.rint(first * 2.0 ** np.linspace(0.0, octaves, 1 + max(0, round(_PER_OCTAVE * octaves)))))
    if factors.size < _FEWEST_TIMES:
        raise FitError(
            "B-FIT-099",
            f"{increment_rad.size} dither periods of {interval_s:.6f} s leave {factors.size} averaging times for a "
            f"random walk, at least {_FEWEST_TIMES} are due",
            next_step="record at least 1 s without lost events; 20 s give the random walk to 2 %",
        )
    rate = np.rad2deg(increment_rad / gyro_gain(path_length_m)) * 3600.0 / interval_s
    measured = allan_deviation(rate, interval_s, factors=factors.astype(int).tolist())
    curve = _sharpened(measured, fit_noise_terms(measured, _TERMS)["white_noise"].coefficient)
    fit = fit_noise_terms(curve, _TERMS)
    walk, quantum = fit["white_noise"], fit["quantisation_noise"]
    return RandomWalk(
        n_deg_rth=walk.coefficient / 60.0,  # deg/h times the root of a second
        n_std_deg_rth=walk.std_uncertainty / 60.0,
        n_upper_deg_rth=walk.upper_limit / 60.0,
        q_deg=quantum.coefficient / 3600.0,
        q_std_deg=quantum.std_uncertainty / 3600.0,
        tau_s=curve.tau_s,
        deviation_deg_h=curve.deviation,
        low_deg_h=curve.low,
        high_deg_h=curve.high,
        fitted_deg_h=fit.fitted,
        chi2=fit.chi2,
        dof=fit.dof,
    )


def _sharpened(curve: AllanDeviation, walk: float) -> AllanDeviation:
    """Deviation without the smoothing that the mean of both senses of the pick-off brings to a random walk.

    The mean takes N^2 T / 8, T the dither period, off Q^2, which a fit that knows no negative square cannot say.
    """
    taken = 3.0 * walk**2 * curve.interval_s / (8.0 * curve.tau_s**2)
    gain = np.sqrt(1.0 + taken / np.square(curve.deviation))
    return replace(curve, deviation=curve.deviation * gain, low=curve.low * gain, high=curve.high * gain)


def expected_random_walk(lock_in_rate_deg_s: float, dither_deg_s: float, path_length_m: float) -> float:
    """Angle random walk that lock-in makes of a dither with enough scatter, N = W_L / sqrt(K W_D), deg/rt-h.

    Args:    lock_in_rate_deg_s: W_L.   dither_deg_s: amplitude W_D of the dither's rate.   path_length_m: perimeter.
    Source:  lock-in paper equation (6).
    """
    walk = np.deg2rad(lock_in_rate_deg_s) / np.sqrt(gyro_gain(path_length_m) * np.deg2rad(dither_deg_s))
    return float(np.rad2deg(walk) * 60.0)


def alignment_time_s(n_deg_rth: float, latitude_deg: float, error_deg: float) -> float:
    """Time until the heading of a gyrocompass is known to a standard deviation, T = (N / (W_e cos lat psi))^2, second.

    Args:    n_deg_rth: angle random walk.   latitude_deg: of the site.   error_deg: allowed heading error.
    Source:  lock-in paper equation (2).
    """
    level = EARTH_RATE_deg_h * np.cos(np.deg2rad(latitude_deg)) * np.deg2rad(error_deg)
    return float(3600.0 * (n_deg_rth / level) ** 2)


def path_exponent(path_length_m: Array, n_deg_rth: Array, std_deg_rth: Array) -> tuple[float, float]:
    """Power of the path length that the random walk follows, and its standard uncertainty.

    Args:    path_length_m, n_deg_rth, std_deg_rth: (k,), at least two different path lengths.
    Raises:  FitError B-FIT-100 if they are all the same, or a random walk is 0 or not known.
    Source:  weighted straight line through the logarithms; lock-in paper (6) expects -2.5.
    """
    length, walk, std = (np.asarray(column, np.float64) for column in (path_length_m, n_deg_rth, std_deg_rth))
    known = bool((np.isfinite(std) & (walk > 0.0) & (std > 0.0)).all())
    if not known or np.unique(length).size < 2:
        raise FitError(
            "B-FIT-100",
            f"{np.unique(length).size} path lengths and {int((walk > 0.0).sum())} random walks of {walk.size} that are "
            "known do not tell how the random walk goes with the path length",
            next_step="record at least two path lengths, each 20 s",
        )
    weight = np.square(walk / std)
    x, y = np.log(length), np.log(walk)
    centred = x - np.average(x, weights=weight)
    spread = float((weight * centred**2).sum())
    return float((weight * centred * y).sum() / spread), float(1.0 / np.sqrt(spread))
