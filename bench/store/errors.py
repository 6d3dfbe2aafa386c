"""Errors of the history, as one sentence and the next step; a run prints them as a warning and goes on."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DatabaseError, SQLAlchemyError

from bench.model.errors import BenchError, ExitStatus

_LATER = "'bench history import SESSION'"
_LOCKED = (
    "B-STORE-003",
    "the history is locked by another program",
    f"wait until it is free, then {_LATER} adds what is missing",
)
_REFUSED = (
    "B-STORE-006",
    "the history cannot be written",
    f"check its permissions and the space on the disk, then {_LATER}",
)
_UNREACHABLE = (
    "B-STORE-002",
    "the history cannot be opened",
    f"check the folder or the server it names, then {_LATER}",
)
_DAMAGED = (
    "B-STORE-004",
    "this is no calibration history, or a damaged one",
    f"repair it, then {_LATER} adds what is missing",
)
_LOCKED_STATES = {"55P03", "57014", "40P01"}  # lock not available, statement cancelled by its time limit, deadlock
_REFUSED_STATES = {"25006", "42501", "53100"}  # read-only transaction, insufficient privilege, disk full


class StoreError(BenchError):
    """The calibration history cannot do what was asked; nothing of it was changed."""

    exit_status = ExitStatus.BAD_INPUT


_USERINFO = re.compile(r"(://[^:/@\s]*:)\S*@")
_PARAMETER = re.compile(r"(\b(?:ssl)?pass(?:word|wd|phrase)?\s*=\s*)('[^']*'|[^&;\s]*)", re.IGNORECASE)


def masked(url: str) -> str:
    """Return a URL without its password, in every form a password may have there, even if it is no URL at all.

    Between the name of a user and the last @, or as a parameter, also as the driver's own words ``password=...``.
    """
    return _PARAMETER.sub(r"\1***", _USERINFO.sub(r"\1***@", url))


@contextmanager
def explained(where: str) -> Iterator[None]:
    """Turn what the database library raises into a StoreError.

    Raises: StoreError B-STORE-002 (cannot be opened), B-STORE-003 (locked), B-STORE-004 (damaged or no history),
            B-STORE-006 (cannot be written).
    """
    try:
        yield
    except (SQLAlchemyError, sqlite3.Error) as error:
        original = getattr(error, "orig", None) or error
        text = masked(" ".join(str(original).split()))[:200]
        code, message, advice = _sqlite(original) if isinstance(original, sqlite3.Error) else _server(error, original)
        raise StoreError(code, f"{message} ({text})", where=where, next_step=advice) from error


def _sqlite(error: sqlite3.Error) -> tuple[str, str, str]:
    name = str(getattr(error, "sqlite_errorname", ""))
    if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
        return _LOCKED
    if name.startswith(("SQLITE_READONLY", "SQLITE_FULL", "SQLITE_IOERR", "SQLITE_PERM")):
        return _REFUSED
    if name.startswith("SQLITE_CANTOPEN"):
        return _UNREACHABLE
    return _DAMAGED


def _server(error: Exception, original: BaseException) -> tuple[str, str, str]:
    state = getattr(original, "sqlstate", None)
    if state in _LOCKED_STATES:
        return _LOCKED
    if state in _REFUSED_STATES:
        return _REFUSED
    if isinstance(error, DatabaseError) and state is not None and not state.startswith(("08", "28", "3D", "57P")):
        return _DAMAGED
    return _UNREACHABLE
