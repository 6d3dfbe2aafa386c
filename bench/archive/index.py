"""Keeps the archive true: sessions are added, and looked at again from time to time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from bench.archive.examination import examined, reexamined
from bench.archive.places import Place, sessions_at
from bench.archive.work import Compute, in_parts
from bench.session.view import SOFTWARE
from bench.store import ArchivedSession, StoreError, enter_sessions, fingerprints

AT_ONCE = 20  # sessions of one transaction: what is lost when a long look is killed
Told = Callable[[str], None]


@dataclass(frozen=True)
class Known:
    """A session of the archive, to be looked at again; ``row``: as the database has it."""

    row: dict[str, Any]

    @property
    def name(self) -> str:
        """The session's own name."""
        return str(self.row["session"])


@dataclass
class Looked:
    """``sessions``: as they are now; ``unread``: places that could not be read, with why; ``unchanged``: how many."""

    sessions: list[ArchivedSession] = field(default_factory=list)
    unread: list[tuple[str, str]] = field(default_factory=list)
    unchanged: int = 0

    @property
    def damaged(self) -> list[ArchivedSession]:
        """Sessions that cannot be used, or are gone."""
        return [session for session in self.sessions if session.code]


def add(url: str, roots: Sequence[str], compute: Compute, done: Told, *, again: bool = False) -> Looked:
    """Enter the sessions in some folders; one that has the files of the last time is not read again.

    Args:   url: of the history; it is made if there is none.   roots: paths or URLs.   done: told of each session.
            again: read all.
    Raises: InputError B-ARC-002; StoreError B-STORE-001 to B-STORE-006.
    """
    places = {place.location: place for root in roots for place in sessions_at(root)}
    known = {} if again else _known(url)
    changed = [place for place in places.values() if known.get(place.location) != place.fingerprint]
    looked = Looked(unchanged=len(places) - len(changed))
    _enter(url, looked, compute(changed, examined), done)
    return looked


def _known(url: str) -> dict[str, str]:
    try:
        return fingerprints(url)
    except StoreError as error:
        if error.code == "B-STORE-007":  # the first session begins the archive
            return {}
        raise


def verify(url: str, rows: Iterable[dict[str, Any]], compute: Compute, done: Told) -> Looked:
    """Read sessions of the archive again, every byte, and note what is damaged, changed or gone.

    Raises: StoreError B-STORE-001 to B-STORE-006.
    """
    looked = Looked()
    _enter(url, looked, compute([Known(row) for row in rows], looked_at), done)
    return looked


def looked_at(known: Known) -> ArchivedSession:
    """Return a known session as it is now. Raises: OSError."""
    return reexamined(known.row)


def _enter(url: str, looked: Looked, outcomes: Iterable[tuple[Any, Any, str]], done: Told) -> None:
    for some in in_parts(_read(looked, outcomes, done), AT_ONCE):
        enter_sessions(url, some, SOFTWARE)
        looked.sessions += some


def _read(looked: Looked, outcomes: Iterable[tuple[Any, Any, str]], done: Told) -> Iterator[ArchivedSession]:
    for task, session, wrong in outcomes:
        if session is None:
            place = task.location if isinstance(task, Place) else str(task.row["location"])
            looked.unread.append((place, wrong))
        else:
            done(task.name)
            yield session
