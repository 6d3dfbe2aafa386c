"""Angle of a dithered ring laser as its electronics have it, its random walk, and the alignment time that follows.

The angle is a count, latched where the dither angle is zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from bench.maths.allan import (
    AllanDeviation,
    allan_deviation,
    expected_curve,
)
from bench.maths.allan_terms import allan_variance_of, fit_noise_terms
from bench.maths.arrays import Floats, Integers
from bench.maths.samples import off_neighbours, scatter
from bench.model.errors import FitError
from bench.systems.lock_in.estimators.single_turnarounds import solve_rows
from bench.systems.lock_in.estimators.turnarounds import EdgeLevels, Jumps, Turnarounds, half_period_ticks

_ROUND = 4  # edges on each side of the pick-off's
_PLACES = 16  # of the pick-off between two edges
WAVELENGTH_m = 632.8e-9
EARTH_RATE_deg_h = 15.041067
_SHORTEST_PERIODS = 5
_LONGEST_SHARE = 20
_FEWEST_TIMES = 4
_PER_OCTAVE = 2
_BESIDE, _ODD_SCATTERS, _ODD_rad = 5, 12.0, 0.3
TERMS = ("quantisation_noise", "white_noise")


def net_angle(edges: EdgeLevels, pickoff_tick: Integers) -> Floats:
    """Phase at the edges of the pick-off: the latched count, and what the edges round it say of the rest of a turn.

    Two pieces of the dither's motion that meet at the pick-off's edge are put through the 4 edges before and the 4
    behind it: the amplitude may change there, and a straight line from edge to edge would then be off by up to 0.05
    rad. A comparator that switches beside zero moves even levels one way and odd ones the other: its part is fitted too
    and left out, for it would go round with the net phase, and with the earth's turn look like a walk. The quantisation
    of the ticks is in it: that of the pick-off's own time stamp, times the rate, is the most.

    Args:    edges: of the beat.   pickoff_tick: (n,), edges of the pick-off, rising and falling.
    Returns: (n,), rad; NaN where there are not enough edges, and at the first pick-off behind a break, for the step to
             it is not known.
    Raises:  FitError B-FIT-096 if the pick-off does not tell the dither's period.
    Source:  latched count with interpolation; the sign of the phase is that of ``EdgeLevels.direction``.
    """
    pickoff = np.asarray(pickoff_tick, np.int64)
    omega = np.pi / half_period_ticks(pickoff)
    first = np.searchsorted(edges.tick, pickoff, side="right") - _ROUND
    inside = (first >= 0) & (first + 2 * _ROUND <= edges.tick.size)
    index = np.where(inside, first, 0)[:, None] + np.arange(2 * _ROUND)
    index = np.minimum(index, edges.tick.size - 1)
    count = edges.level[index[:, _ROUND - 1]]
    design = _two_pieces(np.sin(omega * (edges.tick[index] - pickoff[:, None])) / omega)
    psi = np.full(pickoff.size, np.nan)
    turned = np.asarray(np.pi * (edges.level[index] - count[:, None]), np.float64)
    solved = solve_rows(design[inside], turned[inside])
    psi[inside] = np.pi * count[inside] + solved[:, 0]
    torn = np.searchsorted(pickoff, edges.tick[edges.breaks])
    psi[torn[torn < psi.size]] = np.nan
    return psi


def _two_pieces(motion: Floats) -> Floats:
    """Columns of the phase round the pick-off's edge, (..., 2 _ROUND, 4), by the dither's motion at the edges."""
    place = np.arange(2 * _ROUND)
    before, turn_about = place < _ROUND, np.broadcast_to(1.0 - 2.0 * (place % 2), motion.shape)
    return np.stack((np.ones_like(motion), motion * before, motion * ~before, turn_about), axis=-1)


def expected_quantisation_deg(dither_deg_s: float, tick_s: float, pickoff_s: float) -> float:
    """Quantisation Q of the angle at the pick-off's edges, each the mean of both senses.

    Args:    dither_deg_s: amplitude of the dither's rate.   tick_s: of the time stamps.   pickoff_s: standard deviation
             of the time at which the pick-off switches.
    Returns: degrees.
    Source:  variance of a tick, T^2 / 12, through the fit of ``net_angle``, at the rate of the zero of the angle.
    """
    places = np.arange(-_ROUND, _ROUND) + (np.arange(_PLACES)[:, None] + 0.5) / _PLACES  # edges by their distance
    weights = np.linalg.pinv(_two_pieces(places))[:, 0]
    share = 1.0 + float(np.mean(np.sum(weights**2, axis=1)))
    return float(dither_deg_s * np.sqrt((share * tick_s**2 / 12.0 + pickoff_s**2) / 2.0))


def odd_steps(psi_rad: Floats, pickoff_rising: ArrayLike, regular: ArrayLike) -> Integers:
    """Return half periods whose net phase is unlike that of their neighbours, as where the count lost a turn.

    A step of the phase from pick-off to pick-off is odd if it is off the median of five on either side by more than 12
    times their scatter (from the median), and by 0.3 rad at least. Lock-in alone never reaches 2 times.

    Args:    psi_rad: of ``net_angle``, (n + 1,).   pickoff_rising: (n + 1,).   regular: half periods that count, (n,).
    Returns: places, ascending.
    Source:  median absolute deviation; Huber, Robust Statistics, section 5.
    """
    upward, step = np.asarray(pickoff_rising, bool)[:-1], np.where(regular, np.diff(psi_rad), np.nan)
    known = np.flatnonzero(np.isfinite(step))
    if known.size <= 2 * _BESIDE:
        return known[:0]
    step, upward = step[known], upward[known]
    for sense in (upward, ~upward):  # a late pick-off adds to one sense what it takes off the other
        step[sense] -= np.median(step[sense]) if sense.any() else 0.0
    off = off_neighbours(step, _BESIDE)
    odd = known[off > max(_ODD_rad, _ODD_SCATTERS * float(scatter(off)))]
    return np.asarray(odd, np.int64)


def cycle_increments(
    psi_rad: Floats, pickoff_rising: ArrayLike, turns: Turnarounds, jumps: Jumps | None = None
) -> Floats:
    """Net phase of each dither period, less what a compensator says that lock-in added.

    Both senses of the pick-off are used: an error of its time stamp, times the rate, has the other sign in the other
    sense and drops out of the mean. One sense alone keeps the step of a tick each time the dither's period has slid by
    one against the clock: at 20 MHz, 28 cm and 0.1 ppm it makes a walk of 0.13 of that of lock-in.

    Args:    psi_rad: of ``net_angle``, (n + 1,).   pickoff_rising: (n + 1,).   turns: of the same pick-off.
             jumps: of a compensator; None leaves the lock-in errors in.
    Returns: mean of the period from rising to rising and the one from falling to falling zero, (c,), radian; NaN where
             a turnaround in it is not usable or events are lost.
    Source:  lock-in paper (9) and figure 11: the error is taken off at each turnaround.
    """
    upward = np.asarray(pickoff_rising, bool)
    start = np.flatnonzero(upward[:-3])
    step = np.where(turns.regular, np.diff(psi_rad), np.nan)
    if jumps is not None:
        step = step - jumps.dpsi_rad
    return np.asarray((step[start] + step[start + 2]) / 2.0 + step[start + 1])


@dataclass(frozen=True)
class RandomWalk:
    """Angle random walk N and quantisation Q, fitted jointly to an overlapping Allan deviation.

    N is that of the fit in which Q^2 may be negative, Q and the curve those of the one in which it may not: held at 0,
    a quantisation far below the walk would pull the walk down by 0.4 of its standard uncertainty on average.
    ``n_upper_deg_rth``: not exceeded with 95 % confidence; the standard uncertainties are NaN where a coefficient is
    0. ``deviation_deg_h`` with limits of 95 % and the fit, (k,), at ``tau_s``; ``dof``: of ``chi2``.
    """

    n_deg_rth: float
    n_std_deg_rth: float
    n_upper_deg_rth: float
    q_deg: float
    q_std_deg: float
    tau_s: Floats
    deviation_deg_h: Floats
    low_deg_h: Floats
    high_deg_h: Floats
    fitted_deg_h: Floats
    chi2: float
    dof: int


def gyro_gain(path_length_m: float) -> float:
    """Phase of the beat for a rotation of one radian, of a square ring, K = 8 pi A / (lambda L) = pi L / (2 lambda).

    Args:    path_length_m: perimeter.   Returns: rad/rad.
    Source:  Sagnac effect; helium-neon line 632.8 nm.
    """
    return float(np.pi * path_length_m / (2.0 * WAVELENGTH_m))


def walk_of_phase_deg_rth(walk_rad_rt_s: float, path_length_m: float) -> float:
    """Return the angle random walk, deg/rt-h, of a random walk of the phase.

    Args:    walk_rad_rt_s: of the phase, radian per root second.   path_length_m: perimeter.
    Source:  definition; ``gyro_gain``.
    """
    return float(60.0 * np.rad2deg(walk_rad_rt_s / gyro_gain(path_length_m)))


def random_walk(
    increment_rad: Floats, interval_s: float, path_length_m: float, terms: Sequence[str] = TERMS
) -> RandomWalk:
    """N and Q from the phase that each dither period adds, over averaging times of 5 periods to a 20th of the record.

    Short times tell Q from N: over ten records of 20 s the walk of the uncompensated gyroscope scattered by 1.5 %, and
    by 5 % with averaging times from 0.05 s on. A constant rate cancels in the deviation, so the earth's turn and a bias
    need not be known.

    Args:    increment_rad: (c,), of ``cycle_increments``; NaN is a gap.   interval_s: dither period.
             path_length_m: perimeter of the ring.   terms: of ``bench.maths.allan_terms``, these two or more.
    Raises:  FitError B-FIT-099 as ``output_deviation``.
    Source:  IEEE Std 952-1997 annex C, equations C.7 to C.17 (N, Q).
    """
    return _walk_of(output_deviation(increment_rad, interval_s, path_length_m, terms), terms)


def shared_variance(increment_rad: Floats, other_rad: Floats) -> float:
    """Return the squared correlation of two outputs of one record, which is the correlation of their Allan variances.

    Args:    increment_rad, other_rad: (c,), of ``cycle_increments`` of the same periods; NaN is a gap.
    Returns: of sums over a time midway between the averaging times, in which the quantisation that both have counts
             little; less what chance makes of independent outputs.
    Source:  Isserlis' theorem for Gaussian noise.
    """
    both = np.stack((increment_rad, other_rad))[:, np.isfinite(increment_rad) & np.isfinite(other_rad)]
    periods = max(_SHORTEST_PERIODS, round(math.sqrt(_SHORTEST_PERIODS * both.shape[1] / _LONGEST_SHARE)))
    count = both.shape[1] // periods
    if count < _FEWEST_TIMES:
        return 0.0
    sums = both[:, : count * periods].reshape(2, count, periods).sum(axis=2)
    square = float(np.corrcoef(sums)[0, 1] ** 2)
    return float(max(0.0, (square * count - 1.0) / (count - 1.0)))


def expected_walk(n_deg_rth: float, q_deg: float, periods: int, interval_s: float) -> RandomWalk:
    """Return what ``random_walk`` finds on average in an output of this random walk and quantisation.

    Args:    n_deg_rth, q_deg: of the output.   periods: of the dither, in one stretch.   interval_s: dither period.
    Raises:  FitError B-FIT-099 as ``output_deviation``.
    Source:  as ``random_walk``, on the deviation that both terms give; degrees of freedom as ``allan_deviation``.
    """
    factors = np.array(_factors(periods, interval_s))
    tau_s = factors * interval_s
    n_deg_h, q_deg_h_s = 60.0 * n_deg_rth, 3600.0 * q_deg
    sizes = dict(zip(TERMS, (q_deg_h_s, n_deg_h), strict=True))
    deviation = np.sqrt(np.sum([size**2 * allan_variance_of(name, tau_s) for name, size in sizes.items()], axis=0))
    return _walk_of(expected_curve(interval_s, periods, factors, deviation), TERMS)


def _walk_of(curve: AllanDeviation, terms: Sequence[str]) -> RandomWalk:
    fit = fit_noise_terms(curve, terms)
    walk, quantum = fit["white_noise"], fit["quantisation_noise"]
    # Rivals beside the two would make the free one scatter too much to be held against this one.
    known = len(terms) == len(TERMS) and math.isfinite(walk.free_std)
    return RandomWalk(
        n_deg_rth=(walk.free_coefficient if known else walk.coefficient) / 60.0,  # deg/h times the root of a second
        n_std_deg_rth=walk.free_std / 60.0,
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


def output_deviation(
    increment_rad: Floats, interval_s: float, path_length_m: float, terms: Sequence[str] = TERMS
) -> AllanDeviation:
    """Return the overlapping Allan deviation of an output, deg/h, as ``random_walk`` takes it.

    Args:    as there.
    Raises:  FitError B-FIT-099 for a record too short for four averaging times, 0.6 s at 400 Hz.
    """
    factors = _factors(increment_rad.size, interval_s)
    rate = np.rad2deg(increment_rad / gyro_gain(path_length_m)) * 3600.0 / interval_s
    measured = allan_deviation(rate, interval_s, factors=factors)
    return _sharpened(measured, fit_noise_terms(measured, terms)["white_noise"].coefficient)


def _factors(periods: int, interval_s: float) -> list[int]:
    """Return averaging times in dither periods. Raises: as ``output_deviation``."""
    first, last = _SHORTEST_PERIODS, periods // _LONGEST_SHARE
    octaves = np.log2(last / first) if last > first else 0.0
    factors = np.unique(np.rint(first * 2.0 ** np.linspace(0.0, octaves, 1 + max(0, round(_PER_OCTAVE * octaves)))))
    if factors.size < _FEWEST_TIMES:
        raise FitError(
            "B-FIT-099",
            f"{periods} dither periods of {interval_s:.6f} s leave {factors.size} averaging times for a "
            f"random walk, at least {_FEWEST_TIMES} are due",
            next_step="record at least 1 s without lost events; 20 s give the random walk to 2 %",
        )
    return [int(factor) for factor in factors]


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


def path_exponent(path_length_m: Floats, n_deg_rth: Floats, std_deg_rth: Floats) -> tuple[float, float]:
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
