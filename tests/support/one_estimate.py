"""The one estimate of a quantity under some conditions, from what an analysis, a prediction or a document gives."""

from collections.abc import Iterable, Mapping
from typing import Any

from bench.analysis import Analysis, Estimate, Table


def every(found: Any, *quantities: str, **conditions: Any) -> list[Estimate]:
    """Return all estimates of some quantities with these conditions; ``found``: estimates, what has
    them, or documents of them, such as truths.
    """
    given: Iterable[Any] = found["estimates"] if isinstance(found, Mapping) else getattr(found, "estimates", found)
    estimates = [Estimate.model_construct(**entry) if isinstance(entry, Mapping) else entry for entry in given]
    return [
        entry for entry in estimates if entry.quantity in quantities and conditions.items() <= entry.conditions.items()
    ]


def one(found: Any, quantity: str, **conditions: Any) -> Estimate:
    """Return the only estimate of a quantity with these conditions. Raises: ValueError if there are none or several."""
    (entry,) = every(found, quantity, **conditions)
    return entry


def value(found: Any, quantity: str, **conditions: Any) -> float:
    """Return the value of the only estimate of a quantity with these conditions."""
    return float(one(found, quantity, **conditions).value)


def score(entry: Estimate, truth: float) -> float:
    """Return the error of an estimate in its standard uncertainty."""
    return float((entry.value - truth) / entry.std_uncertainty)


def holds(entry: Estimate, truth: float) -> bool:
    """Return whether the interval of an estimate holds the truth."""
    return bool(abs(entry.value - truth) <= entry.expanded_uncertainty)


def table_of(analysis: Analysis, title: str) -> Table:
    """Return the only table with this in its title."""
    (table,) = (table for table in analysis.tables if title in table.title)
    return table
