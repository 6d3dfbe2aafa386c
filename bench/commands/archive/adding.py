"""``bench archive add`` and ``verify``: sessions are entered, and read again."""

from __future__ import annotations

from collections.abc import Sequence

from bench.archive import index
from bench.archive.index import Looked
from bench.archive.selecting import selection_of
from bench.commands.archive.computing import compute_at
from bench.commands.archive.progress import Lines
from bench.commands.console import console, print_json
from bench.model.errors import ExitStatus
from bench.store import list_sessions


def add(url: str, folders: Sequence[str], everything: bool, dask: str | None, as_json: bool) -> int:
    """Enter sessions; returns 5 if one is damaged or cannot be read, else 0."""
    looked = index.add(url, folders, compute_at(dask), Lines().session, again=everything)
    return _tell(looked, "entered", as_json)


def verify(url: str, select: Sequence[str], dask: str | None, as_json: bool) -> int:
    """Read sessions of the archive again; returns 5 if one is damaged, changed, gone or cannot be read, else 0."""
    rows = list_sessions(url, selection_of(select))
    lines = Lines()
    lines.begin(len(rows), 0)
    return _tell(index.verify(url, rows, compute_at(dask), lines.session), "verified", as_json)


def _tell(looked: Looked, done: str, as_json: bool) -> int:
    damaged = [(session.location, session.code, session.fault) for session in looked.damaged]
    total = sum(session.bytes for session in looked.sessions)
    if as_json:
        names = ("location", "code", "fault")
        document = {
            done: len(looked.sessions),
            "bytes": total,
            "unchanged": looked.unchanged,
            "damaged": [dict(zip(names, entry, strict=True)) for entry in damaged],
            "unread": [{"location": location, "fault": fault} for location, fault in looked.unread],
        }
        print_json(document, ensure_ascii=False)
    else:
        out = console()
        for location, code, fault in damaged:
            out.print(f"{code:<12} {location}: {fault}")
        for location, fault in looked.unread:
            out.print(f"{'not read':<12} {location}: {fault}")
        counts = f"{len(looked.sessions)} sessions {done} ({total / 1e6:.1f} MB), {len(damaged)} damaged"
        out.print(f"{counts}, {len(looked.unread)} not read, {looked.unchanged} unchanged")
    return ExitStatus.SESSION_DAMAGED if damaged or looked.unread else ExitStatus.PASS
