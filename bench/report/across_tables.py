"""Tables of estimates that belong to no channel: what they are down, units or axes across."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import unit_text
from bench.model.texts import Texts
from bench.report.estimate_tables import conditions_text, pivot_of, readable, value_text, without_channel
from bench.report.model import ReportModel
from bench.report.tables import Table

_MOST_ACROSS = 3  # units side by side that a page has room for
_CAPTIONS = {"unit": "others.by_unit", "column": "others.by_axis", "axis": "others.by_axis"}
Row = Mapping[str, Any]


def across_tables(model: ReportModel, words: Texts) -> list[Table]:
    """Units or axes across, one table for each three of them; () if no estimate has such a condition."""
    found: dict[str, list[Row]] = {}
    for row in without_channel(model):
        if (name := pivot_of(row)) is not None:
            found.setdefault(_CAPTIONS[name], []).append(row)
    return [table for caption, rows in found.items() for table in _tables(words, caption, rows)]


def _tables(words: Texts, caption: str, rows: Sequence[Row]) -> list[Table]:
    names = list(dict.fromkeys(_across(row) for row in rows))
    parts = [names[start : start + _MOST_ACROSS] for start in range(0, len(names), _MOST_ACROSS)]
    return [_table(words, words(caption), [row for row in rows if _across(row) in part], part) for part in parts]


def _table(words: Texts, caption: str, rows: Sequence[Row], names: Sequence[str]) -> Table:
    lines: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        rest = {name: value for name, value in row["conditions"].items() if name != pivot_of(row)}
        lines.setdefault((row["quantity"], conditions_text(words, rest)), []).append(row)
    body = []
    for (quantity, where), found in lines.items():
        scale, unit = readable(found)
        by_name = {_across(row): value_text(row, scale) for row in found}
        body.append((quantity, where or "–", unit_text(unit), *(by_name.get(name, "–") for name in names)))
    headers = (words("column.quantity"), words("column.conditions"), words("column.unit"), *names)
    return Table(caption, headers, tuple(body), stub=3)


def _across(row: Row) -> str:
    return str(row["conditions"][str(pivot_of(row))])
