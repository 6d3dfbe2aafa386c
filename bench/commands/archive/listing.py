"""``bench archive list``, ``where`` and ``changes``: what the archive knows."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.archive.changes import Changes, changes_of
from bench.archive.evidence import evidence_of
from bench.archive.journal import HEAD
from bench.archive.page import FOLDER, changes_html, head_of, sections_of
from bench.commands.console import console, headed_table, print_sorted_json, say
from bench.commands.requests import Place
from bench.maths.verdict import verdict_words
from bench.model.texts import Texts, check_language
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

Row = Mapping[str, Any]
_WHOLE = {"session", "sha-256", "campaign", "number", "verdict", "state"}
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
        print_sessions(console(), documents)


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
    print_sessions(out, sessions)
    print_certificates(out, issued)


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
        print_sorted_json(asdict(report))
    else:
        print_changes(console(), report, language)
        if html is not None:
            say(f"wrote    {html}")


def _named(trial: str) -> str:
    """Return the name of a trial; its folder stands for it."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        return str(json.loads(Path(trial, HEAD).read_bytes())["name"])
    return trial


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
