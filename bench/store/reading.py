"""Lists calibrations, and gives one back as it was written."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Table, select

from bench.analysis import DOUBTFUL, REFUSED, Estimates, documents, estimates_of
from bench.maths.verdict import worst
from bench.model.clock import utc_text
from bench.store.adjustments import states_of
from bench.store.database import reading, rows_of
from bench.store.selection import Filters, find_calibration, selected, units
from bench.store.tables import (
    COLUMNS,
    approvals,
    doubts,
    estimates,
    parameters,
    quality_counts,
    report_revisions,
    result_sets,
    shared_components,
    standards,
)

Row = dict[str, Any]
_LISTED = (
    "session", "session_sha256", "campaign", "uut_model", "uut_serial", "simulated", "method", "software", "estimates",
    "revision",
)  # fmt: skip


def list_calibrations(url: str, filters: Filters) -> list[Row]:
    """Return calibrations by time, each with its newest revision, worst verdict and who approved that revision.

    Raises: StoreError B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    with reading(url) as connection:
        rows = rows_of(connection, selected(connection, filters))
        kept = [row["result_set_id"] for row in rows]
        verdicts = _verdicts(connection, kept)
        unsound = _unsound(connection)
        approved = _approvals(connection, [row["revision_id"] for row in rows])
        stated = states_of(connection)
    return [
        {
            "started_utc": utc_text(row["started_utc_ns"]),
            **{name: row[name] for name in _LISTED},
            **{quality: unsound[row["result_set_id"], quality] for quality in (DOUBTFUL, REFUSED)},
            "state": stated.get(row["id"], {}).get("state"),
            "verdict": worst(verdicts.get(row["result_set_id"], ())),
            "approved_by": [approval["approved_by"] for approval in approved.get(row["revision_id"], [])],
        }
        for row in rows
    ]


def _verdicts(connection: Connection, result_set_ids: Iterable[int]) -> dict[int, set[str]]:
    wanted = set(result_set_ids)
    verdicts: dict[int, set[str]] = {}
    for table in (estimates, doubts):
        query = select(table.c.result_set_id, table.c.verdict).where(table.c.verdict != "none").distinct()
        for number, verdict in connection.execute(query):
            if number in wanted:
                verdicts.setdefault(number, set()).add(verdict)
    return verdicts


def _unsound(connection: Connection) -> Counter[tuple[int, str]]:
    """Return how many estimates are doubtful or refused, by set of results and quality."""
    query = select(doubts.c.result_set_id, doubts.c.document)
    return Counter((row.result_set_id, str(json.loads(row.document)["quality"])) for row in connection.execute(query))


def _approvals(connection: Connection, revision_ids: Iterable[int]) -> dict[int, list[Row]]:
    wanted = set(revision_ids)
    by_revision: dict[int, list[Row]] = {}
    for row in connection.execute(select(approvals).order_by(approvals.c.id)).mappings():
        if row["revision_id"] in wanted:
            by_revision.setdefault(row["revision_id"], []).append(dict(row))
    return by_revision


def units_of(url: str) -> list[tuple[str, str]]:
    """Return model and serial number of every unit. Raises: StoreError B-STORE-001 to B-STORE-005, B-STORE-007."""
    with reading(url) as connection:
        return units(connection)


@dataclass(frozen=True)
class Shown:
    """One calibration: everything the history knows about it."""

    calibration: Row
    revisions: list[Row]  # with their approvals
    standards: list[Row]
    shared: list[Row]
    quality: dict[str, int]
    estimates: Estimates  # of the newest revision, as in results.json
    notes: list[str]
    adjustment: Row | None  # state "as_found" or "as_left", what was adjusted and who says so

    def as_json(self) -> Row:
        """Return one JSON document."""
        further = {name: value for name, value in vars(self).items() if name != "calibration"}
        return {**self.calibration, **further, "estimates": documents(self.estimates)}


def show_calibration(url: str, name: str) -> Shown:
    """Return one calibration, named by its session or the beginning of its SHA-256.

    Raises: StoreError B-STORE-001 to B-STORE-005, B-STORE-007, B-STORE-009.
    """
    with reading(url) as connection:
        calibration = find_calibration(connection, name)
        number, result_set = calibration["id"], calibration["result_set_id"]
        counts = connection.execute(select(quality_counts).where(quality_counts.c.result_set_id == result_set))
        stated = select(result_sets.c.notes).where(result_sets.c.id == result_set)
        return Shown(
            calibration=_calibration(calibration),
            revisions=_revisions(connection, number),
            standards=_rows(connection, standards, number),
            shared=_rows(connection, shared_components, number),
            quality={row["name"]: row["count"] for row in counts.mappings()},
            estimates=stored_estimates(connection, result_set),
            notes=json.loads(connection.execute(stated).scalar_one()),
            adjustment=_adjustment(states_of(connection).get(number)),
        )


def _adjustment(stated: Row | None) -> Row | None:
    if stated is None:
        return None
    names = ("state", "what", "stated_by")
    return {**{name: stated[name] for name in names}, "stated_utc": utc_text(stated["stated_utc_ns"])}


def stored_estimates(connection: Connection, result_set: int) -> Estimates:
    """Return estimates in the order of results.json, every number as it was."""
    query = (
        select(estimates, parameters.c.quantity, parameters.c.unit, parameters.c.conditions)
        .join(parameters, parameters.c.id == estimates.c.parameter_id)
        .where(estimates.c.result_set_id == result_set)
        .order_by(estimates.c.position)
    )
    by_position = {row["position"]: _estimate(dict(row)) for row in connection.execute(query).mappings()}
    unsound = select(doubts.c.position, doubts.c.document).where(doubts.c.result_set_id == result_set)
    by_position |= {row.position: json.loads(row.document) for row in connection.execute(unsound)}
    return estimates_of({"estimates": [by_position[position] for position in sorted(by_position)]})


def _estimate(row: Row) -> Row:
    return {
        **{name: row[name] for name in ("quantity", "unit", *COLUMNS)},
        "conditions": {**json.loads(row["conditions"]), **json.loads(row["measured"] or "{}")},
        "limit": row["limit_value"],
        **json.loads(row["further"] or "{}"),
    }


def _calibration(calibration: Row) -> Row:
    """Return what a person asks of a calibration, with times as text."""
    left_out = ("id", "started_utc_ns", "imported_utc_ns", "estimates", "revision_id", "result_set_id")
    times = {
        "started_utc": utc_text(calibration["started_utc_ns"]),
        "imported_utc": utc_text(calibration["imported_utc_ns"]),
    }
    return {**times, **{name: value for name, value in calibration.items() if name not in left_out}}


def _revisions(connection: Connection, calibration: int) -> list[Row]:
    query = (
        select(report_revisions, result_sets.c.method, result_sets.c.results_sha256)
        .join(result_sets, result_sets.c.id == report_revisions.c.result_set_id)
        .where(report_revisions.c.calibration_id == calibration)
        .order_by(report_revisions.c.number)
    )
    rows = rows_of(connection, query)
    approved = _approvals(connection, [row["id"] for row in rows])
    names = ("number", "method", "results_sha256", "report_sha256", "software", "reason")
    return [
        {
            **{name: row[name] for name in names},
            "created_utc": utc_text(row["created_utc_ns"]),
            "approvals": [
                {
                    "by": approval["approved_by"],
                    "statement": approval["statement"],
                    "approved_utc": utc_text(approval["approved_utc_ns"]),
                }
                for approval in approved.get(row["id"], [])
            ],
        }
        for row in rows
    ]


def _rows(connection: Connection, table: Table, calibration: int) -> list[Row]:
    columns = [column for column in table.c if column.name != "calibration_id"]
    query = select(*columns).where(table.c.calibration_id == calibration).order_by(columns[0])
    return rows_of(connection, query)
