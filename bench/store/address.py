"""Where the history is: a SQLite file or a PostgreSQL server, as a URL."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from bench.store.errors import StoreError

VARIABLE = "BENCH_HISTORY"
_EXAMPLES = "use sqlite:///folder/history.sqlite or postgresql://user@host/database"


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


def chosen_url(asked: str | None, out: Path, environment: Mapping[str, str]) -> str:
    """The history asked for, else the one of BENCH_HISTORY, else history.sqlite in the folder of the sessions."""
    return asked or environment.get(VARIABLE) or f"sqlite:///{out / 'history.sqlite'}"


def history_address(url: str) -> Address:
    """Read the URL of a history. Raises: StoreError B-STORE-001 if it is none, or its driver is not installed."""
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise StoreError("B-STORE-001", f"{url!r} is no address of a history", next_step=_EXAMPLES) from error
    where = parsed.render_as_string(hide_password=True)
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


def check_history_url(url: str) -> None:
    """Before a run of days: an address that can never be opened. Raises: StoreError B-STORE-001."""
    history_address(url)
