"""What all units moved by at once: the error of each certificate of a standard, and the scatter of units of one kind.

Each unit has its own levels and its own drift; a certificate moves all units that were calibrated with it by the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from bench.maths.arrays import Floats
from bench.maths.control.predictions import Readings, Scatter, level_and_drift
from bench.maths.control.run_lengths import normal_scores

LEAST_FREEDOM = 8  # degrees of freedom of the scatter of all units; with fewer nothing is judged
_ROUNDS = 60  # of taking out means by turns: a table without holes needs one
_LEAST = 1e-10  # relative; what is below it is rounding


@dataclass(frozen=True)
class Population:
    """Units of one kind about their own levels and drifts and the errors of all certificates, by least squares.

    ``normal`` (c, c) and ``moment`` (c,) are those of the certificates' errors with unit weights, (n) with level and
    drift of every unit taken out.
    """

    normal: Floats
    moment: Floats
    variance: float  # of one calibration; NaN without degrees of freedom
    freedom: int

    @property
    def scatter(self) -> Scatter:
        """The scatter as the random effect of a single calibration."""
        return Scatter(self.variance, self.variance * (2.0 / self.freedom) ** 0.5, np.inf, 0, float(self.freedom))


@dataclass(frozen=True)
class Steps:
    """Certificates in order of their first use, (c,) each; NaN where nothing is known.

    ``moved``: what all units moved by with it, against what the certificates before it let one expect; ``std`` of that,
    and ``expected_std``, with what it states itself; ``score``: standard normal while every certificate holds.
    """

    moved: Floats
    std: Floats
    expected_std: Floats
    score: Floats


def common_mode(table: Floats) -> Floats:
    """Return what the parameters of a unit have in common in each calibration, up to a constant.

    Args:    table: (n, p) calibrations by parameters, any unit, NaN where a calibration has no such parameter.
    Returns: (n,) effects of the calibrations beside those of the parameters, by least squares; without holes the means.
    Raises:  nothing.
    Source:  two-way layout without interaction, Scheffe, The Analysis of Variance, section 4.1; by turns.
    """
    parameter = np.nanmean(table, axis=0)
    calibration = np.nanmean(table - parameter, axis=1)
    for _ in range(_ROUNDS if np.isnan(table).any() else 0):
        parameter = np.nanmean(table - calibration[:, None], axis=0)
        calibration = np.nanmean(table - parameter, axis=1)
    return np.asarray(calibration + parameter.mean())


def population(units: Sequence[Readings], certificates: int) -> Population:
    """Fit levels and drift of every unit and the errors of all certificates.

    Args:    units: one series a unit; labels of certificates 0 ... certificates - 1, or NO_STANDARD.
             certificates: how many there are.
    Returns: Population; no error of a certificate, whatever it is, enters its variance.
    Raises:  nothing.
    Source:  Frisch and Waugh, Econometrica 1 (1933) 387 (levels and drifts taken out unit by unit).
    """
    normal, moment = np.zeros((certificates, certificates)), np.zeros(certificates)
    squares, freedom = 0.0, 0
    for unit in units:
        if unit.t.size < 2:
            continue
        basis = linalg.orth(level_and_drift(unit), rcond=_LEAST)
        shares = (unit.standard[:, None] == np.arange(certificates)).astype(np.float64)
        shares -= basis @ (basis.T @ shares)
        left = unit.value - basis @ (basis.T @ unit.value)
        normal, moment = normal + shares.T @ shares, moment + shares.T @ left
        squares, freedom = squares + float(left @ left), freedom + unit.t.size - basis.shape[1]
    inverse = np.linalg.pinv(normal, rcond=_LEAST, hermitian=True)
    freedom -= int(np.linalg.matrix_rank(normal, tol=_LEAST * max(float(np.trace(normal)), 1.0), hermitian=True))
    rest = max(squares - float(moment @ inverse @ moment), _LEAST * squares)
    return Population(normal, moment, rest / freedom if freedom > 0 else np.nan, freedom)


def certificate_steps(units: Sequence[Readings], stated: Floats, limit: float) -> Steps:
    """Judge each certificate by all units: what they moved by at once, against what it states.

    Every certificate has an error of its own, normal with the standard uncertainty it states; nothing scales it. A
    certificate is compared with the units as they are known up to it, so a later one changes nothing. One that is
    beyond the limit does not hold what it states: those after it are judged as if its error were unknown.

    Args:    units: one series a unit, labels of certificates in order of their first use.
             stated: (c,) standard uncertainty that each certificate states, > 0, in the unit of the readings.
             limit: of a score.
    Returns: Steps; NaN for a certificate that nothing ties to the earlier ones.
    Raises:  nothing.
    Source:  prediction in the mixed linear model, G. K. Robinson, Statistical Science 6 (1991) 15, sections 2 and 5.3.
    """
    steps = Steps(*(np.full(stated.size, np.nan) for _ in range(4)))
    weight = stated**-2.0
    for newest in range(1, stated.size):
        until = [unit.of(unit.standard <= newest) for unit in units]
        known = population(until, newest + 1)
        if known.freedom < LEAST_FREEDOM or known.normal[newest, newest] <= _LEAST * np.trace(known.normal):
            continue
        before = np.append(weight[:newest], 0.0)
        covariance = np.linalg.inv(known.normal / known.variance + np.diag(before))
        variance = float(covariance[newest, newest])
        if not 0.0 < variance < (float(stated[newest]) / _LEAST**0.5) ** 2:
            continue  # nothing ties it to a certificate that holds what it states
        steps.moved[newest] = covariance[newest] @ known.moment / known.variance
        total = variance + float(stated[newest]) ** 2
        steps.std[newest], steps.expected_std[newest] = variance**0.5, total**0.5
        dof = np.array(known.freedom * (total / variance) ** 2)  # at least: the certificates' part is not estimated
        steps.score[newest] = normal_scores(np.array(steps.moved[newest] / total**0.5), dof)
        weight[newest] *= abs(steps.score[newest]) <= limit
    return steps
