"""Recorded sessions by where they are: entered, selected, listed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, Table, and_, delete, func, or_, select

from bench.model.clock import Clock, WallClock
from bench.store.archive.certificates import Issued, enter
from bench.store.database import add_row, add_rows, reading, rows_of, writing
from bench.store.reading import utc_text
from bench.store.selection import unknown, values_of
from bench.store.tables import archived_sessions, archived_standards, archived_units

Row = dict[str, Any]
_OF_PARTS = ("units", "standards", "certificates")


@dataclass(frozen=True)
class Unit:
    """A unit that a session measured; ``check_standard``: beside the unit under test, to watch the bench."""

    model: str
    serial: str
    check_standard: bool = False


@dataclass(frozen=True)
class UsedStandard:
    """A standard of a session, with the certificate that it had."""

    role: str
    model: str
    serial: str
    certificate: str


@dataclass(frozen=True)
class ArchivedSession:
    """One recorded session at one place; a copy elsewhere has the same ``session_sha256``.

    ``code``, ``fault``: of the error that keeps it, or its results, from being used, "" if nothing does; what is known
    from before is kept then, but for another recording.   ``verdict``, ``quality``: the worst of the released results.
    """

    location: str
    fingerprint: str
    bytes: int
    session: str
    session_sha256: str | None = None
    campaign: str = ""
    station: str = ""
    started_utc_ns: int | None = None
    simulated: bool = False
    plan_sha256: str = ""
    frame_sha256: str = ""
    software: str = ""
    method: str = ""
    verdict: str = "none"
    quality: str = ""
    code: str = ""
    fault: str = ""
    units: tuple[Unit, ...] = ()
    standards: tuple[UsedStandard, ...] = ()
    certificates: tuple[Issued, ...] = ()

    def with_fault(self, code: str, fault: str) -> ArchivedSession:
        """Return the session with the error that keeps it from being used."""
        return replace(self, code=code, fault=fault)

    @property
    def row(self) -> Row:
        """The columns of its own table."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name not in _OF_PARTS}


@dataclass(frozen=True)
class Selection:
    """Sessions that a person wants; None means all. Times are UTC in nanoseconds, ``until`` is not among them."""

    uut: str | None = None  # serial number, or "model serial", as for a standard
    campaign: str | None = None
    station: str | None = None
    verdict: str | None = None
    since_utc_ns: int | None = None
    until_utc_ns: int | None = None
    standard: str | None = None
    certificate: str | None = None  # of a standard


def enter_sessions(url: str, sessions: Sequence[ArchivedSession], software: str, clock: Clock | None = None) -> None:
    """Write what was read of sessions, all of it or nothing; what stands there of the same places is replaced.

    Raises: StoreError B-STORE-001 to B-STORE-006.
    """
    now_ns = (clock or WallClock()).utc_ns()
    with writing(url, software) as connection:
        for session in sessions:
            _enter(connection, session, now_ns)


def _enter(connection: Connection, session: ArchivedSession, now_ns: int) -> None:
    table, row = archived_sessions, {**session.row, "verified_utc_ns": now_ns}
    query = select(table.c.id, table.c.session_sha256).where(table.c.location == session.location)
    known = connection.execute(query).first()
    if known is not None and session.code and known.session_sha256 and session.session_sha256 in (None, known[1]):
        now = {
            name: row[name] for name in ("fingerprint", "code", "fault", "verified_utc_ns")
        }  # its length is evidence
        connection.execute(table.update().where(table.c.id == known.id), now)
        return
    if known is None:
        number = add_row(connection, table, row)
    else:
        number = int(known.id)
        connection.execute(table.update().where(table.c.id == number), row)
        for part in (archived_units, archived_standards):
            connection.execute(delete(part).where(part.c.archived_id == number))
    add_rows(connection, archived_units, map(vars, session.units), archived_id=number)
    add_rows(connection, archived_standards, map(vars, session.standards), archived_id=number)
    for certificate in session.certificates:
        enter(connection, certificate, now_ns)


def places_known(url: str) -> dict[str, Row]:
    """Return what is known of every place: fingerprint, bytes, hash, code.

    Raises: StoreError B-STORE-001 to -005, B-STORE-007.
    """
    names = ("location", "fingerprint", "bytes", "session", "session_sha256", "code")
    with reading(url) as connection:
        rows = rows_of(connection, select(*(archived_sessions.c[name] for name in names)))
    return {row["location"]: row for row in rows}


def list_sessions(url: str, selection: Selection) -> list[Row]:
    """Return sessions by time, each with its units.

    Raises: StoreError B-STORE-009 for a word that names nothing, B-STORE-001 to B-STORE-005, B-STORE-007.
    """
    with reading(url) as connection:
        rows = archived(connection, _wanted(selection))
        if not rows:
            _require(connection, selection)
    return rows


def archived(connection: Connection, *rules: ColumnElement[bool]) -> list[Row]:
    """Return the sessions for which all rules hold, by time, each with its units and its standards."""
    query = select(archived_sessions).where(*rules)
    order = (archived_sessions.c.started_utc_ns, archived_sessions.c.session, archived_sessions.c.location)
    rows = rows_of(connection, query.order_by(*order))
    these = query.with_only_columns(archived_sessions.c.id)
    units, standards = (_parts(connection, table, these) for table in (archived_units, archived_standards))
    return [{**row, "units": units.get(row["id"], []), "standards": standards.get(row["id"], [])} for row in rows]


def _parts(connection: Connection, table: Table, these: Select[Any]) -> dict[int, list[Row]]:
    parts: dict[int, list[Row]] = {}
    query = select(table).where(table.c.archived_id.in_(these)).order_by(*table.c)
    for row in connection.execute(query).mappings():
        parts.setdefault(row["archived_id"], []).append({name: row[name] for name in row if name != "archived_id"})
    return parts


def _wanted(selection: Selection) -> ColumnElement[bool]:
    columns = archived_sessions.c
    plain = ((name, getattr(selection, name)) for name in ("campaign", "station", "verdict"))
    rules = [columns[name] == value for name, value in plain if value is not None]
    if selection.since_utc_ns is not None:
        rules.append(columns.started_utc_ns >= selection.since_utc_ns)
    if selection.until_utc_ns is not None:
        rules.append(columns.started_utc_ns < selection.until_utc_ns)
    if selection.uut is not None:
        rules.append(has(archived_units, called(archived_units, selection.uut)))
    if selection.standard is not None:
        rules.append(has(archived_standards, called(archived_standards, selection.standard)))
    if selection.certificate is not None:
        rules.append(has(archived_standards, archived_standards.c.certificate == selection.certificate))
    return and_(columns.id == columns.id, *rules)


def has(table: Table, rule: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return the rule that a session has a unit or a standard for which another rule holds."""
    return archived_sessions.c.id.in_(select(table.c.archived_id).where(rule))


def called(table: Table, name: str) -> ColumnElement[bool]:
    """Return the rule that a unit or a standard has this serial number, or model and serial number."""
    model, _, serial = name.replace("/", " ").rpartition(" ")
    return or_(table.c.serial == name, and_(table.c.serial == serial, table.c.model == model))


def _require(connection: Connection, selection: Selection) -> None:
    """Raise StoreError B-STORE-009 for the first word of a selection that nothing in the archive has."""
    columns = archived_sessions.c
    asked: list[tuple[str, str | None, ColumnElement[str], ColumnElement[bool] | None]] = [
        ("unit", selection.uut, archived_units.c.serial, called(archived_units, selection.uut or "")),
        ("campaign", selection.campaign, columns.campaign, None),
        ("station", selection.station, columns.station, None),
        ("verdict", selection.verdict, columns.verdict, None),
        (
            "standard",
            selection.standard,
            archived_standards.c.serial,
            called(archived_standards, selection.standard or ""),
        ),
        ("certificate", selection.certificate, archived_standards.c.certificate, None),
    ]
    for kind, name, column, rule in asked:
        if name is None:
            continue
        if not connection.execute(select(func.count()).where(column == name if rule is None else rule)).scalar_one():
            raise unknown(kind, name, values_of(connection, column))


def session_document(row: Row) -> Row:
    """Return a session as people and programs are told of it."""
    told = ("session", "session_sha256", "location", "campaign", "station", "simulated", "verdict", "quality", "method")
    began_ns = row["started_utc_ns"]
    return {
        "started_utc": "" if began_ns is None else utc_text(began_ns),
        **{name: row[name] for name in (*told, "software", "plan_sha256", "frame_sha256", "bytes", "code", "fault")},
        "verified_utc": utc_text(row["verified_utc_ns"]),
        "units": row["units"],
        "standards": row["standards"],
    }
