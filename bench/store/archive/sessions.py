"""Recorded sessions by where they are: entered, selected, listed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import UTC, date, datetime, time, timedelta
from typing import Any

from sqlalchemy import Column, ColumnElement, Connection, Select, Table, and_, delete, or_, select

from bench.model.clock import NS, Clock, WallClock, utc_text
from bench.model.errors import InputError
from bench.store.archive.certificates import Issued, UsedStandard, enter
from bench.store.database import add_row, add_rows, reading, rows_of, writing
from bench.store.selection import unknown, values_of
from bench.store.tables import archived_sessions, archived_standards, archived_units

Row = dict[str, Any]
_OF_PARTS = ("units", "standards", "certificates")
_WORDS: dict[str, Column[str]] = {  # of --select, beside the days
    "uut": archived_units.c.serial,
    "campaign": archived_sessions.c.campaign,
    "station": archived_sessions.c.station,
    "verdict": archived_sessions.c.verdict,
    "standard": archived_standards.c.serial,
    "certificate": archived_standards.c.certificate,
}
_DAYS = ("since", "until")


@dataclass(frozen=True)
class Unit:
    """A unit that a session measured; ``check_standard``: beside the unit under test, to watch the bench."""

    model: str
    serial: str
    check_standard: bool = False


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


def selection_of(words: Sequence[str]) -> Selection:
    """Return the selection that ``NAME=VALUE`` words stand for; the day ``until`` is among them.

    Raises: InputError B-ARC-001 for another name, one that is said twice, or no day.
    """
    said: dict[str, str] = {}
    for word in words:
        name, is_pair, value = word.partition("=")
        if not is_pair or not value or name in said or name not in (*_WORDS, *_DAYS):
            raise InputError(
                "B-ARC-001",
                f"{word!r} selects nothing",
                where="--select",
                next_step=f"write NAME=VALUE, each name once: {', '.join((*_WORDS, *_DAYS))}",
            )
        said[name] = value
    days = {f"{name}_utc_ns": _begin_ns(name, said.pop(name)) for name in _DAYS if name in said}
    return Selection(**said, **days)  # type: ignore[arg-type]  # the names are looked at above


def _begin_ns(name: str, text: str) -> int:
    """Return when a day begins, or ends for ``until``; UTC, nanoseconds."""
    try:
        day = date.fromisoformat(text) + timedelta(days=name == "until")
        return int(datetime.combine(day, time(), UTC).timestamp()) * NS
    except (ValueError, OverflowError) as error:
        raise InputError(
            "B-ARC-001",
            f"{text!r} is no day",
            where=f"--select {name}",
            next_step="write YYYY-MM-DD",
        ) from error


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
    if known is not None:
        for part in (archived_units, archived_standards):
            connection.execute(delete(part).where(part.c.archived_id == known.id))
        connection.execute(delete(table).where(table.c.id == known.id))
    number = add_row(connection, table, row)
    add_rows(connection, archived_units, map(vars, session.units), archived_id=number)
    add_rows(connection, archived_standards, map(vars, session.standards), archived_id=number)
    for certificate in session.certificates:
        enter(connection, certificate, now_ns)


def places_known(url: str) -> dict[str, Row]:
    """Return what is known of every place: fingerprint, bytes, hash, code and fault.

    Raises: StoreError B-STORE-001 to -005, B-STORE-007.
    """
    names = ("location", "fingerprint", "bytes", "session_sha256", "code", "fault")
    with reading(url) as connection:
        rows = rows_of(connection, select(*(archived_sessions.c[name] for name in names)))
    return {row["location"]: row for row in rows}


def list_sessions(url: str, selection: Selection) -> list[Row]:
    """Return sessions by time, each with its units.

    Raises: StoreError B-STORE-009 for a word that names nothing, B-STORE-001 to B-STORE-005, B-STORE-007.
    """
    with reading(url) as connection:
        rows = archived(connection, *_wanted(selection))
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


def _wanted(selection: Selection) -> list[ColumnElement[bool]]:
    began_ns = archived_sessions.c.started_utc_ns
    rules = [_rule(word, value) for word in _WORDS if (value := getattr(selection, word)) is not None]
    if selection.since_utc_ns is not None:
        rules.append(began_ns >= selection.since_utc_ns)
    if selection.until_utc_ns is not None:
        rules.append(began_ns < selection.until_utc_ns)
    return rules


def _rule(word: str, value: str) -> ColumnElement[bool]:
    """Return the rule that a session is, or has, what a word of ``--select`` names."""
    column = _WORDS[word]
    if column.table is archived_sessions:
        return column == value
    return has(column.table, called(column.table, value) if column.name == "serial" else column == value)


def has(table: Table, rule: ColumnElement[bool]) -> ColumnElement[bool]:
    """Return the rule that a session has a unit or a standard for which another rule holds."""
    return archived_sessions.c.id.in_(select(table.c.archived_id).where(rule))


def called(table: Table, name: str) -> ColumnElement[bool]:
    """Return the rule that a unit or a standard has this serial number, or model and serial number."""
    model, _, serial = name.replace("/", " ").rpartition(" ")
    return or_(table.c.serial == name, and_(table.c.serial == serial, table.c.model == model))


def _require(connection: Connection, selection: Selection) -> None:
    """Raise StoreError B-STORE-009 for the first word of a selection that nothing in the archive has."""
    for word, column in _WORDS.items():
        name = getattr(selection, word)
        if name is not None and not archived(connection, _rule(word, name)):
            raise unknown("unit" if word == "uut" else word, name, values_of(connection, column))


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
