"""Uncertainty budgets as tables of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.maths.budget import Budget

Table = dict[str, Any]
_HEADERS = ("component", "u", "unit", "sensitivity", "contribution", "share", "dof", "type", "distribution", "source")


def budget_table(title: str, unit: str, value: float, budget: Budget) -> Table:
    """One budget: a row per component that contributes, then the combined uncertainty; ``value`` in ``unit``."""
    rows = [
        [
            one.name,
            figures(one.std_uncertainty),
            one.unit or unit,
            figures(one.sensitivity),
            figures(one.contribution),
            f"{100.0 * budget.share(one):.2f} %",
            dof_text(one.dof),
            one.evaluation,
            one.distribution,
            one.source,
        ]
        for one in budget.components
        if one.contribution
    ]
    rows.append(["combined", "", unit, "", figures(budget.std_uncertainty), "", dof_text(budget.dof), "", "", ""])
    caption = (
        f"Value {figures(value, 7)} {unit}, U = {figures(budget.expanded_uncertainty)} {unit} "
        f"(k = {budget.coverage_factor:.3f}, 95 %). Sensitivity and contribution in {unit} per unit and in {unit}; "
        "degrees of freedom by Welch-Satterthwaite"
    )
    return {"title": title, "caption": caption, "headers": list(_HEADERS), "rows": rows}


def correlation_table(title: str, caption: str, names: Sequence[str], matrix: NDArray[np.float64]) -> Table:
    """Correlation between results, both ways by name; three decimals, but 1 for a result with itself alone."""
    rows = [
        [name, *(_correlation(float(matrix[row, column]), row == column) for column in range(len(names)))]
        for row, name in enumerate(names)
    ]
    return {"title": title, "caption": caption, "headers": ["", *names], "rows": rows}


def summary_table(title: str, unit: str, budgets: Mapping[str, Budget], kinds: Mapping[str, str]) -> Table:
    """Contributions of all budgets side by side, components summed by kind.

    ``kinds``: kind of component by its name, in the order of the columns; all others are left to the combined value.
    """
    columns = list(dict.fromkeys(kinds.values()))
    rows = []
    for name, budget in budgets.items():
        sums = dict.fromkeys(columns, 0.0)
        for one in budget.components:
            if one.name in kinds:
                sums[kinds[one.name]] += one.contribution**2
        ends = [figures(budget.std_uncertainty), dof_text(budget.dof), f"{budget.coverage_factor:.3f}"]
        parts = [figures(math.sqrt(sums[column])) for column in columns]
        rows.append([name, *parts, *ends, figures(budget.expanded_uncertainty)])
    caption = f"Standard contributions, combined u and U (95 %), all in {unit}"
    return {"title": title, "caption": caption, "headers": ["", *columns, "u", "dof", "k", "U"], "rows": rows}


def figures(value: float, digits: int = 4) -> str:
    """A number with so many significant digits, with a real minus sign."""
    return f"{value:.{digits}g}".replace("-", "−")


def dof_text(dof: float) -> str:
    """Degrees of freedom: rounded down, as a coverage factor may only become larger by it; the sign for infinity."""
    return "∞" if math.isinf(dof) or dof >= 1e6 else f"{math.floor(dof)}"


def _correlation(value: float, own: bool) -> str:
    return "1" if own else f"{math.copysign(min(abs(value), 0.999), value):.3f}".replace("-", "−")
