"""``bench archive list`` and ``where``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.archive.selecting import selection_of
from bench.commands.archive import tables
from bench.commands.console import console, print_sorted_json, say
from bench.model.errors import ExitStatus
from bench.session.output import writing
from bench.store import certificate_document, check_form, dependents, list_sessions, session_document, write_rows

COLUMNS = (
    ("session", "string"), ("session_sha256", "string"), ("location", "string"), ("started_utc", "string"),
    ("campaign", "string"), ("station", "string"), ("units", "string"), ("standards", "string"), ("simulated", "bool"),
    ("verdict", "string"), ("quality", "string"), ("method", "string"), ("software", "string"),
    ("plan_sha256", "string"), ("frame_sha256", "string"), ("bytes", "int64"), ("code", "string"), ("fault", "string"),
    ("verified_utc", "string"),
)  # fmt: skip


def list_all(url: str, select: Sequence[str], to: Path | None, as_json: bool) -> int:
    """Print or write one line per session."""
    if to is not None:
        check_form(to)
    documents = [session_document(row) for row in list_sessions(url, selection_of(select))]
    if to is not None:
        with writing(to):
            count = write_rows(to, COLUMNS, map(_flat, documents))
        if as_json:
            return print_sorted_json({"file": str(to), "rows": count})
        say(f"{count} sessions written to {to}")
        return ExitStatus.PASS
    if as_json:
        return print_sorted_json({"sessions": documents})
    tables.print_sessions(console(), documents)
    return ExitStatus.PASS


def where(url: str, word: str, as_json: bool) -> int:
    """Print what depends on a word."""
    found = dependents(url, word)
    sessions = [session_document(row) for row in found.sessions]
    issued = [certificate_document(row) for row in found.certificates]
    if as_json:
        return print_sorted_json(
            {"word": word, "kinds": list(found.kinds), "sessions": sessions, "certificates": issued}
        )
    out = console()
    out.print(f"{word}: {', '.join(found.kinds) or 'named by certificates only'}")
    tables.print_sessions(out, sessions)
    tables.print_certificates(out, issued)
    return ExitStatus.PASS


def _flat(document: dict[str, Any]) -> dict[str, Any]:
    """Return a session as one row: units by model and serial number, standards with their certificates too."""
    units = [f"{unit['model']} {unit['serial']}" for unit in document["units"]]
    standards = [f"{used['model']} {used['serial']} {used['certificate']}" for used in document["standards"]]
    return {**document, "units": ", ".join(units), "standards": ", ".join(standards)}
