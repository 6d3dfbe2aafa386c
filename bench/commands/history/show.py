"""``bench history``: what earlier calibrations of a unit were, how it drifts, when it is due; as tables or JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench.analysis import DOUBTFUL, REFUSED, Estimate, doubt_lines, is_sound, limits_of, limits_text
from bench.commands.console import console, headed_table, print_sorted_json, say
from bench.commands.requests import Place, Wanted
from bench.commands.tables import number_text
from bench.maths.verdict import verdict_words
from bench.model.clock import WallClock
from bench.model.errors import ExitStatus, InputError
from bench.session.output import writing
from bench.store import (
    LEAST_FOR_CONTROL,
    Comparison,
    Due,
    Filters,
    Shown,
    approve,
    compare_pair,
    compare_unit,
    conditions_text,
    digest_of_file,
    dues_of,
    export_history,
    list_calibrations,
    show_calibration,
    units_of,
)

Row = Mapping[str, Any]
_LEFT = {
    "session",
    "sha-256",
    "unit",
    "campaign",
    "unit under test",
    "approved by",
    "quantity",
    "conditions",
    "parameter",
    "governed by",
    "statement",
    "point",
    "rules",
    "since",
}
_WHOLE = {
    "sha-256",
    "point",
    "since",
    "campaign",
    "revision",
    "value",
    "first",
    "second",
    "change",
    "U 95 %",
    "E_n",
    "verdict",
}
_LONGEST = "longest interval"


def list_all(wanted: Wanted, place: Place, as_json: bool) -> None:
    """Return one line per calibration."""
    rows = list_calibrations(place.of(), wanted.filters)
    if as_json:
        print_sorted_json({"calibrations": rows})
    else:
        print_listing(console(), rows)


def show(session: str, place: Place, as_json: bool) -> None:
    """Return everything about one calibration."""
    shown = show_calibration(place.of([session]), named(session))
    if as_json:
        print_sorted_json(shown.as_json())
    else:
        print_shown(console(), shown)


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
            print_pair(console(), pair)
        return
    comparison = compare_unit(url, filters)
    due = dues_of(comparison, max_interval)
    if plot is not None:
        from bench.commands.history.plots import draw  # matplotlib takes longer to load than the comparison itself

        draw(comparison, plot)
    if as_json:
        print_sorted_json(comparison_document(comparison, due, WallClock().utc_ns()))
        return
    print_comparison(console(), comparison, due)
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
        print_due(console(), rows)
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


def print_listing(out: Console, rows: Sequence[Row]) -> None:
    """One line per calibration."""
    heads = ("session", "sha-256", "unit", "campaign", "verdict", "not sound", "revision", "approved by")
    table = rows_table(f"{len(rows)} calibrations", heads)
    for row in rows:
        state = "" if row["state"] is None else f" ({row['state'].replace('_', ' ')})"
        table.add_row(
            row["session"] + _mark(row["simulated"]) + state,
            row["session_sha256"][:8],
            f"{row['uut_model']} {row['uut_serial']}",
            row["campaign"],
            verdict_words(row["verdict"]),
            _doubts(row),
            str(row["revision"]),
            ", ".join(row["approved_by"]) or "-",
        )
    out.print(table)


def print_shown(out: Console, shown: Shown) -> None:
    """Everything about one calibration."""
    head = shown.calibration
    out.print(f"{head['session']}{_mark(head['simulated'])}")
    for name in ("campaign", "started_utc", "imported_utc", "sequence", "station", "session_sha256", "plan_sha256"):
        out.print(f"  {name.replace('_', ' '):<16} {head[name]}")
    out.print(f"  {'unit under test':<16} {head['uut_model']} {head['uut_serial']}")
    if shown.adjustment is not None:
        stated = shown.adjustment
        text = f"{stated['state'].replace('_', ' ')}: {stated['what']} ({stated['stated_by']})"
        out.print(f"  {'adjustment':<16} {text}")
    out.print("  " + ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in shown.quality.items()))
    for standard in shown.standards:
        out.print(
            f"  standard {standard['role']}: {standard['model']} {standard['serial']}, "
            f"{standard['certificate']}, due {standard['due']}"
        )
    for revision in shown.revisions:
        report = (revision["report_sha256"] or "no report")[:12]
        out.print(
            f"  revision {revision['number']}: {revision['created_utc']}, {revision['reason']}, "
            f"{revision['software']}, {report}"
        )
        for approval in revision["approvals"]:
            out.print(f"    approved by {approval['by']}, {approval['approved_utc']}: {approval['statement']}")
    for line in doubt_lines(shown.estimates):
        out.print(f"  {line}")
    if all(estimate.verdict == "none" for estimate in shown.estimates):
        out.print("  not judged: no estimate has a limit")
    table = rows_table("Estimates", ("quantity", "conditions", "value", "U 95 %", "unit", "n", "limit", "verdict"))
    for estimate in shown.estimates:
        table.add_row(
            estimate.quantity, conditions_text(estimate.conditions), number_text(estimate.value, ".6g"),
            number_text(estimate.expanded_uncertainty, ".3g") if is_sound(estimate) else _quality(estimate),
            estimate.unit, str(estimate.n), limits_text(limits_of(estimate)),
            verdict_words(estimate.verdict),
        )  # fmt: skip
    out.print(table)


def print_pair(out: Console, pair: Row) -> None:
    """Two calibrations, parameter by parameter."""
    first, second = pair["sessions"]
    out.print(f"{pair['uut_model']} {pair['uut_serial']}: {first} (method {pair['methods'][0]})")
    out.print(f"  against {second} (method {pair['methods'][1]})")
    table = rows_table("", ("quantity", "conditions", "first", "second", "change", "U 95 %", "unit", "E_n"))
    for parameter in pair["parameters"]:
        table.add_row(
            parameter["quantity"], conditions_text(parameter["conditions"]),
            *(f"{value:.6g}" for value in parameter["values"]), f"{parameter['change']:+.3g}",
            f"{parameter['change_expanded_uncertainty']:.3g}", parameter["unit"], number_text(parameter["en"], "+.2f"),
        )  # fmt: skip
    out.print(table)
    scores = [parameter["en"] for parameter in pair["parameters"] if parameter["en"] is not None]
    above = sum(abs(score) > 1.0 for score in scores)
    out.print(f"{above} of {len(scores)} parameters changed by more than their uncertainty (|E_n| > 1)")
    for note in pair["notes"]:
        out.print(note)


def comparison_document(comparison: Comparison, due: Sequence[Due], now_utc_ns: int) -> dict[str, Any]:
    """Return a comparison as one JSON document."""
    series = comparison.series
    return {
        "uut_model": series.uut[0],
        "uut_serial": series.uut[1],
        "sessions": [row["session"] for row in series.calibrations],
        "levels": series.level.tolist(),
        "parameters": [history.as_json(series) for history in comparison.parameters],
        "due": [entry.as_json(now_utc_ns) for entry in due],
        "notes": list(series.notes),
    }


def print_comparison(out: Console, comparison: Comparison, due: Sequence[Due]) -> None:
    """Drift, agreement and control of every parameter, and the due dates."""
    series = comparison.series
    heads = ("parameter", "calibr.", "last", "U 95 %", "unit", "drift/year", "U 95 %", "E_n last", "|E_n|>1", "out")
    table = rows_table(f"{' '.join(series.uut)}: {len(series.calibrations)} calibrations", heads)
    for history in comparison.parameters:
        document = history.as_json(series)
        table.add_row(
            history.parameter.label, str(document["calibrations"]), f"{document['value']:.6g}",
            f"{document['expanded_uncertainty']:.3g}", document["unit"], number_text(document["rate_per_year"], "+.3g"),
            number_text(document["rate_expanded_uncertainty"], ".2g"), number_text(document["en"], "+.2f"),
            str(document["en_above_1"]), "-" if history.chart is None else str(len(document["out_of_control"])),
        )  # fmt: skip
    out.print(table)
    adjustments = int(series.level[-1] - series.level[0]) if series.level.size else 0
    if adjustments:
        out.print(f"The unit was adjusted {adjustments} times; no drift and no E_n is taken across an adjustment")
    for note in series.notes:
        out.print(note)
    if all(history.line is None for history in comparison.parameters):
        out.print("No drift is known: there are no two calibrations at different times")
    if all(history.chart is None for history in comparison.parameters):
        out.print(f"No control limits: they need {LEAST_FOR_CONTROL} calibrations")
    for item in due:
        row = item.as_json(0)
        out.print(f"{row['campaign']}: next due {row['due_utc'][:10]}, because of {row['governed_by'] or _LONGEST}")


def print_due(out: Console, rows: Sequence[Row]) -> None:
    """One line per unit and campaign."""
    table = rows_table("", ("unit under test", "campaign", "last", "due", "governed by", "state"))
    for row in sorted(rows, key=lambda row: str(row["due_utc"])):
        unit = f"{row['uut_model']} {row['uut_serial']}{_mark(row['simulated'])}"
        state = "-" if row["simulated"] else "OVERDUE" if row["overdue"] else "valid"
        table.add_row(
            unit, row["campaign"], row["last_utc"][:10], row["due_utc"][:10], row["governed_by"] or _LONGEST, state
        )
    out.print(table)


def rows_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]] = ()) -> Table:
    """Return a table of the history: what is no number stands left, what is short is not folded."""
    return headed_table(title, heads, rows, whole=_WHOLE, left=_LEFT)


def _doubts(row: Row) -> str:
    """Return how many estimates of a calibration are doubtful or refused."""
    counts = [f"{row[name]} {name}" for name in (REFUSED, DOUBTFUL) if row[name]]
    return ", ".join(counts) or "-"


def _quality(estimate: Estimate) -> str:
    return "accepted" if estimate.acceptance else estimate.quality


def _mark(simulated: bool) -> str:
    return " (SIMULATED)" if simulated else ""
