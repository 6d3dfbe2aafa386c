"""``bench archive changes``: the report on a refit."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from bench.archive.changes import changes_of
from bench.archive.evidence import evidence_of
from bench.archive.journal import HEAD
from bench.archive.page import FOLDER, changes_html
from bench.commands.archive import tables
from bench.commands.console import console, print_sorted_json, say
from bench.model.errors import ExitStatus
from bench.model.texts import check_language
from bench.session.output import write_file
from bench.store import Selection, list_sessions, read_trial


def changes(url: str, trial: str, html: Path | None, language: str, as_json: bool) -> int:
    """Print what a trial would change; ``html``: write it as a page too, in a language.

    Raises: StoreError B-STORE-009 for another trial; InputError B-TXT-001, B-CLI-007, B-PKG-005.
    """
    check_language(language, FOLDER)
    stored = read_trial(url, _named(trial))
    rows = list_sessions(url, Selection())
    sessions = {row["session_sha256"] or row["location"]: row for row in rows}
    report = changes_of(stored, sessions, evidence_of(url, rows, stored.trial.register))
    if html is not None:
        write_file(html, changes_html(report, language))
    if as_json:
        print_sorted_json(report.as_json())
    else:
        tables.print_changes(console(), report)
        if html is not None:
            say(f"wrote    {html}")
    return ExitStatus.PASS


def _named(trial: str) -> str:
    """Return the name of a trial; its folder stands for it."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        return str(json.loads(Path(trial, HEAD).read_bytes())["name"])
    return trial
