"""Uncertainty budgets: named components with degrees of freedom, and what several results have in common.

Components that carry the same label in several budgets are one and the same error, so the results are correlated
through it, as all channels are through the one calibrator.
Source: JCGM 100:2008 sections 5.1, 5.2 and annex G.4 (Welch-Satterthwaite); JCGM 102:2011 section 6 (several results).

The mean of readings that follow each other closely: how many independent ones they are worth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bench.maths.arrays import Floats
from bench.maths.verdict import coverage_factor
from bench.model.errors import FitError

TYPE_A, TYPE_B = "A", "B"
FEWEST = 2.0  # two readings are needed for any scatter


@dataclass(frozen=True)
class Component:
    """One source of uncertainty of one result; the contribution is ``sensitivity * std_uncertainty``, signed.

    ``std_uncertainty`` in ``unit``; ``sensitivity`` in unit of the result over ``unit``. ``dof``: infinite for a type-B
    evaluation taken as exact. ``common``: label of the error itself; equal labels in several budgets are one error, ""
    is an error of this result alone.
    """

    name: str
    std_uncertainty: float
    unit: str = ""
    sensitivity: float = 1.0
    dof: float = math.inf
    evaluation: str = TYPE_B
    distribution: str = "normal"
    source: str = ""
    common: str = ""

    @property
    def contribution(self) -> float:
        """Signed contribution to the result, in the unit of the result."""
        return self.sensitivity * self.std_uncertainty


@dataclass(frozen=True)
class Budget:
    """Combined uncertainty of one result, in its unit; ``dof`` are the effective degrees of freedom."""

    components: tuple[Component, ...]
    std_uncertainty: float
    dof: float

    @cached_property
    def coverage_factor(self) -> float:
        """Two-sided 95 % factor of Student's t with the effective degrees of freedom."""
        return coverage_factor(self.dof)

    @property
    def expanded_uncertainty(self) -> float:
        """95 % expanded uncertainty, in the unit of the result."""
        return self.coverage_factor * self.std_uncertainty

    def share(self, component: Component) -> float:
        """Return part of the variance that a component brings, 0 to 1; 0 in a budget without any uncertainty."""
        return (component.contribution / self.std_uncertainty) ** 2 if self.std_uncertainty else 0.0


@dataclass(frozen=True)
class Budgets:
    """Budgets by name of the result, and the correlation (n, n) between the results in that order."""

    budgets: Mapping[str, Budget]
    correlation: Floats


def combine_all(results: Mapping[str, Sequence[Component]]) -> Budgets:
    """Return budgets of several results, with the correlation that their common components cause.

    Args:    results: components by name of the result; see ``Component.common``.
    Returns: Budgets; the correlation is 0 where a result has no uncertainty, its diagonal is 1.
    Raises:  FitError B-FIT-040 for a component that is negative, not finite or has no degrees of freedom, or for one
             error that has different degrees of freedom in two results.
    Source:  JCGM 100:2008 section 5.1, annex F.1.2.3, equation (G.2b); JCGM 102:2011 section 6.
    """
    dof: dict[str, float] = {}
    for name, components in results.items():
        _check_common(name, components, dof)
    budgets = {name: _budget(tuple(components)) for name, components in results.items()}
    return Budgets(budgets, _correlation(list(budgets.values())))


def effective_dof(variance: float, parts: Iterable[tuple[float, float]]) -> float:
    """Return the effective degrees of freedom of a combined variance.

    Args:    variance: of the result, all parts together.   parts: (variance, degrees of freedom) of independent parts;
             those with infinitely many may be left out.
    Returns: degrees of freedom, infinite if no part has finitely many.
    Source:  Welch and Satterthwaite, JCGM 100:2008 equation (G.2b).
    """
    spread = math.fsum(part**2 / dof for part, dof in parts)
    return variance**2 / spread if spread else math.inf


def _budget(components: tuple[Component, ...]) -> Budget:
    """Return the budget of independent errors; effective degrees of freedom after Welch and Satterthwaite."""
    variances = [component.contribution**2 for component in components]
    variance = math.fsum(variances)
    parts = zip(variances, (component.dof for component in components), strict=True)
    return Budget(components, math.sqrt(variance), effective_dof(variance, parts))


def _check_common(result: str, components: Sequence[Component], dof: dict[str, float]) -> None:
    """Refuse what cannot be combined; ``dof`` are the degrees of freedom of the common errors of all results so far."""
    seen: set[str] = set()
    for component in components:
        _check(result, component)
        if not (component.common and component.contribution):
            continue
        known = dof.setdefault(component.common, component.dof)
        if not math.isclose(known, component.dof, rel_tol=1e-12) or component.common in seen:
            raise _refused(result, component, "the same error stands there with other degrees of freedom, or twice")
        seen.add(component.common)


def _check(result: str, component: Component) -> None:
    numbers = (component.std_uncertainty, component.sensitivity)
    if not all(math.isfinite(number) for number in numbers) or component.std_uncertainty < 0:
        raise _refused(result, component, f"u = {component.std_uncertainty:g}, sensitivity = {component.sensitivity:g}")
    if not component.dof >= 1:
        raise _refused(result, component, f"{component.dof:g} degrees of freedom, at least 1 is due")


def _refused(result: str, component: Component, reason: str) -> FitError:
    return FitError(
        "B-FIT-040",
        f"component {component.name!r} of the uncertainty cannot be used: {reason}",
        where=result,
        next_step="correct the uncertainty in the standards register or in the campaign section",
    )


def _correlation(budgets: Sequence[Budget]) -> Floats:
    """Return correlation of results: what their common errors bring to the product of both."""
    matrix = np.eye(len(budgets))
    shared = [
        {part.common: part.contribution for part in budget.components if part.common and part.contribution}
        for budget in budgets
    ]
    for row, first in enumerate(budgets):
        for column, second in enumerate(budgets[:row]):
            both = shared[row].keys() & shared[column].keys()
            covariance = math.fsum(shared[row][name] * shared[column][name] for name in both)
            known = covariance / (first.std_uncertainty * second.std_uncertainty) if covariance else 0.0
            matrix[row, column] = matrix[column, row] = known
    return matrix


def independent_count(readings: Floats) -> float:
    """Return how many independent readings give a mean as certain as that of serially correlated ones.

    Args:    readings: (n,), at equal intervals, any unit.
    Returns: n / (1 + 2 sum (1 - k/n) r_k) with the estimated autocorrelation r_k at the lags k before it first falls
             to zero, so that noise of the estimate is not summed up; 2 at least, n at most, and n where nothing varies.
    Raises:  nothing.
    Source:  A. Zieba, Metrology and Measurement Systems 17 (2010) 3; A. Zieba, P. Ramza, ibid. 18 (2011) 529
             (first transit through zero).
    """
    n = readings.size
    if n <= FEWEST or np.ptp(readings) == 0.0:
        return float(n)
    off = readings - readings.mean()
    size = 1 << (2 * n - 1).bit_length()  # padded, so that the two ends are not correlated
    power = np.abs(np.fft.rfft(off, size)) ** 2
    correlation = np.fft.irfft(power, size)[:n]
    correlation /= correlation[0]
    stop = int(np.argmax(correlation <= 0.0))  # they sum up to -1/2, so one of them is negative
    lags = np.arange(1, stop)
    return float(np.clip(n / (1.0 + 2.0 * np.sum((1.0 - lags / n) * correlation[1:stop])), FEWEST, n))
