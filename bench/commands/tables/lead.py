"""The tables of an analysis that are read first, on a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from bench import analysis
from bench.report import Table, analysis_tables

_MOST_ROWS = 24
_NOT_TESTED = "not tested"
_VERDICTS = {"PASS": "green", "FAIL": "bold red", "CONDITIONAL FAIL": "bold red"}
_HOLD = ("\u00a0", "\u202f")  # a log or a terminal without them shows something else


def lead_tables(tables: Sequence[analysis.Table]) -> list[analysis.Table]:
    """Return the tables that are read first."""
    return [table for table in tables if table.lead]


def print_lead_tables(out: Console, tables: Sequence[analysis.Table]) -> None:
    """Print them in their order; rows that end in "not tested" are counted, not shown; the report has them all."""
    for described, table in zip(tables, analysis_tables(tables), strict=True):
        rows = [row for row in table.rows if row[-1] != _NOT_TESTED]
        if rows or not table.rows:
            _print(out, described.title, table, rows[:_MOST_ROWS])
        _say_left_out(out, described.title, len(table.rows) - len(rows), len(rows) - _MOST_ROWS)


def _say_left_out(out: Console, title: str, not_tested: int, more: int) -> None:
    if not_tested:
        out.print(f"{title}: {not_tested} rows not tested", highlight=False)
    if more > 0:
        out.print(f"{title}: {more} more rows in the report", highlight=False)


def _print(out: Console, title: str, table: Table, rows: Sequence[tuple[str, ...]]) -> None:
    shown = TerminalTable(title=title, box=box.SIMPLE, title_justify="left", collapse_padding=True, pad_edge=False)
    for index, text in enumerate(table.headers):
        left = table.prose or index < table.stub
        whole = None if table.prose else max((len(row[index]) for row in rows), default=1)  # a value is not broken
        shown.add_column(_plain(text), justify="left" if left else "right", overflow="fold", min_width=whole)
    for row in rows:
        shown.add_row(*(Text(_plain(text), style=_VERDICTS.get(text, "")) for text in row))
    out.print(shown, highlight=False)


def _plain(text: str) -> str:
    for one in _HOLD:
        text = text.replace(one, " ")
    return text
