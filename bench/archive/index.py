"""Keeps the archive true: sessions are added, and looked at again from time to time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from bench.archive.examination import Examination, examined
from bench.archive.places import Finding, Kind, list_places, unreadable
from bench.archive.work import Compute, Outcome, in_parts
from bench.session.view import SOFTWARE
from bench.store import StoreError, enter_sessions, places_known

Row = dict[str, Any]
AT_ONCE = 20  # sessions of one transaction: what is lost when a long look is killed
Told = Callable[[str], None]


def add(url: str, roots: Sequence[str], compute: Compute, done: Told, *, again: bool = False) -> list[Finding]:
    """Enter the sessions in some folders; returns what each folder is.

    One that has the files of the last time is not read again: it is what it was.

    Args:   url: of the history; it is made if there is none.   roots: paths or URLs.   done: told of each session.
            again: read all.
    Raises: InputError B-ARC-002; StoreError B-STORE-001 to B-STORE-006.
    """
    places = {place.location: place for root in roots for place in list_places(root)}
    known: dict[str, Row] = {}
    try:
        known = places_known(url)
    except StoreError as error:
        if error.code != "B-STORE-007":  # the first session begins the archive
            raise
    findings, tasks = [], []
    for place in places.values():
        row = known.get(place.location)
        if isinstance(place, Finding):
            findings.append(place)
        elif row is None:
            tasks.append(Examination(place.location))
        elif again or row["fingerprint"] != place.fingerprint:
            tasks.append(_again(row))
        else:
            kind = Kind.DAMAGED if row["code"] else Kind.UNCHANGED
            step = "mend it or copy it again; 'bench archive verify' reads it again"
            findings.append(Finding(place.location, kind, row["code"], row["fault"], step))
    return _entered(url, findings, compute(tasks, examined), done)


def _again(row: Row, *, verifies: bool = False) -> Examination:
    sha256 = row["session_sha256"]
    return Examination(row["location"], sha256, row["bytes"] if sha256 else 0, verifies)


def verify(url: str, rows: Iterable[Row], compute: Compute, done: Told) -> list[Finding]:
    """Read sessions of the archive again, every byte, compute their results, and note what is not as it was.

    Raises: StoreError B-STORE-001 to B-STORE-006.
    """
    return _entered(url, [], compute([_again(row, verifies=True) for row in rows], examined), done)


def _entered(url: str, findings: list[Finding], outcomes: Iterable[Outcome], done: Told) -> list[Finding]:
    """Enter what was read, as it is read; returns all findings by location."""
    for some in in_parts(_read(outcomes, done), AT_ONCE):
        enter_sessions(url, [finding.session for finding in some if finding.session], SOFTWARE)
        findings += some
    return sorted(findings, key=lambda finding: finding.location)


def _read(outcomes: Iterable[Outcome], done: Told) -> Iterator[Finding]:
    for task, finding, wrong in outcomes:
        if finding is None:
            yield unreadable(task.location, wrong)
        else:
            done(task.location)
            yield finding
