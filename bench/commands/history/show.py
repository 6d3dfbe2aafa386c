"""``bench history``: what earlier calibrations of a unit were, how it drifts, when it is due."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from bench.commands.console import console, print_sorted_json, say
from bench.commands.history import tables
from bench.commands.requests import Place, Wanted
from bench.model.clock import WallClock
from bench.model.errors import ExitStatus, InputError
from bench.session.output import writing
from bench.store import (
    Filters,
    approve,
    compare_pair,
    compare_unit,
    digest_of_file,
    dues_of,
    export_history,
    list_calibrations,
    show_calibration,
    units_of,
)


def list_all(wanted: Wanted, place: Place, as_json: bool) -> None:
    """Return one line per calibration."""
    rows = list_calibrations(place.of(), wanted.filters)
    if as_json:
        print_sorted_json({"calibrations": rows})
    else:
        tables.print_listing(console(), rows)


def show(session: str, place: Place, as_json: bool) -> None:
    """Return everything about one calibration."""
    shown = show_calibration(place.of([session]), named(session))
    if as_json:
        print_sorted_json(shown.as_json())
    else:
        tables.print_shown(console(), shown)


def compare(
    sessions: list[str] | None, wanted: Wanted, plot: Path | None, max_interval: int, place: Place, as_json: bool
) -> None:
    """Return two calibrations against each other, or all of a unit."""
    url, filters = place.of(sessions or ()), wanted.filters
    if sessions:
        if len(sessions) != 2 or plot is not None or filters != Filters():
            raise InputError(
                "B-CLI-011",
                "compare takes two sessions and no filter, or no session; --plot needs all calibrations of a unit",
                where="bench history compare",
                next_step="for example: bench history compare --uut SERIAL --plot drift.svg",
            )
        pair = compare_pair(url, named(sessions[0]), named(sessions[1]))
        if as_json:
            print_sorted_json(pair)
        else:
            tables.print_pair(console(), pair)
        return
    comparison = compare_unit(url, filters)
    due = dues_of(comparison, max_interval)
    if plot is not None:
        from bench.commands.history.plots import draw  # matplotlib takes longer to load than the comparison itself

        draw(comparison, plot)
    if as_json:
        print_sorted_json(tables.comparison_document(comparison, due, WallClock().utc_ns()))
        return
    tables.print_comparison(console(), comparison, due)
    if plot is not None:
        say(f"plot     {plot}")


def due(wanted: Wanted, max_interval: int, place: Place, as_json: bool) -> int:
    """Print when every unit is due again; exit status 1 if a real one is overdue."""
    url = place.of()
    units = [f"{model} {serial}" for model, serial in units_of(url)] if wanted.uut is None else [wanted.uut]
    dues = [
        due for unit in units for due in dues_of(compare_unit(url, replace(wanted, uut=unit).filters), max_interval)
    ]
    now_ns = WallClock().utc_ns()
    rows = [due.as_json(now_ns) for due in dues]
    if as_json:
        print_sorted_json({"due": rows})
    else:
        tables.print_due(console(), rows)
    return ExitStatus.VERDICT_FAIL if any(row["overdue"] and not row["simulated"] for row in rows) else ExitStatus.PASS


def export(path: Path, wanted: Wanted, place: Place, as_json: bool) -> None:
    """Return every estimate of every revision, as CSV or Parquet."""
    with writing(path):
        rows = export_history(place.of(), wanted.filters, path)
    if as_json:
        print_sorted_json({"file": str(path), "rows": rows})
    else:
        say(f"{rows} estimates written to {path}")


def approve_session(session: str, by: str, statement: str, place: Place, as_json: bool) -> None:
    """Approve the newest revision of a session."""
    report = Path(session) / "report.html"
    report_sha256 = digest_of_file(report) if report.is_file() else None
    done = approve(place.of([session]), named(session), by, statement, report_sha256)
    if as_json:
        print_sorted_json({**vars(done), "approved_by": by, "statement": statement})
    else:
        say(f"{done.session}: revision {done.revision} approved by {by}")


def named(session: str) -> str:
    """Return the name of a session in the history; a folder stands for the recording its results were computed from."""
    results = Path(session) / "results.json"
    with suppress(OSError, ValueError, KeyError, TypeError):
        return str(json.loads(results.read_text(encoding="utf-8"))["provenance"]["session_sha256"])
    return session
