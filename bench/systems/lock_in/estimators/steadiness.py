"""Whether the output of a gyroscope is a random walk all along: no wander of the rate, no line, no change of its size.

A random walk's increments are white, so in a cosine transform each coefficient is independent of all others and of the
same variance; quantisation adds to the high frequencies alone.

Bias instability of an output and the alignment error that it leaves, however long the alignment takes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft

from bench.maths.allan import AllanDeviation
from bench.maths.allan_terms import NoiseTerm, fit_noise_terms
from bench.maths.arrays import Flags, Floats
from bench.maths.tests import f_tail, of_many
from bench.systems.lock_in.estimators.random_walk import TERMS, EARTH_RATE_deg_h

_SLOWEST = 6  # coefficients of the cosine transform, three cycles of the record: below what the Allan deviation sees
_BAND = 10  # part of all coefficients that random walk fills alone
_ROUND = 50  # coefficients on each side of one, that it is held against
_HARMONICS = 3  # of the rounding error, whose powers fall with the square of their number
_BESIDE = 4  # pairs, by which the frequency of the dither is not known better
_FEWEST = 200  # increments
_PERIODS = 5  # in a sum, the shortest averaging time of the Allan deviation
_BIAS = "bias_instability"


@dataclass(frozen=True)
class Unsteady:
    """``probability``: of increments at least as odd if they are a random walk and quantisation.   ``figure``: how odd.

    ``left``: the increments without what is odd, as long as before.
    """

    probability: float
    figure: float
    left: Floats


def wander(increment: Floats) -> Unsteady:
    """Return whether the rate drifts or wanders slowly: a ramp, a step, a bias that is not stable.

    Args:    increment: of successive periods, (c,), NaN in gaps; at least 200 are known.
    Returns: Unsteady; ``figure``: power of the six slowest coefficients over that of the band above.
    Source:  F-test of independent normal coefficients of the discrete cosine transform.
    """
    known, wave = _waves(increment)
    slow, band = wave[1 : 1 + _SLOWEST], wave[1 + _SLOWEST : max(wave.size // _BAND, 5 * _SLOWEST)]
    ratio = float(np.mean(slow**2) / np.mean(band**2))
    wave[1 + _SLOWEST :] = 0.0
    return Unsteady(f_tail(ratio, _SLOWEST, band.size), ratio, _without(increment, known, wave))


def line(increment: Floats, ticks: float = 0.0) -> Unsteady:
    """Return whether the rate swings at one frequency, as on a base that vibrates.

    Where a dither of steady frequency beats with the ticks of the clock, the rounding of the time stamps makes lines of
    its own: quantisation, known beforehand, and not looked at.

    Args:    increment: as of ``wander``.   ticks: of the clock in a period of the dither; 0 if they are not known.
    Returns: Unsteady; ``figure``: power of the strongest pair of coefficients over that of those round it.
    Source:  F-test against the neighbourhood; Bonferroni over all frequencies; the rounding error of a phase that
             advances steadily is periodic with its fraction of a tick (Widrow and Kollar, Quantization Noise, 2008).
    """
    known, wave = _waves(increment)
    power = wave[1:-1:2][: (wave.size - 1) // 2] ** 2 + wave[2::2][: (wave.size - 1) // 2] ** 2
    total = np.concatenate(([0.0], np.cumsum(power)))
    at = np.arange(power.size)
    low, high = np.maximum(at - _ROUND // 2, 0), np.minimum(at + _ROUND // 2 + 1, power.size)
    near = (total[high] - total[low] - power) / (high - low - 1)
    odds = f_tail(power / near, 2, 2 * (high - low - 1))
    odds[_beats(ticks, power.size)] = 1.0
    strongest = int(np.argmin(odds))
    kept = slice(max(2 * strongest - 1, 1), 2 * strongest + 5)  # a frequency between two leaks into both
    only = np.zeros_like(wave)
    only[kept] = wave[kept]
    probability = of_many(float(odds[strongest]), power.size)
    return Unsteady(probability, float(power[strongest] / near[strongest]), _without(increment, known, only))


def change(increment: Floats) -> tuple[float, float]:
    """Return the probability of halves at least as unlike in size, and the scatter of the second over the first.

    Args:    increment: as of ``wander``.
    Source:  F-test of two variances, of sums over five periods, which quantisation does not fill.
    """
    halves = []
    for half in np.array_split(increment[np.isfinite(increment)], 2):
        sums = half[: half.size // _PERIODS * _PERIODS].reshape(-1, _PERIODS).sum(axis=1)
        halves.append(np.diff(sums)[::2])  # a rate that changes slowly is in none of them
    ratio = float(np.mean(halves[1] ** 2) / np.mean(halves[0] ** 2))
    tails = f_tail(ratio, halves[1].size, halves[0].size), f_tail(1.0 / ratio, halves[0].size, halves[1].size)
    return of_many(min(tails), 2), float(np.sqrt(ratio))


def enough(increment: Floats) -> bool:
    """Return whether there are increments enough to say anything.

    Source: none; bookkeeping.
    """
    return int(np.isfinite(increment).sum()) >= _FEWEST


def _beats(ticks: float, size: int) -> Flags:
    """Return the pairs of coefficients next to a beat of dither and clock, (size,)."""
    beat = np.mod(ticks * np.arange(1, _HARMONICS + 1), 1.0)
    place = 2.0 * size * np.minimum(beat, 1.0 - beat)
    near: Flags = np.abs(np.arange(size)[:, None] - place).min(axis=1) <= _BESIDE
    return near if ticks else np.zeros(size, np.bool_)


def _waves(increment: Floats) -> tuple[Flags, Floats]:
    known = np.isfinite(increment)
    return known, np.asarray(fft.dct(increment[known] - increment[known].mean(), norm="ortho"))


def _without(increment: Floats, known: Flags, wave: Floats) -> Floats:
    left = increment.copy()
    left[known] -= fft.idct(wave, norm="ortho")
    return left


def bias_instability(output: AllanDeviation) -> NoiseTerm:
    """Fit B beside random walk and quantisation to the Allan deviation of an output, deg/h.

    Raises: FitError of ``fit_noise_terms``.
    Source: IEEE Std 952-1997 annex C, equation C.13.
    """
    return fit_noise_terms(output, (*TERMS, _BIAS))[_BIAS]


def bias_alignment_error_deg(bias_deg_h: float, latitude_deg: float) -> float:
    """Return the heading error of a gyrocompass by a bias of its gyroscopes, psi = B / (W_e cos lat), degree.

    Args:    bias_deg_h: bias stability, for which the bias instability is taken.   latitude_deg: of the site.
    Source:  lock-in paper equation (1): it does not fall with the time of the alignment.
    """
    return math.degrees(bias_deg_h / (EARTH_RATE_deg_h * math.cos(math.radians(latitude_deg))))
