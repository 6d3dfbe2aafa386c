"""Predicted and achieved uncertainties of a campaign, side by side: the prediction checks the chain, and the chain it.

Decision: docs/method-uncertainty.md.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from bench.analysis.estimates import Estimate
from bench.record import UNIT_TEMPERATURE

NOTED = 0.10  # of the predicted U: what differs by less is not worth a sentence
ORDINARY = 0.999  # of right predictions leave no sentence: a report has tens of estimates
MEASURED = (UNIT_TEMPERATURE, "hours")  # conditions that a run measures: a prediction has planned ones in their place
_MOST = 0.5  # of the growth of a variance: who brings more is named
_LEAST_SHARE = 1e-6  # of the variance achieved; below it nothing has grown

Name = tuple[str, str, int]


def by_foreseen_name(entries: Iterable[Estimate]) -> dict[Name, Estimate]:
    """Return estimates by what names them before the run as after it, in their order.

    It is the quantity, the conditions but measured ones, and which of several it is that these do not tell apart, such
    as repeats of one channel: analyses state those in the order of time.
    """
    named: dict[Name, Estimate] = {}
    seen: Counter[tuple[str, str]] = Counter()
    for entry in entries:
        conditions = {name: value for name, value in entry.conditions.items() if name not in MEASURED}
        own = entry.quantity, json.dumps(conditions, sort_keys=True, default=str)
        seen[own] += 1
        named[*own, seen[own]] = entry
    return named


@dataclass(frozen=True)
class Agreement:
    """An estimate that was predicted and achieved. ``ratio``: of its expanded uncertainties, achieved to predicted.

    ``grown``: label of the error that brings most of what the variance has grown by; "" where none is known to.
    """

    predicted: Estimate
    achieved: Estimate
    ratio: float
    grown: str

    @property
    def is_noted(self) -> bool:
        """Return whether the two differ by more than ``NOTED``, and by more than the achieved one is uncertain by."""
        low, high = _ordinary_ratios(self.achieved.dof or math.inf)
        return not low <= self.ratio <= high


def _ordinary_ratios(dof: float) -> tuple[float, float]:
    """Return the least and the largest ratio of an achieved to a predicted uncertainty that are no discrepancy.

    Args:    dof: degrees of freedom of the achieved one; infinite where it rests on nothing that was measured.
    Returns: both ends of a chi-square interval of the probability ``ORDINARY``, never nearer to 1 than ``NOTED``.
    Source:  s^2 dof / sigma^2 is a chi-square of so many degrees of freedom (NIST SP 1065 equation (45)).
    """
    if math.isinf(dof):
        return 1.0 - NOTED, 1.0 + NOTED
    from scipy import special  # no run reads this, and its rooms load this package

    tail = (1.0 - ORDINARY) / 2.0
    low, high = (math.sqrt(float(special.chdtri(dof, above)) / dof) for above in (1.0 - tail, tail))
    return min(low, 1.0 - NOTED), max(high, 1.0 + NOTED)


def agreements(predicted: Iterable[Estimate], achieved: Iterable[Estimate]) -> list[Agreement]:
    """Return the estimates that have an expanded uncertainty in both, in the order in which they were predicted."""
    found = by_foreseen_name(achieved)
    pairs = ((entry, found.get(name)) for name, entry in by_foreseen_name(predicted).items())
    return [
        Agreement(before, after, after.expanded_uncertainty / before.expanded_uncertainty, _grown(before, after))
        for before, after in pairs
        if after and before.expanded_uncertainty and after.expanded_uncertainty
    ]


def _grown(before: Estimate, after: Estimate) -> str:
    """Return the label of the common error whose variance has grown by most of what the whole variance has."""
    growth = after.std_uncertainty**2 - before.std_uncertainty**2
    if growth <= _LEAST_SHARE * after.std_uncertainty**2:
        return ""
    known = _parts(before)
    grown = {label: part**2 - known.get(label, 0.0) ** 2 for label, part in _parts(after).items()}
    label = max(grown, key=lambda name: grown[name], default="")
    return label if label and grown[label] > _MOST * growth else ""


def _parts(entry: Estimate) -> dict[str, float]:
    return {} if entry.common is None else entry.common.standards | entry.common.campaign


def expected_at_end(so_far: float, predicted_so_far: float, predicted: float) -> float:
    """Return the uncertainty that an estimate will have at the end of a run.

    It falls in the proportion in which the prediction does with the records that are to come. Where the prediction only
    rises, for a drift over a longer time, they do not concern the estimate itself: what it has beyond the prediction
    stays and is independent of the rise. Where nothing more comes, it is what it is.

    Args: so_far: of the records that there are.   predicted_so_far: by a prediction of these alone.
          predicted: of all records. All in one unit, all standard or all expanded, none 0.
    """
    if predicted_so_far < min(so_far, predicted):
        return math.sqrt(so_far**2 + predicted**2 - predicted_so_far**2)
    return so_far * predicted / predicted_so_far
