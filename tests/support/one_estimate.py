"""The one estimate of a quantity under some conditions, from what an analysis, a prediction or a document gives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bench.analysis.estimates import Estimate


def every(found: Any, quantity: str, **conditions: Any) -> list[Estimate]:
    """Return all estimates of a quantity with these conditions; ``found``: estimates, what has
    them, or documents of them, such as truths.
    """
    given: Iterable[Any] = found["estimates"] if isinstance(found, Mapping) else getattr(found, "estimates", found)
    estimates = [Estimate.model_construct(**entry) if isinstance(entry, Mapping) else entry for entry in given]
    return [
        entry for entry in estimates if entry.quantity == quantity and conditions.items() <= entry.conditions.items()
    ]


def one(found: Any, quantity: str, **conditions: Any) -> Estimate:
    """Return the only estimate of a quantity with these conditions. Raises: ValueError if there are none or several."""
    (entry,) = every(found, quantity, **conditions)
    return entry


def value(found: Any, quantity: str, **conditions: Any) -> float:
    """Return the value of the only estimate of a quantity with these conditions."""
    return float(one(found, quantity, **conditions).value)
