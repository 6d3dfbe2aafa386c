"""Finds what a person names: a unit, a session, a campaign, a quantity; and suggests what was meant."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, and_, func, or_, select

from bench.analysis import OF_UNIT
from bench.store.database import rows_of
from bench.store.errors import StoreError
from bench.store.tables import calibrations, estimates, parameters, report_revisions, result_sets

_LEAST_HASH = 6
_SHOWN = 5


@dataclass(frozen=True)
class Filters:
    """The selection that a person wants to see; None means all."""

    uut: str | None = None  # serial number, or "model serial"
    campaign: str | None = None
    quantity: str | None = None
    until_utc_ns: int | None = None  # not among them


def latest_revisions() -> Select[Any]:
    """Return every calibration with its newest revision and the results that belong to it."""
    newest = (
        select(report_revisions.c.calibration_id, func.max(report_revisions.c.number).label("number"))
        .group_by(report_revisions.c.calibration_id)
        .subquery()
    )
    revisions = report_revisions
    return (
        select(
            calibrations,
            revisions.c.id.label("revision_id"),
            revisions.c.number.label("revision"),
            revisions.c.report_sha256,
            revisions.c.software,
            result_sets.c.id.label("result_set_id"),
            result_sets.c.method,
            result_sets.c.decision_rule,
            result_sets.c.estimates,
        )
        .join(newest, newest.c.calibration_id == calibrations.c.id)
        .join(revisions, and_(revisions.c.calibration_id == calibrations.c.id, revisions.c.number == newest.c.number))
        .join(result_sets, result_sets.c.id == revisions.c.result_set_id)
        .order_by(calibrations.c.started_utc_ns, calibrations.c.id)
    )


def selected(connection: Connection, filters: Filters) -> Select[Any]:
    """Return newest revisions of the calibrations left by a filter. Raises StoreError B-STORE-009 : unknown word."""
    query = latest_revisions()
    if filters.uut is not None:
        model, serial = find_unit(connection, filters.uut)
        query = query.where(calibrations.c.uut_model == model, calibrations.c.uut_serial == serial)
    if filters.campaign is not None:
        require(connection, "campaign", filters.campaign, calibrations.c.campaign)
        query = query.where(calibrations.c.campaign == filters.campaign)
    if filters.quantity is not None:
        require(connection, "quantity", filters.quantity, parameters.c.quantity)
        has = (
            select(estimates.c.result_set_id)
            .join(parameters, parameters.c.id == estimates.c.parameter_id)
            .where(parameters.c.quantity == filters.quantity)
        )
        query = query.where(result_sets.c.id.in_(has))
    if filters.until_utc_ns is not None:
        query = query.where(calibrations.c.started_utc_ns < filters.until_utc_ns)
    return query


def units(connection: Connection) -> list[tuple[str, str]]:
    """Return model and serial number of every unit in the history."""
    columns = (calibrations.c.uut_model, calibrations.c.uut_serial)
    return [(row[0], row[1]) for row in connection.execute(select(*columns).distinct().order_by(*columns))]


def find_unit(connection: Connection, name: str | None) -> tuple[str, str]:
    """Return model and serial number of a unit named by its serial number or both; None is the only one there is.

    Raises: StoreError B-STORE-009 if it is not known, or not the only one of that name.
    """
    known = units(connection)
    texts = {f"{model} {serial}": (model, serial) for model, serial in known}
    if name is None:
        matches = known
    else:
        wanted = name.replace("/", " ")
        matches = [texts[wanted]] if wanted in texts else [unit for unit in known if unit[1] == name]
    if len(matches) == 1:
        return matches[0]
    choices = texts if len(matches) != 0 or name is None else [serial for _, serial in known]
    raise unknown("unit", name, choices, several=len(matches) > 1)


def find_calibration(connection: Connection, name: str) -> dict[str, Any]:
    """Return a calibration with its newest revision, named by its session or the beginning of the session's SHA-256.

    Raises: StoreError B-STORE-009 if it is not known, or not the only one of that name.
    """
    wanted = name.rstrip("/").rsplit("/", 1)[-1]
    by_name = calibrations.c.session == wanted
    rule: ColumnElement[bool] = or_(by_name, calibrations.c.session.startswith(f"{wanted}{OF_UNIT}", autoescape=True))
    if len(wanted) >= _LEAST_HASH:
        rule = or_(rule, calibrations.c.session_sha256.startswith(wanted.lower(), autoescape=True))
    rows = rows_of(connection, latest_revisions().where(rule))
    exact = [row for row in rows if wanted in (row["session"], row["session_sha256"])]  # not its check standard
    if len(rows) == 1 or len(exact) == 1:
        return (exact or rows)[0]
    if rows:
        raise unknown("session", name, [_told_apart(row) for row in rows], several=True)
    sessions = connection.execute(select(calibrations.c.session).distinct()).scalars().all()
    raise unknown("session", name, sessions)


def _told_apart(row: Mapping[str, Any]) -> str:
    """Return units of one session by its name and their serial numbers; sessions of one name by their SHA-256."""
    return str(row["session"]) if OF_UNIT in row["session"] else str(row["session_sha256"])[:12]


def unknown(kind: str, name: str | None, choices: Sequence[str] | dict[str, Any], several: bool = False) -> StoreError:
    """Return the error for a word that names nothing, or more than one, with what may have been meant."""
    names = list(choices)
    near = difflib.get_close_matches(name or "", names, n=_SHOWN, cutoff=0.5) or names[:_SHOWN]
    more = ", ..." if len(names) > len(near) else ""
    listed = ", ".join(names if several and len(names) <= _SHOWN else near) + more
    if name is None:
        message = f"the history holds {len(names)} {kind}s; say which"
    else:
        message = f"{kind} {name!r} names several" if several else f"no {kind} {name!r} in the history"
    return StoreError(
        "B-STORE-009",
        message,
        where=name or kind,
        next_step=f"use one of: {listed}" if listed else "'bench history import SESSION' adds one",
    )


def values_of(connection: Connection, column: ColumnElement[str]) -> Sequence[str]:
    """Return the values of a column, each once, in their order."""
    return connection.execute(select(column).distinct().order_by(column)).scalars().all()


def require(connection: Connection, kind: str, name: str, column: ColumnElement[str]) -> None:
    known = values_of(connection, column)
    if name not in known:
        raise unknown(kind, name, known)
