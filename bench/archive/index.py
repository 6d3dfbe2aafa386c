"""Keeps the archive true: sessions are added, and looked at again from time to time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from typing import Any

from bench.archive.census import Finding, Kind, damaged, unreadable
from bench.archive.diagnosis import ALTERED, COPIES, Due
from bench.archive.examination import Examination, examined
from bench.archive.places import list_places, released_at
from bench.archive.recomputation import differences
from bench.archive.work import Compute, in_parts
from bench.model.errors import BenchError, SessionDamaged
from bench.session.view import SOFTWARE
from bench.store import ArchivedSession, StoreError, enter_sessions, places_known

Row = dict[str, Any]
AT_ONCE = 20  # sessions of one transaction: what is lost when a long look is killed
_ONE_LIST: Row = {"campaign": {}}  # a manifest without units: of one recording they are told apart by condition
Told = Callable[[str], None]


def add(url: str, roots: Sequence[str], compute: Compute, done: Told, *, again: bool = False) -> list[Finding]:
    """Enter the sessions in some folders; returns what each folder is. A whole one that has the files of the last
    time is not read again.

    Args:   url: of the history; it is made if there is none.   roots: paths or URLs.   done: told of each session.
            again: read all.
    Raises: InputError B-ARC-002; StoreError B-STORE-001 to B-STORE-006.
    """
    places = {place.location: place for root in roots for place in list_places(root)}
    known = _known(url)
    findings, tasks = [], []
    for place in places.values():
        row = known.get(place.location)
        if isinstance(place, Finding):
            findings.append(place)
        elif row and not again and not row["code"] and row["fingerprint"] == place.fingerprint:
            findings.append(Finding(place.location, Kind.UNCHANGED))
        else:
            due = Due(row["session_sha256"], row["bytes"]) if row else Due()
            tasks.append(Examination(place, due, computes=row is not None and row["code"] == ALTERED))
    return _entered(url, findings, compute(tasks, examined), done)


def _known(url: str) -> dict[str, Row]:
    try:
        return places_known(url)
    except StoreError as error:
        if error.code == "B-STORE-007":  # the first session begins the archive
            return {}
        raise


def verify(url: str, rows: Iterable[Row], compute: Compute, done: Told) -> list[Finding]:
    """Read sessions of the archive again, every byte, compute their results, and note what is not as it was.

    Raises: StoreError B-STORE-001 to B-STORE-006.
    """
    return _entered(url, [], compute([Examination.again(row) for row in rows], examined), done)


def _entered(
    url: str, findings: list[Finding], outcomes: Iterable[tuple[Examination, Finding | None, str]], done: Told
) -> list[Finding]:
    """Enter what was read, as it is read; returns all findings by location."""
    for some in in_parts(_read(outcomes, done), AT_ONCE):
        enter_sessions(url, [finding.session for finding in some if finding.session], SOFTWARE)
        findings += some
    by_place = {finding.location: finding for finding in findings}
    sessions = [finding.session for finding in findings if finding.session and finding.session.session_sha256]
    differing = list(_differing(_known(url), {str(session.session_sha256) for session in sessions})) if sessions else []
    enter_sessions(url, [finding.session for finding in differing if finding.session], SOFTWARE)
    by_place |= {finding.location: finding for finding in differing if finding.location in by_place}
    return [by_place[location] for location in sorted(by_place)]


def _read(outcomes: Iterable[tuple[Examination, Finding | None, str]], done: Told) -> Iterator[Finding]:
    for task, finding, wrong in outcomes:
        if finding is None:
            yield unreadable(task.place.location, wrong)
        else:
            done(task.name)
            yield finding


def _differing(known: Mapping[str, Row], hashes: set[str]) -> Iterator[Finding]:
    """Yield each copy of some recordings whose results are not those of another copy; none of them is the right one."""
    rows = sorted((row for row in known.values() if row["session_sha256"] in hashes), key=_place_of)
    for _, group in groupby(rows, key=lambda row: row["session_sha256"]):
        copies = list(group)
        if len(copies) > 1:
            yield from _differing_of(copies)


def _place_of(row: Row) -> tuple[str, str]:
    return row["session_sha256"], row["location"]


def _differing_of(copies: Sequence[Row]) -> Iterator[Finding]:
    released = {}
    for row in copies:
        with suppress(OSError, BenchError):  # one that cannot be read is a finding of its own
            released[row["location"]] = released_at(row["location"], row["session_sha256"])
    for row in copies:
        own = released.get(row["location"])
        for location, other in released.items():
            rows = differences(own, other, _ONE_LIST) if own and other else []
            if rows and row["code"] in ("", COPIES):
                text = f"a copy of the same recording has other results, the first {rows[0]['quantity']}: {location}"
                step = "find out which one was released, and put its results.json into both"
                session = ArchivedSession(
                    row["location"], row["fingerprint"], row["bytes"], row["session"], row["session_sha256"]
                )
                yield damaged(session, SessionDamaged(COPIES, text, next_step=step))
                break
