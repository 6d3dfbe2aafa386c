"""``bench archive list``, ``where`` and ``changes``: what the archive knows."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.archive.changes import changes_of
from bench.archive.evidence import evidence_of
from bench.archive.journal import HEAD
from bench.archive.page import FOLDER, changes_html
from bench.commands.archive import tables
from bench.commands.console import console, print_sorted_json, say
from bench.commands.requests import Place
from bench.model.texts import check_language
from bench.session.output import write_file, writing
from bench.store import (
    Selection,
    certificate_document,
    check_form,
    columns_of,
    dependents,
    list_sessions,
    read_trial,
    selection_of,
    session_document,
    write_rows,
)

COLUMNS = columns_of(
    (
        "session", "session_sha256", "location", "started_utc", "campaign", "station", "units", "standards",
        "simulated", "verdict", "quality", "method", "software", "plan_sha256", "frame_sha256", "bytes", "code",
        "fault", "verified_utc",
    ),
    simulated="bool", bytes="int64",
)  # fmt: skip


def list_all(select: Sequence[str] | None, to: Path | None, place: Place, as_json: bool) -> None:
    """Print or write one line per session."""
    if to is not None:
        check_form(to)
    documents = [session_document(row) for row in list_sessions(place.of(), selection_of(select or ()))]
    if to is not None:
        with writing(to):
            count = write_rows(to, COLUMNS, map(_flat, documents))
        if as_json:
            print_sorted_json({"file": str(to), "rows": count})
        else:
            say(f"{count} sessions written to {to}")
    elif as_json:
        print_sorted_json({"sessions": documents})
    else:
        tables.print_sessions(console(), documents)


def where(word: str, place: Place, as_json: bool) -> None:
    """Print what depends on a word."""
    found = dependents(place.of(), word)
    sessions = [session_document(row) for row in found.sessions]
    issued = [certificate_document(row) for row in found.certificates]
    if as_json:
        print_sorted_json({"word": word, "kinds": list(found.kinds), "sessions": sessions, "certificates": issued})
        return
    out = console()
    out.print(f"{word}: {', '.join(found.kinds) or 'named by certificates only'}")
    tables.print_sessions(out, sessions)
    tables.print_certificates(out, issued)


def _flat(document: dict[str, Any]) -> dict[str, Any]:
    """Return a session as one row: units by model and serial number, standards with their certificates too."""
    units = [f"{unit['model']} {unit['serial']}" for unit in document["units"]]
    standards = [f"{used['model']} {used['serial']} {used['certificate']}" for used in document["standards"]]
    return {**document, "units": ", ".join(units), "standards": ", ".join(standards)}


def changes(trial: str, html: Path | None, language: str, place: Place, as_json: bool) -> None:
    """Print what a trial would change; ``html``: write it as a page too, in a language.

    Raises: StoreError B-STORE-009 for another trial; InputError B-TXT-001, B-CLI-007, B-PKG-005.
    """
    check_language(language, FOLDER)
    url = place.of()
    stored = read_trial(url, _named(trial))
    rows = list_sessions(url, Selection())
    sessions = {row["session_sha256"] or row["location"]: row for row in rows}
    report = changes_of(stored, sessions, evidence_of(url, rows, stored.trial.register))
    if html is not None:
        write_file(html, changes_html(report, language))
    if as_json:
        print_sorted_json(report.as_json())
    else:
        tables.print_changes(console(), report, language)
        if html is not None:
            say(f"wrote    {html}")


def _named(trial: str) -> str:
    """Return the name of a trial; its folder stands for it."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        return str(json.loads(Path(trial, HEAD).read_bytes())["name"])
    return trial
