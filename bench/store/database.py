"""Opens a history for reading or writing: short waits, one transaction, the version of its tables checked first.

A history is a SQLite file or a PostgreSQL server, named by a URL.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, Select, Table, create_engine, event, inspect, select, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError
from sqlalchemy.pool import NullPool

from bench.store.errors import StoreError, explained, masked
from bench.store.tables import ARCHIVE, METADATA, STATED, VERSION, doubts, history

WAIT_S = 3
_WRITE_LIMIT_MS = 10_000
# A server that is gone without a word is given up as soon as a lock would be.
_DEAD_NETWORK = {
    "tcp_user_timeout": WAIT_S * 1000,
    "keepalives_idle": WAIT_S,
    "keepalives_interval": 1,
    "keepalives_count": 3,
}
_LOCK = 0x62656E6368  # any number, the same for every writer of this software

# From a version of the tables to the next one; a history is brought up to date when it is opened.
UPGRADES: Mapping[int, Callable[[Connection], None]] = {
    1: doubts.create,
    2: lambda connection: METADATA.create_all(connection, STATED),
    3: lambda connection: METADATA.create_all(connection, ARCHIVE),
}
_EXAMPLES = "use sqlite:///folder/history.sqlite or postgresql://user@host/database"


@contextmanager
def writing(url: str, software: str) -> Iterator[Connection]:
    """A transaction that writes all or nothing; the only writer meanwhile; the tables are made if there are none.

    Raises: StoreError B-STORE-001 to B-STORE-006; never later than a few seconds when others hold the history.
    """
    address = history_address(url)
    _make_folder(address)
    with explained(address.where), _transaction(address, write=True) as connection:
        _lock(connection)
        if not inspect(connection).has_table(history.name):
            _create(connection, address, software)
        _require_version(connection, address)
        yield connection


@contextmanager
def reading(url: str) -> Iterator[Connection]:
    """A transaction that reads one state of the history.

    Raises: StoreError B-STORE-007 if there is none yet, B-STORE-001 to B-STORE-005.
    """
    address = history_address(url)
    if address.file is not None and not address.file.is_file():
        raise _absent(address)
    with explained(address.where):
        with _transaction(address, write=False) as connection:
            if not inspect(connection).has_table(history.name):
                if inspect(connection).get_table_names():
                    raise _no_history(address)
                raise _absent(address)
            old = _version(connection, address) < VERSION
        if old:
            with writing(url, ""):  # brings it up to date
                pass
        with _transaction(address, write=False) as connection:
            _require_version(connection, address)
            yield connection


def rows_of(connection: Connection, query: Select[Any]) -> list[dict[str, Any]]:
    """Return the rows of a query, each by the names of its columns."""
    return [dict(row) for row in connection.execute(query).mappings()]


def add_row(connection: Connection, table: Table, row: Mapping[str, Any]) -> int:
    """Insert a row and return its key."""
    key = connection.execute(table.insert(), row).inserted_primary_key
    assert key is not None
    return int(key[0])


def add_rows(connection: Connection, table: Table, rows: Iterable[Mapping[str, Any]], **keys: int) -> None:
    """Insert rows, each with the same keys; none is no statement."""
    entries = [{**keys, **row} for row in rows]
    if entries:
        connection.execute(table.insert(), entries)


@contextmanager
def _transaction(address: Address, *, write: bool) -> Iterator[Connection]:
    engine = _sqlite(address, write) if address.file is not None else _postgresql(address, write)
    try:
        with engine.begin() as connection:
            yield connection
    finally:
        engine.dispose()


def _sqlite(address: Address, write: bool) -> Engine:
    """Return the library's own habit of committing before some statements is switched off: a transaction is one."""
    engine = create_engine(address.url, poolclass=NullPool, connect_args={"timeout": WAIT_S, "isolation_level": None})

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        connection.exec_driver_sql("PRAGMA foreign_keys = ON")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    return engine


def _postgresql(address: Address, write: bool) -> Engine:
    options = f"-c lock_timeout={WAIT_S * 1000}"
    if write:
        options += f" -c statement_timeout={_WRITE_LIMIT_MS}"
    else:
        options += " -c default_transaction_read_only=on -c default_transaction_isolation=repeatable\\ read"
    arguments = {"connect_timeout": WAIT_S, "options": options, **_DEAD_NETWORK}
    return create_engine(address.url, poolclass=NullPool, connect_args=arguments)


def _lock(connection: Connection) -> None:
    """One writer at a time; a SQLite transaction of ours is that already."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})


def _create(connection: Connection, address: Address, software: str) -> None:
    """Make the tables; not beside those of somebody else in one SQLite file."""
    if address.file is not None and inspect(connection).get_table_names():
        raise _no_history(address)
    METADATA.create_all(connection)
    connection.execute(history.insert(), {"version": VERSION, "software": software})


def _version(connection: Connection, address: Address) -> int:
    versions = connection.execute(select(history.c.version)).scalars().all()
    if len(versions) != 1:
        raise _no_history(address)
    return int(versions[0])


def _require_version(connection: Connection, address: Address) -> None:
    """Bring older tables up to date. Raises StoreError B-STORE-005 for tables of a later or unknown version."""
    before = version = _version(connection, address)
    while version < VERSION and version in UPGRADES:
        UPGRADES[version](connection)
        version += 1
    if version != VERSION:
        raise StoreError(
            "B-STORE-005",
            f"the history has tables of version {version}, this software knows version {VERSION}",
            where=address.where,
            next_step="use the release that wrote it, or import the sessions into a new history",
        )
    if before != version:
        connection.execute(history.update(), {"version": version})


def _make_folder(address: Address) -> None:
    try:
        if address.file is not None:
            address.file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(
            "B-STORE-002",
            f"the folder of the history cannot be made ({error.strerror})",
            where=address.where,
            next_step="name another with --history, then 'bench history import SESSION'",
        ) from error


def _absent(address: Address) -> StoreError:
    return StoreError(
        "B-STORE-007",
        "there is no history yet",
        where=address.where,
        next_step="'bench run' begins one, 'bench history import SESSION' adds a session; --history names another",
    )


def _no_history(address: Address) -> StoreError:
    return StoreError(
        "B-STORE-004",
        "this is a database, but no calibration history",
        where=address.where,
        next_step="name another with --history",
    )


@dataclass(frozen=True)
class Address:
    """A history that can be opened; ``where`` names it without its password."""

    url: URL
    where: str

    @property
    def file(self) -> Path | None:
        """The file of a SQLite history, also of one written as a URI (file:...?uri=true)."""
        if self.url.get_backend_name() != "sqlite":
            return None
        return Path(str(self.url.database).removeprefix("file:"))


def history_address(url: str) -> Address:
    """Read the URL of a history. Raises: StoreError B-STORE-001 if it is no URL, or its driver is not installed."""
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise StoreError("B-STORE-001", f"{masked(url)!r} is no address of a history", next_step=_EXAMPLES) from error
    where = masked(url)
    backend = parsed.get_backend_name()
    if backend == "sqlite" and parsed.database not in (None, "", ":memory:"):
        return Address(parsed.set(drivername="sqlite+pysqlite"), where)
    if backend != "postgresql":
        raise StoreError(
            "B-STORE-001", "only SQLite files and PostgreSQL servers are known", where=where, next_step=_EXAMPLES
        )
    if find_spec("psycopg") is None:
        raise StoreError(
            "B-STORE-001",
            "the PostgreSQL driver is not installed",
            where=where,
            next_step="install it with: pip install 'inertial-bench[postgresql]'",
        )
    return Address(parsed.set(drivername="postgresql+psycopg"), where)
