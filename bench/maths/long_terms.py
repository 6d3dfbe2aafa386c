"""Long-term noise of a log at rest: which terms are there, decided together, and what the mean of a log is worth.

Samples are averaged in some hundred blocks, whose means are Gaussian with the covariance of white noise, flicker noise,
a random walk and a drift, each known up to its size. A term is there if the likelihood with it exceeds that without it
by more than it does by chance in one of a hundred logs of the model *without* it, all terms that are asked for at once;
chance is simulated. Of terms that explain a log about equally well none is named: all of them are possible.

What a mean of the log, and a further one, are worth is averaged over the sizes of all terms, weighted with their
likelihood: a log seldom shows how large a random walk is, and never that there is none.

Source: restricted likelihood of a mean that is not known (Patterson and Thompson, Biometrika 58 (1971) 545);
generalised covariances of the angle as in ``allan_terms``; tests of a variance at its boundary by simulation (Self and
Liang, J. Am. Stat. Assoc. 82 (1987) 605).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from bench.maths.allan import AllanDeviation, allan_deviation
from bench.maths.allan_terms import FILTERING, TERMS, NoiseTerm, NoiseTerms, angle_covariance_of, fit_noise_terms
from bench.maths.arrays import Floats, Integers
from bench.maths.tests import chi2_tail

LONG_TERMS = ("bias_instability", "random_walk", "rate_ramp")
_SHORT = ("quantisation_noise", "white_noise")
_GAIN = 5.412  # chi squared that a term at its boundary 0 gains by chance in 1 % of all logs
_MISFIT, _FEWEST_DOF = 1e-4, 100.0  # chance of a worse fit; of averages that show that samples are filtered
_FILTERED_MISFIT = 0.01  # twice in a row: at shorter times filtered samples are not yet like those that are averaged
_SEED = 20100101  # of the null of long terms: the same log, the same terms
FALSE_TERM, WRONG_NAME = 0.01, 0.004  # of logs without a long term; of those with another one
_BLOCKS = 200  # of the whole time; halved in length until half as many hold samples
_FEWEST_BLOCKS = 12
_FEWEST_SAMPLES = 4  # in a block
_APART = 20  # times as long as filtered samples hang together is a block: neighbours then correlate by 0.035 at most
_POOR = 0.25  # of the usual number of samples of a block
_AHEAD = 40  # parts of a further mean
_DRAWS = 2000
_RATIOS = np.concatenate(([0.0], np.geomspace(0.03, 3e6, 56)))  # long-term over white variance of the mean of the log
# Sizes over which a mean is averaged, and how their weights before the log is seen rise with the size: with these it
# lies in its interval in 92 to 100 % of logs of each kind and size, those among them with terms that are just too small
# to be seen. A walk is the worst of the three for a further mean and looks like a drift or flicker as long as it is
# weak: its larger sizes weigh more (test_long_terms holds a size or two of each kind).
_SIZES = np.concatenate(([0.0], np.geomspace(1.0, 3e6, 45)))
_RISE = {"bias_instability": 0.25, "random_walk": 0.7, "rate_ramp": 0.25}
_WEIGHTS = {name: np.concatenate(([0.36], _SIZES[1:] ** rise)) for name, rise in _RISE.items()}
_WEIGHTS["bias_instability"] *= 3.0
_PROBABILITIES = (0.6826894921370859, 0.95)


class Blocks(NamedTuple):
    """``time_s`` (m,): mean times of the samples of a block.   ``mean`` (m,).   ``samples`` (m,).   ``span_s``: of a
    block.
    """

    time_s: Floats
    mean: Floats
    samples: Integers
    span_s: float


@dataclass(frozen=True)
class LongTerms:
    """What a log shows of its long terms.

    Attributes:
        present: names of ``LONG_TERMS`` that are there.   possible: of which one or more is there, but not to be told
            which; empty or at least two.
        std, expanded: of the mean of the log as that of the sensor: half-widths of its 68.3 % and 95 % intervals, unit
            of the samples.   A further mean of the same length right behind the log lies within sqrt(2) times that.
        oddness: probability of a block that is so far off, or a cycle so strong, if these terms are all there is.
        odd_s: time of that block, or period of that cycle; ``cycle``: which of them.
    """

    present: tuple[str, ...]
    possible: tuple[str, ...]
    std: float
    expanded: float
    oddness: float
    odd_s: float
    cycle: bool


@dataclass(frozen=True)
class NoiseAtRest:
    """Noise of a sensor at rest: its long terms by the means, how large each term is by the Allan deviation.

    ``terms``: of the fit, with all that are possible; those that are there in ``stated``.   ``absent``: of all terms,
    for what may be there unseen.   ``white_from_s``: averaging time from which the noise is that of the terms: samples
    that were filtered, or made from fewer, scatter less than any term at short times.   ``chance``: of averages that
    fit the terms no better.
    """

    deviation: AllanDeviation
    terms: NoiseTerms
    absent: tuple[NoiseTerm, ...]
    long: LongTerms
    white_from_s: float
    chance: float

    @property
    def stated(self) -> list[NoiseTerm]:
        """Return the terms that are there."""
        known = (term for term in self.terms.terms if term.coefficient > 0.0 and term.name in TERMS)
        known = (term for term in known if term.name not in self.long.possible)
        return [term for term in known if term.name in LONG_TERMS or term.gain > _GAIN]

    @property
    def fitted(self) -> tuple[Floats, Floats]:
        """Return averaging times and the deviation of the terms."""
        return self.deviation.tau_s[-self.terms.fitted.size :], self.terms.fitted


def noise_at_rest(samples: Floats, interval_s: float) -> NoiseAtRest:
    """Return the noise of a sensor from its samples at even times, (n,), NaN where one is missing.

    Raises: FitError B-FIT-030, -031 if there are too few, or none that differ.
    """
    known = np.isfinite(samples)
    deviation = allan_deviation(samples, interval_s)
    whole = len(deviation.tau_s) > len(TERMS) + 1
    if not whole:  # rows are missing everywhere: by the count of samples, white noise is what it was
        deviation = allan_deviation(samples[known], interval_s)
    fewest = _FEWEST_SAMPLES
    while True:
        blocks = blocks_of(np.flatnonzero(known), samples[known], interval_s, fewest)
        long = long_terms(blocks, int(known.sum()) * interval_s, np.random.default_rng(_SEED))
        terms, first, chance = _terms(deviation, (*long.present, *long.possible) if whole else ())
        if not first or _APART * deviation.factors[first] <= fewest or _APART * deviation.tau_s[first] <= blocks.span_s:
            break
        fewest = _APART * int(deviation.factors[first])
    absent = fit_noise_terms(deviation).terms if whole and not first else ()
    return NoiseAtRest(deviation, terms, absent, long, float(deviation.tau_s[first]), chance)


def _terms(deviation: AllanDeviation, long: Sequence[str]) -> tuple[NoiseTerms, int, float]:
    """Return the fit of the terms that are there, the first averaging time that it describes, its chance.

    Where no times are described the chance says so.
    """
    fits, well = [], False
    for first in range(len(deviation.tau_s)):
        curve_left = deviation.behind(first)
        if first and (len(curve_left.tau_s) < len(_SHORT) + len(long) + 1 or curve_left.dof[0] < _FEWEST_DOF):
            break
        fit = _with_short_terms(curve_left, long, bool(first))
        fits.append((fit, first, float(chi2_tail(fit.chi2, fit.dof))))
        if fits[-1][2] > _MISFIT and (well or all(term.name != FILTERING for term in fit.terms)):
            return fits[-1]
        well = fits[-1][2] > _FILTERED_MISFIT
    best = max(fits, key=lambda fit: fit[2])
    return best if best[2] > _MISFIT else fits[0]


def _with_short_terms(curve: AllanDeviation, long: Sequence[str], filtered: bool) -> NoiseTerms:
    """Return the fit of white noise and long terms, and of what is to be seen beside them at short times.

    ``filtered``: whether the samples are known to hang together; what that takes away must not lower the white noise,
    nor make it sound better known where scatter hides it.
    """
    for short in (_SHORT[0], FILTERING):
        fit = fit_noise_terms(curve, (short, _SHORT[1], *long))
        if fit[short].gain > _GAIN:
            return fit
    if not filtered:
        return fit_noise_terms(curve, (_SHORT[1], *long))
    white = fit[_SHORT[1]]
    free = replace(white, coefficient=white.free_coefficient, std_uncertainty=white.free_std)
    return replace(fit, terms=tuple(free if term is white else term for term in fit.terms))


def blocks_of(counter: Integers, values: Floats, interval_s: float, fewest: int = _FEWEST_SAMPLES) -> Blocks:
    """Return means of a log over equal parts of its time; those with few samples are left out.

    Args:    counter: (n,), rising: places of the samples in time.   values: (n,).   interval_s: of one sample.
        fewest: samples of a part.
    """
    length = int(counter[-1] - counter[0]) + 1
    span = max(fewest, math.ceil(length / _BLOCKS))
    while True:
        place = (counter - counter[0]) // span
        block, samples = np.unique(place, return_counts=True)
        if block.size >= _BLOCKS // 2 or span < 2 * fewest:
            break
        span //= 2
    index = np.searchsorted(block, place)
    mean = np.bincount(index, values) / samples
    time_s = np.bincount(index, counter - counter[0]) / samples * interval_s
    kept = samples >= _POOR * np.median(samples)
    return Blocks(time_s[kept], mean[kept], samples[kept], span * interval_s)


def long_terms(blocks: Blocks, length_s: float, rng: np.random.Generator) -> LongTerms:
    """Return which long terms the means of a log show, and what its mean is worth.

    Args:    blocks: of the log.   length_s: of its samples together, and of a further mean.   rng: for the null.
    Returns: LongTerms; fewer than 12 blocks show none, and nothing of them is excluded.
    """
    log = _Log.of(blocks, length_s)
    names: list[str] = []
    ratios: list[float] = []
    alike: list[str] = []
    while len(blocks.mean) >= _FEWEST_BLOCKS and len(alike) < 2 and len(names) < len(LONG_TERMS):
        stage = _Stage.of(log, names, ratios)
        alike = stage.shown(rng)
        if not alike:
            break
        names.append(alike[0])
        ratios = log.fitted(names, [*ratios, stage.best_ratio(alike[0])])
    present = names[:-1] if len(alike) > 1 else names
    oddness, odd_s, cycle = _oddest(log, names, ratios, blocks)
    return LongTerms(
        tuple(name for name in LONG_TERMS if name in present),
        tuple(name for name in LONG_TERMS if len(alike) > 1 and name in alike),
        *_worth(log, names, ratios),
        oddness,
        odd_s,
        cycle,
    )


def _oddest(log: _Log, names: Sequence[str], ratios: Sequence[float], blocks: Blocks) -> tuple[float, float, bool]:
    """Return the probability of the oddest step, single block or cycle under a model; its time or period; if a cycle.

    Source: largest of many normal values; Fisher's test of a periodogram (Proc. R. Soc. Lond. A 125 (1929) 54).
    """
    factor = np.linalg.cholesky(log.total(names, ratios))
    means = np.linalg.solve(factor, log.means)
    count = blocks.mean.size
    shapes = np.linalg.solve(factor, log.white_means(np.hstack([np.tri(count)[:, 1:], np.eye(count)])))
    scores = np.abs(means @ shapes) / np.linalg.norm(shapes, axis=0) / math.sqrt(float(means @ means) / means.size)
    worst = int(np.argmax(scores))
    alone = min(1.0, scores.size * math.erfc(float(scores[worst]) / math.sqrt(2.0)))
    power = np.square(np.abs(np.fft.rfft(means)))[1 : (means.size + 1) // 2]
    peak = int(np.argmax(power))
    regular = min(1.0, power.size * (1.0 - float(power[peak] / power.sum())) ** (power.size - 1))
    if alone <= regular:
        return alone, float(blocks.time_s[worst + 1 if worst < count - 1 else worst - count + 1]), False
    return regular, float(blocks.time_s[-1] - blocks.time_s[0]) / (peak + 1), True


def _of_means(name: str, lag_s: Floats, span_s: float) -> Floats:
    """Return generalised covariance of means over ``span_s`` of a unit coefficient, by what lies between their begins.

    The drift is no noise and is left to its own column.
    """

    here, behind, ahead = (angle_covariance_of(name, lag_s + shift_s) for shift_s in (0.0, span_s, -span_s))
    return np.asarray((2.0 * here - behind - ahead) / span_s**2)


@dataclass(frozen=True)
class _Log:
    """``means``: (m - 1,), of the blocks, white where only white noise is there, their mean taken out
    by ``basis`` (m, m - 1).
    ``shapes``: covariance of each term in them, where its part of the variance of a further mean is as large as that of
    white noise of unit size; ``toward`` (m - 1,): that with a further mean minus that of the log.   ``white``: variance
    of this difference, of that noise.
    """

    means: Floats
    shapes: dict[str, Floats]
    toward: dict[str, Floats]
    white: float
    basis: Floats

    def white_means(self, of_blocks: Floats) -> Floats:
        """Return what columns (m, k) of the blocks are among the white means, (m - 1, k)."""
        return self.basis.T @ of_blocks

    @classmethod
    def of(cls, blocks: Blocks, length_s: float) -> _Log:
        root = np.sqrt(blocks.samples)
        total = int(blocks.samples.sum())
        basis = root[:, None] * np.linalg.qr(np.column_stack([root, np.eye(root.size)[:, 1:]]))[0][:, 1:]
        part_s = length_s / _AHEAD
        ahead_s = blocks.time_s[-1] + 0.5 * blocks.span_s + part_s * (np.arange(_AHEAD) + 0.5)
        contrast = np.concatenate((-blocks.samples / total, np.full(_AHEAD, 1.0 / _AHEAD)))
        white = 2.0 / total
        time_s = np.concatenate((blocks.time_s, ahead_s))
        shapes, toward = {}, {}
        for name in LONG_TERMS:
            if name == "rate_ramp":
                scaled = (basis.T @ (blocks.time_s - blocks.time_s.mean()))[:, None]
                own, further = scaled @ scaled.T, float(contrast @ time_s) ** 2
                ahead = scaled[:, 0] * float(contrast @ time_s)
            else:
                lag_s = time_s[:, None] - time_s
                covariance = _of_means(name, lag_s, blocks.span_s)
                inside = covariance[: root.size, : root.size]
                own, ahead = basis.T @ inside @ basis, basis.T @ (covariance @ contrast)[: root.size]
                further = float(contrast @ covariance @ contrast)
            shapes[name], toward[name] = own * (white / further), ahead * (white / further)
        return cls(basis.T @ blocks.mean, shapes, toward, white, basis)

    def total(self, names: Sequence[str], ratios: Sequence[float]) -> Floats:
        """Return the covariance of the means by white noise of unit size and terms of these sizes."""
        covariance = np.eye(self.means.size)
        for name, ratio in zip(names, ratios, strict=True):
            covariance += ratio * self.shapes[name]
        return covariance

    def fitted(self, names: Sequence[str], ratios: Sequence[float]) -> list[float]:
        """Return the most likely sizes of terms that are there."""

        def cost(logarithms: Floats) -> float:
            factor = np.linalg.cholesky(self.total(names, np.exp(logarithms).tolist()))
            left = np.linalg.solve(factor, self.means)
            return float(left.size * np.log(left @ left) + 2.0 * np.log(np.diagonal(factor)).sum())

        if len(names) == 1:
            return list(ratios)
        start = np.log(np.maximum(ratios, _RATIOS[1]))
        bounds = [(math.log(_RATIOS[1]) - 2.0, math.log(_RATIOS[-1]) + 2.0)] * len(names)
        return [float(size) for size in np.exp(optimize.minimize(cost, start, method="L-BFGS-B", bounds=bounds).x)]


@dataclass(frozen=True)
class _Stage:
    """A log under a model, in which its means are white, and the covariances of further terms.

    ``values``, ``axes``: eigenvalues (m,) and eigenvectors (m, m) of each further term.   ``factor``: of the model.
    """

    means: Floats
    values: dict[str, Floats]
    axes: dict[str, Floats]
    factor: Floats

    def in_axes(self, name: str, covariance: Floats) -> Floats:
        """Return covariances with the white means of the log (m,) as those with these, along the axes of a term."""
        return np.asarray(np.linalg.solve(self.factor, covariance) @ self.axes[name])

    @classmethod
    def of(cls, log: _Log, names: Sequence[str], ratios: Sequence[float]) -> _Stage:
        factor = np.linalg.cholesky(log.total(names, ratios))
        values, axes = {}, {}
        for name in LONG_TERMS:
            if name not in names:
                half = np.linalg.solve(factor, log.shapes[name])
                value, axes[name] = np.linalg.eigh(np.linalg.solve(factor, half.T))
                values[name] = np.maximum(value, 0.0)
        return cls(np.linalg.solve(factor, log.means), values, axes, np.asarray(factor))

    def likelihoods(self, name: str, means: Floats, ratios: Floats = _RATIOS) -> Floats:
        """Return log-likelihood ratios by size of a further term over none, (..., r), of means (..., m)."""
        scale = 1.0 + ratios[:, None] * self.values[name]
        power = np.square(means @ self.axes[name]) @ (1.0 / scale).T
        cost = means.shape[-1] * np.log(power) + np.log(scale).sum(axis=1)
        return np.asarray(0.5 * (cost[..., :1] - cost))

    def best_ratio(self, name: str) -> float:
        """Return the most likely size of a further term."""
        return float(_RATIOS[int(np.argmax(self.likelihoods(name, self.means)))])

    def shown(self, rng: np.random.Generator) -> list[str]:
        """Return the further term that is there, and behind it those that explain the log about equally well."""
        names = list(self.values)
        by_chance = rng.standard_normal((_DRAWS, self.means.size))
        gains = {name: float(self.likelihoods(name, self.means).max()) for name in names}
        null = {name: np.sort(self.likelihoods(name, by_chance).max(axis=1)) for name in names}
        chances = {name: _above(null[name], gains[name]) for name in names}
        ranks = np.stack([_above(null[name], self.likelihoods(name, by_chance).max(axis=1)) for name in names])
        if float(np.mean(ranks.min(axis=0) <= min(chances.values()))) > FALSE_TERM:
            return []
        best = max(names, key=gains.__getitem__)
        return [best, *(name for name in names if name != best and not self._refuted(name, best, gains, rng))]

    def _refuted(self, name: str, best: str, gains: dict[str, float], rng: np.random.Generator) -> bool:
        """Return whether a term of the most likely size hardly ever lets another one explain so much more."""
        scale = np.sqrt(1.0 + self.best_ratio(name) * self.values[name])
        means = (rng.standard_normal((_DRAWS, scale.size)) * scale) @ self.axes[name].T
        more = self.likelihoods(best, means).max(axis=1) - self.likelihoods(name, means).max(axis=1)
        return float(np.mean(more >= gains[best] - gains[name])) <= WRONG_NAME


def _above(ascending: Floats, gain: float | Floats) -> Floats:
    """Return the share of gains by chance that are at least so large."""
    return np.asarray(1.0 - np.searchsorted(ascending, gain, side="left") / ascending.size)


def _worth(log: _Log, names: Sequence[str], ratios: Sequence[float]) -> tuple[float, float]:
    """Return half-widths of intervals of the mean, over all sizes of the largest term that is there and of all others.

    Under each size the further mean minus that of the log is normal, given the means of the blocks (kriging).
    Source: Chiles and Delfiner, Geostatistics (2012), section 3.3 (prediction with a mean that is not known).
    """
    kept = sorted(zip(ratios, names, strict=True))[:-1]
    stage = _Stage.of(log, [name for _, name in kept], [ratio for ratio, _ in kept])
    toward = sum((ratio * log.toward[name] for ratio, name in kept), np.zeros_like(log.means))
    known = 1.0 + sum(ratio for ratio, _ in kept)
    share, offset, variance = [], [], []
    for name, values in stage.values.items():
        scale = 1.0 + _SIZES[:, None] * values
        along = stage.means @ stage.axes[name]
        ahead = stage.in_axes(name, toward) + _SIZES[:, None] * stage.in_axes(name, log.toward[name])
        offset.append((ahead * along / scale).sum(axis=1))
        left = log.white * (known + _SIZES) - (ahead**2 / scale).sum(axis=1)
        variance.append((np.square(along) / scale).mean(axis=1) * left)
        share.append(_WEIGHTS[name] * np.exp(stage.likelihoods(name, stage.means, _SIZES)))
    mixture = np.concatenate(share), np.concatenate(offset), np.sqrt(np.concatenate(variance))
    std, expanded = (_half_width(*mixture, chance) / math.sqrt(2.0) for chance in _PROBABILITIES)
    return std, expanded


def _half_width(share: Floats, offset: Floats, std: Floats, chance: float) -> float:
    """Return the half-width around zero that a mixture of normal values lies in with this probability."""

    def missing(half: float) -> float:
        inside = special.ndtr((half - offset) / std) - special.ndtr((-half - offset) / std)
        return float(share @ inside / share.sum()) - chance

    largest = float((np.abs(offset) + 10.0 * std).max())
    return float(optimize.brentq(missing, 0.0, largest, xtol=1e-9 * largest))
