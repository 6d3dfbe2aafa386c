"""The five noise terms of an Allan deviation, with uncertainties and which of them the record shows at all.

Variances at neighbouring averaging times rest on the same samples and are far from independent; a fit that takes them
as independent states too small uncertainties. For Gaussian noise their covariance follows from that of the second
differences of the angle, which a generalised covariance function of the angle gives in closed form.

Source: IEEE Std 952-1997 annex C (definitions of the coefficients); Lawson and Hanson, Solving Least Squares Problems,
chapter 23 (non-negative least squares); Isserlis' theorem; generalised covariances as in Greenhall and Riley (2003).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import optimize

from bench.maths.allan import AllanDeviation, angle_covariance, expected_curve
from bench.maths.arrays import Floats, Integers
from bench.maths.least_squares import solve
from bench.model.errors import FitError

FILTERING = "filtering"  # what averages of samples lack that were filtered or interpolated
TERMS = ("quantisation_noise", "white_noise", "bias_instability", "random_walk", "rate_ramp")
UNITS = {
    "quantisation_noise": "*s",
    "white_noise": "*s^0.5",
    "bias_instability": "",
    "random_walk": "/s^0.5",
    "rate_ramp": "/s",
}  # to be set behind the unit of the rate
GYRO_TERMS = {  # name and unit in data sheets, and the factor of a coefficient in deg/h and a power of the second
    "quantisation_noise": ("quantisation_noise", "arcsec", 1.0),
    "white_noise": ("angle_random_walk", "deg/sqrt(h)", 1.0 / 60.0),
    "bias_instability": ("bias_instability", "deg/h", 1.0),
    "random_walk": ("rate_random_walk", "deg/h/sqrt(h)", 60.0),
    "rate_ramp": ("rate_ramp", "deg/h/h", 3600.0),
}
_REWEIGHTINGS = 4
_LIMIT_STEPS = 2
_FEWEST_DOF = 4.0
_ONE_SIDED = 1.645  # 95 % of a normal distribution lie below
_SIGNIFICANT = 2.706  # chi squared that a term at its boundary 0 gains by chance in 5 % of all records

SCATTERING = ("quantisation_noise", "white_noise", "bias_instability", "random_walk")
_EXPONENTS = (2, 0, -1, -2)  # power of frequency in the spectrum of the rate, of each of these
_SIZES = (1.0, 2.0, 2.0 * np.pi, 12.0)  # of its generalised covariance of the angle over that of a unit coefficient
_REACH = 4  # differences this many times the sum of both averages apart are independent; but for flicker noise exactly
_SECOND_DIFFERENCE = ((0, 1.0), (1, -2.0), (2, 1.0))


@dataclass(frozen=True)
class NoiseTerm:
    """One coefficient, in the unit of the rate and a power of the second (``UNITS``).

    ``std_uncertainty`` is NaN where the coefficient is 0. ``free_coefficient``, ``free_std``: of the fit in which
    squares may be negative, NaN where the coefficient is 0; a term that is held at 0 pulls its neighbours always in the
    same direction, and these are right on average. ``upper_limit`` is not exceeded with 95 % confidence, whatever the
    other terms are; ``gain``: by which chi squared is larger without the term.
    """

    name: str
    coefficient: float
    std_uncertainty: float
    free_coefficient: float
    free_std: float
    upper_limit: float
    gain: float

    @property
    def significant(self) -> bool:
        """Whether the fit is worse without the term than chance explains in one of twenty records."""
        return self.gain > _SIGNIFICANT


@dataclass(frozen=True)
class NoiseTerms:
    """Fit of the terms to a deviation: ``fitted`` (k,) is the deviation they give at the averaging times."""

    terms: tuple[NoiseTerm, ...]
    fitted: Floats
    chi2: float
    dof: int

    def __getitem__(self, name: str) -> NoiseTerm:
        return next(term for term in self.terms if term.name == name)


def allan_variance_of(name: str, tau_s: Floats) -> Floats:
    """Return Allan variance that the unit coefficient of a term gives.

    quantisation Q: 3 Q^2 / tau^2; white noise N (angle random walk, two-sided density): N^2 / tau; bias instability B:
    (2 ln 2 / pi) B^2; random walk K: K^2 tau / 3; rate ramp R: R^2 tau^2 / 2. Samples that hang together over a time
    that is short against tau lack -3 F^2 / tau^2 of what their white noise makes, whatever hangs them together.

    Args:    name: one of TERMS, or FILTERING.   tau_s: averaging times, (k,), second.
    Returns: (k,), squared unit of the rate per squared unit of the coefficient.
    Source:  IEEE Std 952-1997 annex C, equations C.7 to C.17.
    """
    tau_s = np.asarray(tau_s, np.float64)
    if name in ("quantisation_noise", FILTERING):
        return np.asarray((-3.0 if name == FILTERING else 3.0) / tau_s**2)
    if name == "white_noise":
        return np.asarray(1.0 / tau_s)
    if name == "bias_instability":
        return np.full(tau_s.shape, 2.0 * np.log(2.0) / np.pi)
    if name == "random_walk":
        return np.asarray(tau_s / 3.0)
    return np.asarray(tau_s**2 / 2.0)


@dataclass(frozen=True)
class _Problem:
    """Allan variances of the averaging times that are used, what each term gives there, and their covariance."""

    terms: tuple[str, ...]
    variance: Floats
    design: Floats
    scatter: VarianceCovariance

    @classmethod
    def of(cls, curve: AllanDeviation, terms: Sequence[str], used: Integers) -> _Problem:
        design = np.column_stack([allan_variance_of(name, curve.tau_s[used]) for name in terms])
        scatter = variance_covariance(curve.factors[used], curve.differences[used], curve.interval_s)
        return cls(tuple(terms), np.asarray(np.square(curve.deviation[used])), design, scatter)

    def covariance(self, squares: Floats) -> Floats:
        """Of the variances, if these are the squared coefficients."""
        return self.scatter.matrix(dict(zip(self.terms, squares.tolist(), strict=True)))

    def nonnegative(self, covariance: Floats, without: int | None = None) -> tuple[Floats, float]:
        """Return squared coefficients and chi squared, of all terms or of all but one."""
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.solve(factor, self.design)
        kept = [k for k in range(len(self.terms)) if k != without]
        scale = np.linalg.norm(white[:, kept], axis=0)
        readings = np.linalg.solve(factor, self.variance)
        squares = np.zeros(len(self.terms))
        if not kept:
            return squares, float(readings @ readings)
        solution, distance = optimize.nnls(white[:, kept] / scale, readings)
        squares[kept] = solution / scale
        return squares, float(distance**2)


def expected_deviation(terms: Mapping[str, float], samples: int, interval_s: float) -> AllanDeviation:
    """Return the overlapping Allan deviation that a record without a gap has on average.

    Args:    terms: coefficients by name, of ``SCATTERING``.   samples: n of the record.   interval_s: of one sample.
    Returns: AllanDeviation at powers of two of the interval, with the degrees of freedom of its largest term at each.
    Raises:  FitError B-FIT-031 for fewer than two samples, which leave no averaging time.
    Source:  IEEE Std 952-1997 annex C (the terms add); Greenhall and Riley (2003) for the degrees of freedom.
    """
    factors = np.array([2**k for k in range(samples.bit_length()) if 2 ** (k + 1) <= samples], dtype=np.int64)
    if not factors.size:
        raise FitError(
            "B-FIT-031",
            f"{samples} samples leave no averaging time of an Allan deviation",
            next_step="plan at least three samples without a gap between them",
        )
    tau_s: Floats = factors * np.float64(interval_s)
    parts = np.array([terms.get(name, 0.0) ** 2 * allan_variance_of(name, tau_s) for name in SCATTERING])
    exponents = np.array(_EXPONENTS)[np.argmax(parts, axis=0)]
    return expected_curve(interval_s, samples, factors, np.sqrt(parts.sum(axis=0)), exponents)


def fit_noise_terms(curve: AllanDeviation, terms: Sequence[str] = TERMS) -> NoiseTerms:
    """Fit the squared coefficients to the Allan variances by non-negative generalised least squares.

    The weights follow from the fitted terms themselves and count the samples that averaging times share; they are
    found again until they settle, because weights from scattered variances would favour the low ones. Averaging times
    with fewer than 4 degrees of freedom say too little and are left out as long as there are more than terms.

    Args:    curve: an overlapping Allan deviation.   terms: which of TERMS to fit.
    Returns: NoiseTerms; the uncertainty of a term that is present counts the other terms that are.
    Raises:  FitError B-FIT-030 for fewer averaging times than terms, or a record without noise.
    Source:  IEEE Std 952-1997 annex C; Lawson and Hanson, Solving Least Squares Problems, chapter 23.
    """
    _require(curve, terms)
    reliable = (curve.dof >= _FEWEST_DOF) | (np.arange(curve.dof.size) < len(terms))
    used = np.flatnonzero(reliable)
    problem = _Problem.of(curve, terms, used)
    covariance = np.diag(2.0 * np.square(problem.variance) / curve.dof[used])
    squares, chi2 = problem.nonnegative(covariance)
    for _ in range(_REWEIGHTINGS):
        settled = problem.covariance(squares)
        again, distance = problem.nonnegative(settled)
        if not again.any():  # these weights leave no term at all: the terms do not describe the record, chi2 says so
            break
        covariance, squares, chi2 = settled, again, distance
    fitted = [_term(problem, k, squares, covariance, chi2) for k in range(len(terms))]
    return NoiseTerms(
        terms=tuple(fitted),
        fitted=np.sqrt(np.maximum(0.0, np.column_stack([allan_variance_of(n, curve.tau_s) for n in terms]) @ squares)),
        chi2=chi2,
        dof=used.size - int(np.count_nonzero(squares)),
    )


def _require(curve: AllanDeviation, terms: Sequence[str]) -> None:
    if curve.tau_s.size < len(terms):
        raise FitError(
            "B-FIT-030",
            f"{len(terms)} noise terms cannot be fitted to {curve.tau_s.size} averaging times",
            next_step="take an overlapping Allan deviation of a longer record, or fit fewer terms",
        )
    if not (curve.deviation > 0.0).all():
        raise FitError(
            "B-FIT-030",
            f"the Allan deviation is 0 at {int((curve.deviation <= 0.0).sum())} of {curve.tau_s.size} averaging times: "
            "a record without noise has no noise terms",
            next_step="look whether the record changes at all",
        )


def _term(problem: _Problem, place: int, squares: Floats, covariance: Floats, chi2: float) -> NoiseTerm:
    square = float(squares[place])
    coefficient, spread, free = float(np.sqrt(square)), float("nan"), (float("nan"), float("nan"))
    if square > 0.0:
        present = np.flatnonzero(squares > 0.0)
        names = [problem.terms[k] for k in present]
        fit = solve(problem.design[:, present], problem.variance, covariance, names)
        spread = float(np.sqrt(fit.covariance.diagonal()[present == place][0])) / (2.0 * coefficient)
        free = _free(problem, place, squares)
    without = problem.nonnegative(covariance, without=place)[1]
    return NoiseTerm(
        name=problem.terms[place],
        coefficient=coefficient,
        std_uncertainty=spread,
        free_coefficient=free[0],
        free_std=free[1],
        upper_limit=float(np.sqrt(_highest(problem, place, squares))),
        gain=without - chi2,
    )


def _free(problem: _Problem, place: int, squares: Floats) -> tuple[float, float]:
    """Return a coefficient and its standard uncertainty where the squares of all terms may be negative."""
    supposed = squares.copy()
    for _ in range(_LIMIT_STEPS):
        fit = solve(problem.design, problem.variance, problem.covariance(supposed), problem.terms)
        supposed[place] = float(fit.parameters[place])
        if not supposed[place] > 0.0:
            return float("nan"), float("nan")
    coefficient = float(np.sqrt(supposed[place]))
    return coefficient, float(np.sqrt(fit.covariance[place, place])) / (2.0 * coefficient)


def _highest(problem: _Problem, place: int, squares: Floats) -> float:
    """Return upper limit of a squared coefficient with all other terms free; it scatters more the more there is."""
    supposed = squares.copy()
    for _ in range(_LIMIT_STEPS):
        fit = solve(problem.design, problem.variance, problem.covariance(supposed), problem.terms)
        reach = _ONE_SIDED * float(np.sqrt(fit.covariance[place, place]))
        supposed[place] = max(0.0, float(fit.parameters[place])) + reach
    return float(supposed[place])


@dataclass(frozen=True)
class VarianceCovariance:
    """Covariance of k Allan variances as a function of the squared coefficients of the noise.

    ``products`` (k, k, 4, 4): part of each product of two squares in the order of SCATTERING; ``ramp`` (k, k, 4): of
    the product of a square and that of the rate ramp, which does not scatter itself but takes the others' scatter up.
    """

    products: Floats
    ramp: Floats

    def matrix(self, squares: Mapping[str, float]) -> Floats:
        """(k, k), fourth power of the rate's unit; names as in ``bench.maths.allan_terms.TERMS``, 0 if not there."""
        noise = np.array([squares.get(name, 0.0) for name in SCATTERING])
        noise[0] -= squares.get(FILTERING, 0.0)
        return np.asarray(self.products @ noise @ noise + squares.get("rate_ramp", 0.0) * (self.ramp @ noise))


def variance_covariance(factors: Integers, differences: Integers, interval_s: float) -> VarianceCovariance:
    """Return covariance of overlapping Allan variances of one record of Gaussian noise.

    Args:    factors: samples per average, (k,).   differences: in each variance, (k,).   interval_s: of one sample.
    Returns: VarianceCovariance.
    Source:  Isserlis' theorem for Gaussian noise.
    """
    return _covariance_of(tuple(factors.tolist()), tuple(differences.tolist()), interval_s)


@lru_cache(maxsize=8)  # outputs of one record have it in common
def _covariance_of(
    of_factors: tuple[int, ...], of_differences: tuple[int, ...], interval_s: float
) -> VarianceCovariance:
    factors, differences = np.array(of_factors), np.array(of_differences)
    size, kinds = factors.size, len(SCATTERING)
    t_s = np.asarray(interval_s * np.arange((_REACH + 2) * 2 * int(factors.max()) + 1), np.float64)
    angle = np.stack([angle_covariance_of(name, t_s) for name in SCATTERING])
    products, ramp = np.empty((size, size, kinds, kinds)), np.empty((size, size, kinds))
    for i in range(size):
        for j in range(i + 1):
            pair, counts = factors[[i, j]], differences[[i, j]]
            lags, covariance = _difference_covariance(angle, pair, interval_s)
            pairs = np.minimum(counts[0] - 1, counts[1] - 1 + lags) - np.maximum(0, lags) + 1
            share = np.maximum(pairs, 0) / (4.0 * counts[0] * counts[1])
            products[i, j] = products[j, i] = 2.0 * (share * covariance) @ covariance.T
            ramp[i, j] = ramp[j, i] = 4.0 * float(np.prod(pair * interval_s)) * (covariance @ share)
    return VarianceCovariance(products, ramp)


def angle_covariance_of(name: str, t_s: Floats) -> Floats:
    """Return generalised covariance of the angle at lags, shape of ``t_s``, of a unit coefficient of ``SCATTERING``."""
    place = SCATTERING.index(name)
    return angle_covariance(t_s, _EXPONENTS[place]) / _SIZES[place]


def _difference_covariance(angle: Floats, pair: Integers, interval_s: float) -> tuple[Integers, Floats]:
    """Return lags in samples, and the covariances (4, lags) of the differences of averages over ``pair`` samples."""
    reach = _REACH * int(pair.sum())
    lags = np.arange(-reach, reach + 1)
    total = np.zeros((len(angle), lags.size))
    for first, weight in _SECOND_DIFFERENCE:
        for second, other in _SECOND_DIFFERENCE:
            total += weight * other * angle[:, np.abs(lags + first * pair[0] - second * pair[1])]
    return lags, total / float(np.prod(pair * interval_s))
