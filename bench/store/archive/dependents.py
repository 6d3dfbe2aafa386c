"""What depends on a word that a person knows: a unit, a standard, a certificate, a frame definition, a release."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, or_, select

from bench.store.archive.certificates import certificates_of
from bench.store.archive.sessions import archived, called, has
from bench.store.database import reading
from bench.store.selection import unknown
from bench.store.tables import archived_sessions, archived_standards, archived_units, certificates, certified_standards

Row = dict[str, Any]
_LEAST_HASH = 6


@dataclass(frozen=True)
class Dependents:
    """``kinds``: what the word is (unit, standard, ...); the sessions and certificates that depend on it."""

    kinds: tuple[str, ...]
    sessions: list[Row]
    certificates: list[Row]


def dependents(url: str, word: str) -> Dependents:
    """Return every archived session and every certificate that depends on a word, whatever it names.

    Raises: StoreError B-STORE-009 if it names nothing, B-STORE-001 to B-STORE-005, B-STORE-007.
    """
    with reading(url) as connection:
        meanings = _meanings(word)
        found = {kind: rows for kind, rule in meanings.items() if (rows := archived(connection, rule))}
        sessions = {row["id"]: row for rows in found.values() for row in rows}
        these = select(archived_sessions.c.session_sha256).where(or_(*meanings.values()))
        issued = certificates_of(connection, or_(_names(word), certificates.c.session_sha256.in_(these)))
        if any(row["number"] == word for row in issued):
            found["certificate"] = []
        if not sessions and not issued:
            known = select(archived_units.c.serial).union(select(archived_standards.c.certificate))
            raise unknown("word", word, sorted(connection.execute(known).scalars().all()))
    order = sorted(sessions.values(), key=lambda row: (row["started_utc_ns"] or 0, row["session"], row["location"]))
    return Dependents(tuple(found), order, issued)


def _meanings(word: str) -> dict[str, ColumnElement[bool]]:
    columns = archived_sessions.c
    meanings = {
        "unit": has(archived_units, called(archived_units, word)),
        "standard": has(archived_standards, called(archived_standards, word)),
        "certificate of a standard": has(archived_standards, archived_standards.c.certificate == word),
        "software": columns.software == word,
        "session": columns.session == word,
    }
    if len(word) >= _LEAST_HASH:
        beginning = word.lower()
        meanings["frame"] = columns.frame_sha256.startswith(beginning, autoescape=True)
        meanings["hash of a session"] = columns.session_sha256.startswith(beginning, autoescape=True)
    return meanings


def _names(word: str) -> ColumnElement[bool]:
    """Return the rule that a certificate names a word itself."""
    standards = certified_standards
    of_standards = select(standards.c.certificate_id).where(
        or_(called(standards, word), standards.c.certificate == word)
    )
    return or_(
        certificates.c.number == word,
        certificates.c.uut_serial == word,
        certificates.c.uut_model + " " + certificates.c.uut_serial == word,
        certificates.c.software == word,
        certificates.c.id.in_(of_standards),
    )
