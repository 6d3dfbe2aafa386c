"""Uncertainty budgets: named components with degrees of freedom, and what several results have in common.

Components that carry the same label in several budgets are one and the same error, so the results are correlated
through it, as all channels are through the one calibrator.
Source: JCGM 100:2008 sections 5.1, 5.2 and annex G.4 (Welch-Satterthwaite); JCGM 102:2011 section 6 (several results);
for the check by Monte Carlo JCGM 101:2008 sections 7.5 to 7.7 (method), 7.9.2 (tolerance) and 8.1 (validation).

The mean of readings that follow each other closely: how many independent ones they are worth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

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


Draw = Callable[[np.random.Generator, int], Floats]  # (generator, trials) -> values of the result, (trials,)
Statement = Literal["agrees", "not resolved", "differs"]
BLOCK = 10_000  # trials: at least 100 / (1 - p), JCGM 101:2008 section 7.9.4
_PROBABILITY = 0.95
_NEARLY = 1.05


@dataclass(frozen=True)
class Distribution:
    """Result of Monte Carlo trials, in the unit of the result; ``low`` and ``high`` bound the shortest 95 % interval.

    The numerical standard deviations of the two ends come from the scatter of blocks of trials.
    """

    mean: float
    std: float
    low: float
    high: float
    trials: int
    low_numerical_std: float
    high_numerical_std: float


@dataclass(frozen=True)
class Check:
    """Comparison of the interval of a budget with that of the trials.

    ``statement``: "agrees" if both ends differ by no more than ``tolerance``, "differs" if an end differs by more than
    that and twice its numerical standard deviation, else "not resolved": more trials would be due.
    """

    low_difference: float
    high_difference: float
    tolerance: float
    statement: Statement


def shortest_interval(values: Floats) -> tuple[float, float]:
    """Return shortest interval that holds 95 % of the trials.

    The smallest of all lengths settles only with the cube root of the number of trials, because near it they hardly
    differ. So a parabola through all lengths that are at most 5 % longer says where the shortest one begins; its ends
    settle with the square root. For a skewed distribution the interval is up to 0.1 % longer than the shortest.

    Args:    values: (n,), any order.
    Returns: lower and upper end, both of them trials.
    Raises:  ValueError for fewer trials than one beyond the interval.
    Source:  JCGM 101:2008 section 7.7.
    """
    ordered = np.sort(values)
    held = int(_PROBABILITY * ordered.size + 0.5)
    if held >= ordered.size:
        raise ValueError(f"{ordered.size} trials do not give an interval of {_PROBABILITY:g}")
    first = _lowest(ordered[held:] - ordered[: ordered.size - held])
    return float(ordered[first]), float(ordered[first + held])


def _lowest(lengths: Floats) -> int:
    """Place of the vertex of a parabola through the small lengths; of the smallest one where there is no vertex."""
    smallest = int(np.argmin(lengths))
    near = np.flatnonzero(lengths <= _NEARLY * lengths[smallest])
    reach = max(int(np.abs(near - smallest).max()), 1)
    if near.size < 3:
        return smallest
    _, slope, curvature = np.polynomial.polynomial.polyfit((near - smallest) / reach, lengths[near], 2)
    if curvature <= 0:
        return smallest
    return int(np.clip(round(smallest - reach * slope / (2.0 * curvature)), near[0], near[-1]))


def numerical_tolerance(std: float, digits: int = 2) -> float:
    """Return half a unit in the last of the significant digits of a standard uncertainty.

    Args:    std: standard uncertainty, > 0.   digits: significant digits that count.
    Returns: tolerance in the unit of ``std``.
    Raises:  ValueError for a standard uncertainty that is not positive.
    Source:  JCGM 101:2008 section 7.9.2.
    """
    if not std > 0:
        raise ValueError(f"a standard uncertainty of {std:g} has no digits")
    exponent = int(f"{std:.{digits - 1}e}".split("e")[1])  # of the rounded number: 9.96 has the digits 10
    return 0.5 * 10.0 ** (exponent - digits + 1)


def propagate(draw: Draw, seed: int, trials: int) -> Distribution:
    """Fixed number of trials.

    Args:    draw: the model; gets a seeded generator and the number of trials, returns values (n,).
             seed: the same seed gives the same numbers.   trials: at least two blocks of 10,000, rounded up to blocks.
    Returns: Distribution over all trials.
    Raises:  nothing of its own.
    Source:  JCGM 101:2008 sections 7.2 to 7.7.
    """
    generator = np.random.default_rng(seed)
    blocks = [draw(generator, BLOCK) for _ in range(max(2, math.ceil(trials / BLOCK)))]
    return _summary(blocks)


def check_interval(value: float, std: float, expanded: float, distribution: Distribution, digits: int = 2) -> Check:
    """Compare value +- U of a budget with the shortest interval of the trials.

    Args:    value, std, expanded: result, standard and expanded uncertainty of the budget.   found: the trials.
             digits: significant digits of ``std`` that must hold.
    Returns: Check.
    Raises:  ValueError for a standard uncertainty that is not positive.
    Source:  JCGM 101:2008 section 8.1.
    """
    low, high = abs(value - expanded - distribution.low), abs(value + expanded - distribution.high)
    tolerance = numerical_tolerance(std, digits)
    ends = ((low, distribution.low_numerical_std), (high, distribution.high_numerical_std))
    statement: Statement = "not resolved"
    if low <= tolerance and high <= tolerance:
        statement = "agrees"
    elif any(difference > tolerance + 2.0 * noise for difference, noise in ends):
        statement = "differs"
    return Check(low, high, tolerance, statement)


def _summary(blocks: list[Floats]) -> Distribution:
    ends = np.array([shortest_interval(block) for block in blocks])
    noise = np.std(ends, axis=0, ddof=1) / math.sqrt(len(blocks))
    values = np.concatenate(blocks)
    low, high = shortest_interval(values)
    return Distribution(
        mean=float(np.mean(values)),
        std=float(np.std(values, ddof=1)),
        low=low,
        high=high,
        trials=values.size,
        low_numerical_std=float(noise[0]),
        high_numerical_std=float(noise[1]),
    )
