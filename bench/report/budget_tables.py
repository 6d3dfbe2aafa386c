"""The components of the stated uncertainties, largest value per kind of channel."""

from __future__ import annotations

from bench.model.texts import Texts
from bench.report.model import ReportModel
from bench.report.tables import Table, documents_table


def components_table(model: ReportModel, words: Texts) -> Table | None:
    """Components with three significant digits: more of an uncertainty says nothing."""
    rounded = [
        {name: float(f"{value:.3g}") if isinstance(value, float) else value for name, value in one.items()}
        for one in model.components
    ]
    return documents_table(words, words("components.table"), rounded)
