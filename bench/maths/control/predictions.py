"""Each calibration of a parameter against what those before it let one expect, and since when it has been another.

A calibration is a level and a drift, the error of the certificate of its standard, which all calibrations of that
certificate share, and a random effect of its own. How large that effect is, the first phase says, and it stays; level
and drift are known the better the more calibrations there are, and each prediction holds what is not known of them.
Nothing that was predicted is changed by a later calibration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import brentq

from bench.maths.arrays import Flags, Floats, Integers
from bench.maths.control.run_lengths import normal_scores
from bench.maths.drift import NO_STANDARD
from bench.maths.tests import of_many, t_both
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError

_LEAST_SCATTER = 1e-4  # of the smallest variance stated: where readings do not scatter at all, no change is nothing
_STEP = 1e-3  # relative, of a derivative
_UNDETERMINED = 1e-4  # part of a row that the rows before it do not hold; of a drift: an hour of a year
_RANK = 1e-10
_NOTHING = 1e-12  # of the largest eigenvalue
_LIKELY = 3.84  # chi-square of one degree of freedom, 95 %


@dataclass(frozen=True)
class Readings:
    """Calibrations of one parameter in order of time, (n,) each, in its unit.

    ``std`` is what a calibration states, ``shared`` its part from the certificate labelled ``standard`` (NO_STANDARD:
    none); ``level``: a label that changes where the unit was adjusted; ``owner``: which unit, None for a single one.
    """

    t: Floats  # years
    value: Floats
    std: Floats
    shared: Floats
    standard: Integers
    level: Integers
    owner: Integers | None = None

    def of(self, rows: slice | Flags | Integers) -> Readings:
        """Return some of them."""
        owner = None if self.owner is None else self.owner[rows]
        readings = (self.t[rows], self.value[rows], self.std[rows], self.shared[rows])
        return Readings(*readings, self.standard[rows], self.level[rows], owner)


@dataclass(frozen=True)
class Scatter:
    """The random effect of a calibration, as the first phase shows it.

    ``variance`` has the standard uncertainty ``variance_std``; ``own``: the largest variance that a calibration of the
    first phase states without its certificate. ``dof`` are those of the prediction that it says least about.
    """

    variance: float
    variance_std: float
    own: float
    count: int
    dof: float


@dataclass(frozen=True)
class Predictions:
    """Calibrations against those before them, (n,) each; NaN where those determine no prediction."""

    expected: Floats
    std: Floats  # of value - expected
    dof: Floats  # of std; infinite where the first phase has no part in it
    score: Floats  # standard normal while nothing changes


def first_phase(readings: Readings, count: int) -> Scatter:
    """Estimate the random effect of calibrations from the first ``count`` of them.

    The generalised residual sum of squares about levels and one drift is what it must be: its degrees of freedom. The
    error of a certificate stays what it is stated to be.

    Args:    readings: with standard uncertainties above zero.   count: of the first phase.
    Returns: Scatter in the unit of the readings squared.
    Raises:  FitError B-FIT-001 if none is left over beside levels and drift; B-FIT-002: an uncertainty not above 0.
    Source:  R. C. Paule, J. Mandel, J. Res. NBS 87 (1982) 377; degrees of freedom: F. E. Satterthwaite, Biometrics
             Bulletin 2 (1946) 110.
    """
    phase = readings.of(slice(count))
    design, shared = level_and_drift(phase), _shared(phase)
    freedom = count - int(np.linalg.matrix_rank(design))
    if freedom < 1:
        advice = "add calibrations of this unit to the history, or let the first phase end later"
        raise FitError("B-FIT-001", f"{count} calibrations do not show how much they scatter", next_step=advice)
    if not (phase.std > 0.0).all():
        advice = "check the uncertainties of these estimates with 'bench history show'"
        raise FitError("B-FIT-002", "a calibration states an uncertainty that is not above zero", next_step=advice)

    def excess(variance: float) -> float:
        return _left_over(design, shared, phase.value, variance)[0] - freedom

    least = _LEAST_SCATTER * float((phase.std**2).min())
    most = float(np.var(phase.value)) * count + least
    variance = least if excess(least) <= 0.0 else float(brentq(excess, least, most, xtol=1e-9 * least, rtol=1e-9))
    slope = _left_over(design, shared, phase.value, variance)[1]
    own = float(np.max(phase.std**2 - phase.shared**2))
    known = Scatter(variance, float(np.sqrt(2.0 * freedom)) / slope, own, count, float(freedom))
    dof = predictions(phase, known).dof
    return Scatter(known.variance, known.variance_std, own, count, float(np.nanmin(dof, initial=freedom)))


def odd_one_of_first_phase(readings: Readings, scatter: Scatter) -> tuple[int, float]:
    """Test whether the calibration of the first phase that is farthest from the others belongs to them.

    Args:    readings: (n,).   scatter: of their first phase.
    Returns: its index, and the probability of one at least as far by chance (at most, by the union bound).
    Raises:  nothing.
    Source:  F. E. Grubbs, Technometrics 11 (1969) 1, for residuals of a fit: Cook and Weisberg, Residuals and Influence
             in Regression, section 2.2.2 (deleted residuals).
    """
    phase = readings.of(slice(scatter.count))
    factor = np.linalg.inv(np.linalg.cholesky(_shared(phase) + scatter.variance * np.eye(scatter.count)))
    basis = linalg.orth(factor @ level_and_drift(phase), rcond=_RANK)
    rows = factor - basis @ (basis.T @ factor)
    freedom, alone = scatter.count - basis.shape[1], np.einsum("ij,ij->j", rows, rows)
    with np.errstate(divide="ignore", invalid="ignore"):
        square = np.nan_to_num((rows.T @ (rows @ phase.value)) ** 2 / alone)
        quotient = np.sqrt(square * (freedom - 1) / np.maximum(freedom - square, 1e-12))
    worst = int(quotient.argmax())
    return worst, of_many(t_both(float(quotient[worst]), freedom - 1), scatter.count)


def predictions(readings: Readings, scatter: Scatter) -> Predictions:
    """Predict each calibration from those before it: level, drift, and the error of its certificate where it is known.

    A calibration that states more uncertainty of its own than those of the first phase has that beside its random
    effect. The degrees of freedom of a prediction are those of its variance, of which the first phase gives a part.

    Args:    readings: (n,).   scatter: of the first phase.
    Returns: Predictions in the unit of the readings.
    Raises:  nothing.
    Source:  R. L. Brown, J. Durbin, J. M. Evans, J. R. Stat. Soc. B 37 (1975) 149 (recursive residuals) of readings
             made white by the Cholesky factor of their covariance; degrees of freedom as in ``first_phase``.
    """
    expected, std = _sequential(readings, scatter, scatter.variance)
    _, more = _sequential(readings, scatter, scatter.variance * (1.0 + _STEP))
    slope = (more**2 - std**2) / (_STEP * scatter.variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        dof = 2.0 * std**4 / (slope * scatter.variance_std) ** 2
        dof = np.where(np.isnan(std), np.nan, np.maximum(dof, 1.0))
        score = normal_scores((readings.value - expected) / std, np.where(np.isnan(dof), np.inf, dof))
    return Predictions(expected, std, dof, score)


@dataclass(frozen=True)
class Change:
    """A step: from reading ``since`` on, or likely one of ``earliest`` to ``latest``, readings are ``size`` off."""

    since: int
    earliest: int
    latest: int
    size: float
    std: float
    dof: float

    @property
    def expanded(self) -> float:
        """Half-width of the 95 % interval of the size, by Student's t."""
        return coverage_factor(self.dof) * self.std


def step_until(error: Floats, std: Floats, last: int, dof: float) -> Change | None:
    """Estimate the likeliest step in errors of predictions up to ``last`` that are independent of each other.

    Args:    error, std: (n,) value minus prediction with its standard deviation; NaN where there is none.
             last: index of the error that gave a signal.   dof: degrees of freedom of the standard deviations.
    Returns: Change; None without any error.
    Raises:  nothing.
    Source:  T. R. Samuel, J. J. Pignatiello, J. A. Calvin, Quality Engineering 10 (1998) 521.
    """
    weight = np.nan_to_num(std[: last + 1] ** -2.0)
    power = np.cumsum(weight[::-1])[::-1]
    total = np.cumsum(np.nan_to_num(weight * error[: last + 1])[::-1])[::-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where(weight > 0.0, total**2 / power, -np.inf)
    return _likeliest(total / np.maximum(power, 1e-300), power, gain, dof)


def change_until(readings: Readings, scatter: Scatter, last: int) -> Change | None:
    """Estimate since when the readings up to ``last`` have been another, and by how much: the likeliest step.

    The interval of the size holds for a step at that place; the place may be any of ``earliest`` to ``latest``.

    Args:    readings: (n,).   scatter: of the first phase.   last: index of the reading that gave a signal.
    Returns: Change; None if no place of a step can be told from level and drift.
    Raises:  nothing.
    Source:  T. R. Samuel, J. J. Pignatiello, J. A. Calvin, Quality Engineering 10 (1998) 521 (step change of a mean),
             with level, drift and certificates beside the step.
    """
    seen = readings.of(slice(last + 1))
    white = _whitener(seen, scatter, scatter.variance)
    steps = np.tril(np.ones((last + 1, last + 1)))  # a step before reading 0 (no more than a level), 1, 2, ... last
    turned, value, steps = (
        linalg.solve_triangular(white, part, lower=True) for part in (level_and_drift(seen), seen.value, steps)
    )
    basis = linalg.orth(turned, rcond=_RANK)
    left, moved = value - basis @ (basis.T @ value), steps - basis @ (basis.T @ steps)
    power = np.einsum("ij,ij->j", moved, moved)
    usable = power > _UNDETERMINED * np.einsum("ij,ij->j", steps, steps)
    size = np.where(usable, moved.T @ left, 0.0) / np.where(usable, power, 1.0)
    return _likeliest(size, power, np.where(usable, size**2 * power, -np.inf), scatter.dof)


def _likeliest(size: Floats, power: Floats, gain: Floats, dof: float) -> Change | None:
    """Return the step of the largest gain in chi-square, and between which places it may be."""
    best = int(gain.argmax())
    if not np.isfinite(gain[best]):
        return None
    likely = np.flatnonzero(gain >= gain[best] - _LIKELY)
    return Change(best, int(likely[0]), int(likely[-1]), float(size[best]), float(power[best] ** -0.5), dof)


def level_and_drift(readings: Readings) -> Floats:
    """Return columns of the levels and of the drift of each unit, (n, k), years from its first calibration on."""
    owner = np.zeros_like(readings.level) if readings.owner is None else readings.owner
    columns = []
    for unit in np.unique(owner):
        own = owner == unit
        columns += [own & (readings.level == level) for level in np.unique(readings.level[own])]
        columns.append(np.where(own, readings.t - readings.t[own][0], 0.0))
    return np.column_stack(columns).astype(np.float64)


def _shared(readings: Readings) -> Floats:
    same = (readings.standard[:, None] == readings.standard) & (readings.standard != NO_STANDARD)
    return np.where(same, np.outer(readings.shared, readings.shared), 0.0)


def _whitener(readings: Readings, scatter: Scatter, variance: float) -> Floats:
    """Return the lower Cholesky factor of the covariance of the readings, (n, n)."""
    beyond = np.maximum(readings.std**2 - readings.shared**2 - scatter.own * (1.0 + 1e-9), 0.0)
    return np.asarray(np.linalg.cholesky(np.diag(variance + beyond) + _shared(readings)))


def _left_over(design: Floats, shared: Floats, value: Floats, variance: float) -> tuple[float, float]:
    """Return the generalised residual sum of squares, and how fast its expectation falls with the variance."""
    factor = np.linalg.cholesky(shared + variance * np.eye(value.size))
    inverse = linalg.solve_triangular(factor, np.eye(value.size), lower=True)
    basis = linalg.orth(inverse @ design, rcond=_RANK)
    left = inverse @ value
    left -= basis @ (basis.T @ left)
    rows = inverse - basis @ (basis.T @ inverse)
    return float(left @ left), float(np.sum(rows**2))


def _sequential(readings: Readings, scatter: Scatter, variance: float) -> tuple[Floats, Floats]:
    """Return the prediction of each reading from those before it and the standard deviation of its error, (n,) each."""
    factor = _whitener(readings, scatter, variance)
    rows = linalg.solve_triangular(factor, np.column_stack([level_and_drift(readings), readings.value]), lower=True)
    design, white = rows[:, :-1], rows[:, -1]
    normal = np.zeros((design.shape[1], design.shape[1]))
    inverse, moment = normal.copy(), np.zeros(design.shape[1])
    error, std = np.full(white.size, np.nan), np.full(white.size, np.nan)
    for place, (row, value) in enumerate(zip(design, white, strict=True)):
        gain = inverse @ row
        known, new = 1.0 + float(row @ gain), row - normal @ gain
        normal += np.outer(row, row)
        if np.abs(new).max() <= _UNDETERMINED * np.abs(row).max():
            std[place] = factor[place, place] * np.sqrt(known)
            error[place] = factor[place, place] * (value - gain @ moment)
            inverse -= np.outer(gain, gain) / known
        else:  # one more of the unknowns is determined
            inverse = np.linalg.pinv(normal, rcond=_NOTHING, hermitian=True)
        moment += row * value
    return readings.value - error, std
