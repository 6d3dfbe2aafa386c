"""Tables of ``bench archive`` on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from bench.archive.changes import Changes
from bench.archive.page import FOLDER, head_of, sections_of
from bench.commands.console import headed_table
from bench.maths.verdict import verdict_words
from bench.model.texts import Texts

Row = Mapping[str, Any]
_WHOLE = {"session", "sha-256", "campaign", "number", "verdict", "state"}


def print_sessions(out: Console, rows: Sequence[Row]) -> None:
    """One line per session."""
    heads = ("session", "sha-256", "unit", "campaign", "verdict", "state", "in")
    out.print(headed_table(f"{len(rows)} sessions", heads, map(_session, rows), whole=_WHOLE))


def _session(row: Row) -> tuple[str, ...]:
    state = row["code"] or row["quality"] or "no results"
    return (
        row["session"],
        (row["session_sha256"] or "-")[:8],
        ", ".join(f"{unit['model']} {unit['serial']}" for unit in row["units"]) or "-",
        row["campaign"] or "-",
        verdict_words(row["verdict"]),
        f"{state} (SIMULATED)" if row["simulated"] else state,
        row["location"].rstrip("/").rpartition("/")[0],
    )


def print_certificates(out: Console, rows: Sequence[Row]) -> None:
    """One line per certificate."""
    heads = ("number", "unit", "customer", "session", "issued", "state")
    if rows:
        out.print(headed_table(f"{len(rows)} certificates", heads, map(_certificate, rows), whole=_WHOLE))


def _certificate(row: Row) -> tuple[str, ...]:
    state = ["specimen"] if row["specimen"] else []
    state += [f"replaced by {number}" for number in row["replaced_by"]]
    uut, issued = f"{row['uut_model']} {row['uut_serial']}", row["issued"] or "-"
    return row["number"], uut, row["customer"], row["session"], issued, ", ".join(state) or "valid"


def print_changes(out: Console, report: Changes, language: str) -> None:
    """Print the whole report as its page has it."""
    words = Texts(FOLDER, language)
    for line in head_of(report, words):
        out.print(line)
    for section in sections_of(report, words):
        for paragraph in section.paragraphs:
            out.print(paragraph)
        for table in section.tables:
            out.print(headed_table(table.caption, table.headers, table.rows, whole=table.headers[: table.stub]))
