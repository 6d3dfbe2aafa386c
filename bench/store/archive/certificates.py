"""Certificates that were issued: by which number, for whom, of which session, with which standards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Connection, select

from bench.model.clock import Clock, WallClock
from bench.store.database import add_row, add_rows, reading, rows_of, writing
from bench.store.tables import certificates, certified_standards

Row = dict[str, Any]


@dataclass(frozen=True)
class UsedStandard:
    """A standard of a session, with the certificate that it had."""

    role: str
    model: str
    serial: str
    certificate: str


@dataclass(frozen=True)
class Issued:
    """A certificate, with the standards of its session.

    ``replaces``: number of the certificate that it stands for; ``issued``: day, "" if it does not say.
    """

    number: str
    certificate_sha256: str
    session: str
    session_sha256: str
    results_sha256: str
    report_sha256: str | None
    uut_model: str
    uut_serial: str
    customer: str
    issued: str
    specimen: bool
    replaces: str | None
    software: str
    method: str
    standards: tuple[UsedStandard, ...] = ()


def enter_certificate(url: str, issued: Issued, clock: Clock | None = None) -> None:
    """Enter a certificate into a history that exists; one that is known already changes nothing.

    Raises: StoreError B-STORE-007 if there is no history, B-STORE-001 to B-STORE-006.
    """
    with reading(url):  # a certificate begins no history
        pass
    with writing(url, issued.software) as connection:
        enter(connection, issued, (clock or WallClock()).utc_ns())


def enter(connection: Connection, issued: Issued, now_ns: int) -> None:
    """Enter a certificate within a transaction."""
    known = select(certificates.c.id).where(certificates.c.certificate_sha256 == issued.certificate_sha256)
    if connection.execute(known).first() is not None:
        return
    row = {name: value for name, value in vars(issued).items() if name != "standards"}
    number = add_row(connection, certificates, {**row, "entered_utc_ns": now_ns})
    add_rows(connection, certified_standards, map(vars, issued.standards), certificate_id=number)


def certificates_of(connection: Connection, rule: ColumnElement[bool]) -> list[Row]:
    """Return the certificates for which a rule holds, by number, each with the numbers that stand for it now."""
    query = select(certificates).where(rule).order_by(certificates.c.number, certificates.c.id)
    numbers = select(certificates.c.replaces, certificates.c.number).where(certificates.c.replaces.is_not(None))
    by_number: dict[str, list[str]] = {}
    for replaced, number in connection.execute(numbers.order_by(certificates.c.number)):
        by_number.setdefault(replaced, []).append(number)
    return [{**row, "replaced_by": by_number.get(row["number"], [])} for row in rows_of(connection, query)]


def certificate_document(row: Row) -> Row:
    """Return a certificate as people and programs are told of it."""
    return {name: value for name, value in row.items() if name not in ("id", "entered_utc_ns")}
