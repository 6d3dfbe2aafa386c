"""Azimuths of one method set by set, against their repeats and against the stated azimuths, with what is due."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.analysis import Floats
from bench.maths.arrays import Integers
from bench.maths.tests import f_tail, t_both
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.sets import TEST
from bench.systems.north.solution import LIKELIHOOD, Solution

LEAST_deg = 1e-3  # steps of level and lock-ins


@dataclass(frozen=True)
class Errors:
    """What one method found, degrees.

    ``about_deg``, ``group``: (n,) every azimuth about the mean of its repeats, and which mean.   ``heads_deg``,
    ``times_s``, ``mean_deg``, ``weights``: (h,) the known azimuths: head, middle of the time, mean error, 1/variance.
    ``noise_deg``: of one set, with ``noise_dof``.   ``start_deg``: what changes at each start of the table.
    ``shared_deg``: what all have in common, ``common_dof`` its degrees of freedom.   ``most``: repeats of a group.
    """

    about_deg: Floats
    group: Integers
    heads_deg: Floats
    times_s: Floats
    mean_deg: Floats
    weights: Floats
    noise_deg: float
    noise_dof: float
    start_deg: float
    shared_deg: float
    common_dof: float
    most: int

    def within(self) -> tuple[float, int]:
        """Return the sum of squares of all repeats about their means, and its degrees of freedom."""
        return float(np.sum(self.about_deg**2)), len(self.about_deg) - len(np.unique(self.group))

    def common_error(self) -> tuple[float, Floats]:
        """Return the weighted mean of the errors at the known azimuths, and what is left, (h,)."""
        mean_deg = float(np.sum(self.weights * self.mean_deg) / np.sum(self.weights))
        return mean_deg, self.mean_deg - mean_deg

    def common_std_deg(self) -> float:
        """Return the standard uncertainty of the common error."""
        return math.hypot(1.0 / math.sqrt(float(np.sum(self.weights))), self.shared_deg)


def errors_of(solution: Solution, method: str) -> Errors | None:
    """Return what a method found; None if it found nothing."""
    azimuths = solution.by_method[method]
    found = np.isfinite(azimuths.azimuth_deg)
    if not found.any():
        return None
    names = list(dict.fromkeys(north_set.group for north_set in solution.sets))
    group = np.array([names.index(north_set.group) for north_set in solution.sets])
    swing_deg = 0.0 if method == LIKELIHOOD else math.sqrt(2.0) * solution.swing_deg
    about_deg, rows = np.zeros(len(group)), []
    for k, (item, _, head_deg, _) in enumerate(names):
        own = found & (group == k)
        if not own.any():
            continue
        first_deg = float(azimuths.azimuth_deg[own][0])
        beside_deg = wrapped_deg(azimuths.azimuth_deg[own] - first_deg)
        about_deg[own] = beside_deg - beside_deg.mean()
        if item == TEST:
            known_deg = float(solution.known_deg[own][0])
            times_s = [(each.begin_s + each.end_s) / 2.0 for each, use in zip(solution.sets, own, strict=True) if use]
            variance = azimuths.noise_deg**2 / own.sum() + swing_deg**2 + solution.tilted_deg**2 + LEAST_deg**2
            error_deg = float(wrapped_deg(first_deg + beside_deg.mean() - known_deg))
            rows.append((head_deg, float(np.mean(times_s)), error_deg, 1.0 / variance))
    heads_deg, middles_s, mean_deg, weights = np.array(rows, np.float64).reshape(-1, 4).T
    calibrated = method != LIKELIHOOD and bool(solution.calibrations)
    beside = (0.0 if calibrated else solution.site.azimuth_std_deg, solution.tilted_deg, swing_deg)
    return Errors(
        about_deg[found], group[found], heads_deg, middles_s, mean_deg, weights, azimuths.noise_deg,
        azimuths.dof, math.hypot(swing_deg, LEAST_deg), math.hypot(azimuths.common_deg, *beside),
        min(azimuths.dof, azimuths.common_dof), int(np.bincount(group[found]).max()),
    )  # fmt: skip


def f_test(squares: float, dof: int, variance: float, of_dof: float) -> tuple[float, float]:
    """Return a mean square over a variance that is known with ``of_dof``, and the chance of more in a right world."""
    ratio = squares / dof / variance if variance > 0.0 else 0.0
    return ratio, f_tail(ratio, dof, of_dof)


def t_test(value: float, std: float, dof: float) -> tuple[float, float]:
    """Return a value over its standard uncertainty, and the chance of more on either side."""
    score = abs(value) / std if std > 0.0 else 0.0
    return score, t_both(score, dof)
