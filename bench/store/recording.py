"""Writes into the history, in one transaction: calibrations, of which the same session again changes nothing, and
approvals: somebody stands for a revision of a calibration; nothing that was approved is ever changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import Connection, Table, select

from bench.model.clock import Clock, WallClock
from bench.model.lab import in_words
from bench.store import tables
from bench.store.adjustments import add_state
from bench.store.contents import Contents, Row, contents_of
from bench.store.database import add_row, add_rows, reading, writing
from bench.store.errors import StoreError
from bench.store.selection import find_calibration
from bench.store.tables import approvals

OUTCOMES: tuple[Literal["new", "revised", "unchanged"], ...] = ("new", "revised", "unchanged")


@dataclass(frozen=True)
class Recorded:
    """A recorded session: ``new`` calibration, ``revised`` (a further revision) or ``unchanged``."""

    outcome: Literal["new", "revised", "unchanged"]
    session: str
    revision: int


def record_calibration(
    url: str,
    document: Mapping[str, Any],
    manifest: Mapping[str, Any],
    report_sha256: str | None,
    *,
    reason: str = "",
    started_utc_ns: int | None = None,
    adjustment: tuple[str, str, str] | None = None,
    clock: Clock | None = None,
) -> Recorded:
    """Add a session to the history, or a revision of it if its results or its report have changed.

    A session of several units is a calibration of each of them, named ``SESSION:SERIAL``; all are entered or none.

    Args:   url: of the history; a SQLite file is made if there is none.   document: results.json.
            manifest: of the session.   report_sha256: of report.html, None if there is none.
            reason: why there is a new revision; by default what has changed.
            started_utc_ns: when the session began, if its name does not say it.   clock: labels the revision.
            adjustment: "as_found" or "as_left", what was adjusted and who says so, of the unit of the session.
    Raises: StoreError B-STORE-001 to B-STORE-006 (the history), B-STORE-008 (the documents), B-STORE-014 (anything
            else: a run that has its results must not end here). Nothing is half written.
    """
    try:
        contents = contents_of(document, manifest, started_utc_ns)
        now_ns = (clock or WallClock()).utc_ns()
        with writing(url, str(document["provenance"]["software"])) as connection:
            done = [_record(connection, content, report_sha256, reason, now_ns) for content in contents]
            if adjustment is not None:
                _state(connection, str(document["provenance"]["session_sha256"]), adjustment, now_ns)
        outcome = next(outcome for outcome in OUTCOMES if any(each.outcome == outcome for each in done))
        return Recorded(outcome, str(document["session"]), max(entry.revision for entry in done))
    except StoreError:
        raise
    except Exception as error:
        raise StoreError(
            "B-STORE-014",
            f"the history failed in a way nobody foresaw ({in_words(error)})",
            where=str(document.get("session", "")),
            next_step="'bench history import SESSION' tries again; please report it",
        ) from error


def _record(
    connection: Connection, contents: Contents, report_sha256: str | None, reason: str, now_ns: int
) -> Recorded:
    session = contents.calibration["session"]
    known = _id(connection, tables.calibrations, session_sha256=contents.calibration["session_sha256"])
    calibration = known or _new_calibration(connection, contents, now_ns)
    results_sha256 = contents.result_set["results_sha256"]
    stored = _id(connection, tables.result_sets, calibration_id=calibration, results_sha256=results_sha256)
    last = _last_revision(connection, calibration)
    same_report = last is not None and report_sha256 in (None, last["report_sha256"])
    if last is not None and stored == last["result_set_id"] and same_report:
        return Recorded("unchanged", session, last["number"])
    result_set = stored or _new_results(connection, contents, calibration)
    revision = {
        "calibration_id": calibration,
        "number": 1 if last is None else last["number"] + 1,
        "result_set_id": result_set,
        "report_sha256": report_sha256,
        "software": contents.result_set["software"],
        "reason": reason or _change(last, result_set, contents.result_set),
        "created_utc_ns": now_ns,
    }
    connection.execute(tables.report_revisions.insert(), revision)
    return Recorded("new" if known is None else "revised", session, revision["number"])


def _state(connection: Connection, session_sha256: str, adjustment: tuple[str, str, str], now_ns: int) -> None:
    """State the unit of a session as found or as left; in a session of several units nobody knows which is meant."""
    calibration = _id(connection, tables.calibrations, session_sha256=session_sha256)
    if calibration is not None:
        add_state(connection, calibration, *adjustment, now_ns)


def _id(connection: Connection, table: Table, **keys: Any) -> int | None:
    query = select(table.c.id).where(*(table.c[name] == value for name, value in keys.items()))
    return connection.execute(query).scalar_one_or_none()


def _new_calibration(connection: Connection, contents: Contents, now_ns: int) -> int:
    row = {**contents.calibration, "imported_utc_ns": now_ns}
    calibration = add_row(connection, tables.calibrations, row)
    add_rows(connection, tables.standards, contents.standards, calibration_id=calibration)
    add_rows(connection, tables.shared_components, contents.shared, calibration_id=calibration)
    return calibration


def _new_results(connection: Connection, contents: Contents, calibration: int) -> int:
    row = {**contents.result_set, "calibration_id": calibration}
    result_set = add_row(connection, tables.result_sets, row)
    known = parameter_keys(connection, contents.parameters)
    for table, entries in ((tables.estimates, contents.estimates), (tables.doubts, contents.doubts)):
        rows = [{"parameter_id": known[contents.parameters[entry["position"]]["sha256"]], **entry} for entry in entries]
        add_rows(connection, table, rows, result_set_id=result_set)
    add_rows(connection, tables.quality_counts, contents.quality, result_set_id=result_set)
    return result_set


def parameter_keys(connection: Connection, wanted: Sequence[Row]) -> dict[str, int]:
    """Return keys of the parameters by their hash; those that no calibration had yet are added."""
    by_hash = {row["sha256"]: row for row in wanted}
    query = select(tables.parameters.c.sha256, tables.parameters.c.id).where(tables.parameters.c.sha256.in_(by_hash))
    known = {row.sha256 for row in connection.execute(query)}
    add_rows(connection, tables.parameters, [row for sha256, row in by_hash.items() if sha256 not in known])
    return {row.sha256: row.id for row in connection.execute(query)}


def _last_revision(connection: Connection, calibration: int) -> Row | None:
    revisions = tables.report_revisions
    query = select(revisions).where(revisions.c.calibration_id == calibration).order_by(revisions.c.number.desc())
    row = connection.execute(query.limit(1)).mappings().first()
    return None if row is None else dict(row)


def _change(last: Row | None, result_set: int, row: Row) -> str:
    if last is None:
        return "first results"
    if last["result_set_id"] == result_set:
        return "the report was written again"
    return f"other results: method {row['method']}, {row['software']}"


@dataclass(frozen=True)
class Approved:
    """The revision that was approved."""

    session: str
    revision: int
    report_sha256: str | None


def approve(
    url: str, name: str, by: str, statement: str, report_sha256: str | None = None, clock: Clock | None = None
) -> Approved:
    """Approve the newest revision of a calibration.

    Args:   url: of the history.   name: session or the beginning of its SHA-256.   by, statement: who says what.
            report_sha256: of the report that was looked at, if there is one: it must be the one of the newest revision.
    Raises: StoreError B-STORE-010 (nobody or nothing said, or another report), B-STORE-001 to B-STORE-009.
    """
    if not by.strip() or not statement.strip():
        raise StoreError(
            "B-STORE-010",
            "an approval needs a name and a statement",
            where=name,
            next_step="give both: --by NAME --statement TEXT",
        )
    with reading(url):  # an approval begins no history
        pass
    with writing(url, "") as connection:
        calibration = find_calibration(connection, name)
        if report_sha256 is not None and report_sha256 != calibration["report_sha256"]:
            raise StoreError(
                "B-STORE-010",
                f"the report in the folder is not the one of revision {calibration['revision']}",
                where=name,
                next_step="'bench history import SESSION' makes it a revision, then approve that",
            )
        row = {
            "revision_id": calibration["revision_id"],
            "approved_by": by.strip(),
            "statement": statement.strip(),
            "approved_utc_ns": (clock or WallClock()).utc_ns(),
        }
        connection.execute(approvals.insert(), row)
    return Approved(calibration["session"], calibration["revision"], calibration["report_sha256"])
