"""Uncertainty budgets as tables of the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bench.analysis import Table, number, significant, with_uncertainty
from bench.maths.arrays import Floats
from bench.maths.budget import Budget
from bench.systems.af_converter.wording import say

_HEADERS = ("component", "u", "unit", "sensitivity", "contribution", "share", "dof", "type", "distribution", "source")


def budget_table(title: str, unit: str, value: float, budget: Budget) -> Table:
    """Return one budget: a row per component that contributes, then the combined uncertainty; ``value`` in ``unit``."""
    rows = [
        [
            component.name,
            figures(component.std_uncertainty),
            component.unit or unit,
            figures(component.sensitivity),
            figures(component.contribution),
            f"{100.0 * budget.share(component):.2f} %",
            dof_text(component.dof),
            component.evaluation,
            say(f"budget.{component.distribution}"),
            component.source,
        ]
        for component in budget.components
        if component.contribution
    ]
    rows.append(
        [say("component.combined"), "", unit, "", figures(budget.std_uncertainty), "", dof_text(budget.dof), "", "", ""]
    )
    stated = with_uncertainty(value, budget.expanded_uncertainty)
    caption = say("budget.caption", value=stated, unit=unit, k=f"{budget.coverage_factor:.2f}")
    return Table(title, caption, say.heads("budget", *_HEADERS), rows)


def correlation_table(title: str, caption: str, names: Sequence[str], matrix: Floats) -> Table:
    """Correlation between results, both ways by name; three decimals, but 1 for a result with itself alone."""
    rows = [
        [name, *(_correlation(float(matrix[row, column]), row == column) for column in range(len(names)))]
        for row, name in enumerate(names)
    ]
    return Table(title, caption, ["", *names], rows)


def summary_table(title: str, unit: str, budgets: Mapping[str, Budget], kinds: Mapping[str, str]) -> Table:
    """Contributions of the budgets of all channels side by side, components summed by kind.

    ``kinds``: kind of component by its name, in the order of the columns; all others are left to the combined value.
    """
    columns = list(dict.fromkeys(kinds.values()))
    rows = []
    for name, budget in budgets.items():
        sums = dict.fromkeys(columns, 0.0)
        for component in budget.components:
            if component.name in kinds:
                sums[kinds[component.name]] += component.contribution**2
        ends = [significant(budget.std_uncertainty), dof_text(budget.dof), f"{budget.coverage_factor:.2f}"]
        parts = [significant(math.sqrt(sums[column])) for column in columns]
        rows.append([name, *parts, *ends, significant(budget.expanded_uncertainty)])
    headers = [say("budget.head.channel"), *columns, "u", say("budget.head.dof"), "k", "U"]
    return Table(title, say("summary.caption", unit=unit), headers, rows)


def figures(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits: one more than a result has, so that sums can be checked."""
    return number(float(f"{value:.{digits}g}"))


def dof_text(dof: float) -> str:
    """Degrees of freedom: rounded down, as a coverage factor may only become larger by it; the sign for infinity."""
    return "∞" if math.isinf(dof) or dof >= 1e6 else f"{math.floor(dof)}"


def _correlation(value: float, own: bool) -> str:
    return "1" if own else f"{math.copysign(min(abs(value), 0.999), value):.3f}".replace("-", "−")
