"""Tables of ``bench archive`` on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from bench.archive.changes import Changes, Concerned, verdict_text
from bench.archive.evidence import NO_CHECK, OUT_OF_CONTROL, TOO_FEW
from bench.commands.console import headed_table
from bench.maths.verdict import verdict_words
from bench.store import conditions_text

Row = Mapping[str, Any]
SHOWN = 40  # rows of a table that can be long
DECIDED = "Nothing released is changed by this. Whether a certificate is recalled is decided by people."
_WHOLE = {"session", "sha-256", "campaign", "quantity", "number", "verdict", "state"}
_WHY = {
    NO_CHECK: "no session before had a check standard that the history knows",
    TOO_FEW: "too few calibrations of the check standard before for a control chart",
    OUT_OF_CONTROL: "no check standard was in control",
}


def print_sessions(out: Console, rows: Sequence[Row]) -> None:
    """One line per session."""
    heads = ("session", "sha-256", "unit", "campaign", "verdict", "state", "in")
    table = headed_table(f"{len(rows)} sessions", heads, whole=_WHOLE)
    for row in rows:
        state = row["code"] or row["quality"] or "no results"
        table.add_row(
            row["session"],
            (row["session_sha256"] or "-")[:8],
            ", ".join(f"{unit['model']} {unit['serial']}" for unit in row["units"]) or "-",
            row["campaign"] or "-",
            verdict_words(row["verdict"]),
            f"{state} (SIMULATED)" if row["simulated"] else state,
            row["location"].rstrip("/").rpartition("/")[0],
        )
    out.print(table)


def print_certificates(out: Console, rows: Sequence[Row]) -> None:
    """One line per certificate."""
    table = headed_table(
        f"{len(rows)} certificates", ("number", "unit", "customer", "session", "issued", "state"), whole=_WHOLE
    )
    for row in rows:
        state = ["specimen"] if row["specimen"] else []
        state += [f"replaced by {number}" for number in row["replaced_by"]]
        table.add_row(
            row["number"], f"{row['uut_model']} {row['uut_serial']}", row["customer"], row["session"],
            row["issued"] or "-", ", ".join(state) or "valid",
        )  # fmt: skip
    if rows:
        out.print(table)


def print_changes(out: Console, report: Changes) -> None:
    """Print the whole report."""
    mark = " (SIMULATED)" if report.simulated else ""
    out.print(f"trial {report.trial}{mark}, {report.state}: {report.sessions} sessions, begun {report.started_utc}")
    out.print(f"  released with {', '.join(report.released_software) or '-'}; now {report.software}")
    if report.method:
        out.print(f"  method {report.method}")
    for number, entry in report.register.items():
        out.print(f"  {entry['model']} {entry['serial']}: {entry['certificate']} in place of {number}")
    for code, count in report.failed.items():
        first = next(failure for failure in report.failures if failure["code"] == code)
        out.print(f"  {count} sessions gave no results: {code}, the first {first['session']}: {first['fault']}")
    _print_quantities(out, report)
    _print_flips(out, report)
    _print_concerned(out, report)
    for evidence in report.standards:
        good = f"last good evidence {evidence.session} ({evidence.session_utc}, {evidence.check_standard} in control)"
        said = good if evidence.session else f"last good evidence: none, {_WHY[evidence.why]}"
        out.print(f"{evidence.model} {evidence.serial}, in question since {evidence.since_utc}: {said}")
    out.print(DECIDED)


def _print_quantities(out: Console, report: Changes) -> None:
    changed = [entry for entry in report.quantities if entry.changed]
    same = len(report.quantities) - len(changed)
    if same:
        out.print(f"{same} of {len(report.quantities)} quantities are the same to 1e-9 in every session")
    if not changed:
        return
    heads = ("quantity", "campaign", "compared", "changed", "|change|>U", "least", "5 %", "median", "95 %", "greatest")
    table = headed_table("Changes in units of the released U", heads, whole=_WHOLE)
    for entry in changed:
        shares = [f"{share:+.3g}" for share in entry.percentiles] or ["-"] * 5
        counts = (str(entry.compared), str(entry.changed), str(entry.above_one))
        table.add_row(entry.quantity, entry.campaign, *counts, *shares)
    out.print(table)


def _print_flips(out: Console, report: Changes) -> None:
    if not report.flips:
        out.print("No verdict is another one.")
        return
    heads = ("session", "unit", "quantity", "conditions", "released", "U 95 %", "now", "U 95 %", "verdict")
    table = headed_table(_cut("verdicts or qualities are others", len(report.flips)), heads, whole=_WHOLE)
    for flip in report.flips[:SHOWN]:
        numbers = (flip.released_value, flip.released_expanded_uncertainty, flip.value, flip.expanded_uncertainty)
        then, now = verdict_text(flip.released_verdict, flip.released_quality), verdict_text(flip.verdict, flip.quality)
        table.add_row(
            flip.session, flip.uut, f"{flip.quantity}, {flip.unit}", conditions_text(flip.conditions),
            *("-" if number is None else f"{number:.6g}" for number in numbers), f"{then} -> {now}",
        )  # fmt: skip
    out.print(table)


def _print_concerned(out: Console, report: Changes) -> None:
    if not report.certificates:
        out.print("No certificate is concerned.")
        return
    heads = ("number", "customer", "unit", "change/U", "of", "flips", "method", "state")
    table = headed_table(_cut("certificates are concerned", len(report.certificates)), heads, whole=_WHOLE)
    for entry in report.certificates[:SHOWN]:
        state = ["specimen"] if entry.specimen else []
        state += [f"replaced by {number}" for number in entry.replaced_by]
        state += [entry.code] if entry.code else []
        table.add_row(
            entry.number, entry.customer, entry.uut, "-" if entry.largest is None else f"{entry.largest:+.3g}",
            entry.largest_of or "-", str(entry.flips), _method(entry), ", ".join(state) or "valid",
        )  # fmt: skip
    out.print(table)


def _method(entry: Concerned) -> str:
    then, now = entry.released_method, entry.method or "-"
    return then if then == now else f"{then} -> {now}"


def _cut(what: str, count: int) -> str:
    return f"{count} {what}" + (f", the first {SHOWN} of them; --json has all" if count > SHOWN else "")
