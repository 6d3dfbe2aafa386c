"""Standards and instruments: which certificates counted at the time of the run, and what the instruments said."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import date
from typing import Any

from bench.analysis import cell, number
from bench.model.texts import Texts
from bench.report.model import ReportModel
from bench.report.tables import Table, documents_table, rank

_HEADERS = ("role", "model", "serial", "certificate", "calibrated", "due", "days_left", "corrections")


def standards_table(model: ReportModel, words: Texts) -> Table | None:
    """The standards register: which instrument, which certificate, until when, which corrections were applied."""
    rows = tuple(
        (
            role,
            cell(entry.get("model", entry.get("driver"))),
            cell(entry.get("serial")),
            cell(entry.get("certificate")),
            cell(entry.get("calibrated")),
            cell(entry.get("due")),
            _days_left(words, model, entry),
            _corrections(words, entry.get("corrections") or ()),
        )
        for role, entry in sorted(model.standards.items())
    )
    headers = tuple(words(f"column.{name}") for name in _HEADERS)
    return Table(words("standards.table"), headers, rows, prose=True) if rows else None


def _days_left(words: Texts, model: ReportModel, entry: Mapping[str, Any]) -> str:
    """Days from the start of the run to the due date, in words if there are none; a dash if either is unknown."""
    try:
        days = (date.fromisoformat(str(entry.get("due"))) - date.fromisoformat(model.started_utc[:10])).days
    except ValueError:
        return "–"
    return number(days) if days >= 0 else words("standards.overdue", days=number(-days))


def _corrections(words: Texts, corrections: Iterable[Mapping[str, Any]]) -> str:
    """Corrections that change a number; a register full of zeros reads "none"."""
    applied = [one for one in corrections if any(value for name, value in one.items() if not name.startswith("range"))]
    texts = (cell(dict(sorted(one.items(), key=lambda item: rank(item[0])))) for one in applied)
    return "; ".join(texts) or words("none")


def identities_table(model: ReportModel, words: Texts) -> Table | None:
    """Return what the instruments answered to the question who they are."""
    found = [{"role": role, **identity} for role, identity in sorted(model.identities.items())]
    return documents_table(words, words("identities.table"), found)
