"""What an analysis states, for tests of the AF converter and of north: the one place that knows its form."""

from __future__ import annotations

from typing import Any

from bench.analysis import Analysis, Table


def entries_of(analysis: Analysis, *quantities: str, **conditions: Any) -> list[dict[str, Any]]:
    """Return the estimates of some quantities where these conditions hold."""
    wanted = conditions.items()
    return [
        entry for entry in analysis.estimates
        if entry.quantity in quantities and wanted <= entry.conditions.items()
    ]  # fmt: skip


def entry_of(analysis: Analysis, quantity: str, **conditions: Any) -> dict[str, Any]:
    """Return the only estimate of a quantity where these conditions hold."""
    (entry,) = entries_of(analysis, quantity, **conditions)
    return entry


def score(entry: dict[str, Any], truth: float) -> float:
    """Return the error of an estimate in its standard uncertainty."""
    return float((entry.value - truth) / entry.std_uncertainty)


def holds(entry: dict[str, Any], truth: float) -> bool:
    """Return whether the interval of an estimate holds the truth."""
    return bool(abs(entry.value - truth) <= entry.expanded_uncertainty)


def table_of(analysis: Analysis, title: str) -> Table:
    """Return the only table with this in its title."""
    (table,) = (table for table in analysis.tables if title in table.title)
    return table
