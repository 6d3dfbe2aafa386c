"""What stands in a folder of sessions: each folder that is seen has exactly one kind, in exactly one count."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from bench.model.errors import BenchError, ExitStatus
from bench.store import ArchivedSession

AWAY = "B-ARC-007"
LATER = "look after storage, rights and workers, then give the same command again"


class Kind(StrEnum):
    """What a folder is to the archive; sub-folders of a session belong to it, and folders of folders are none."""

    ENTERED = "entered"  # a whole recording; one that is looked at again is verified
    UNCHANGED = "unchanged"
    DAMAGED = "damaged"
    UNREADABLE = "unreadable"
    UNFINISHED = "unfinished"
    STOPPED = "stopped"
    NO_RECORDING = "no_recording"
    LINK = "link"

    @property
    def words(self) -> str:
        """The kind as a person reads it."""
        return self.value.replace("_", " ")


@dataclass(frozen=True)
class Finding:
    """A place with its kind: why it is no whole session, and what to do; ``session``: what the index is to know."""

    location: str
    kind: Kind
    code: str = ""
    reason: str = ""
    next_step: str = ""
    session: ArchivedSession | None = None

    @property
    def row(self) -> dict[str, str]:
        """The finding as programs read it."""
        names = ("location", "code", "reason", "next_step")
        return {**{name: getattr(self, name) for name in names}, "kind": self.kind.value}


def unreadable(location: str, reason: str, next_step: str = LATER) -> Finding:
    """Return the finding for a place that cannot be read now, which says nothing of what lies there."""
    return Finding(location, Kind.UNREADABLE, AWAY, reason, next_step)


def damaged(session: ArchivedSession, error: BenchError) -> Finding:
    """Return the finding for a session that cannot be used, or whose results cannot."""
    faulty = session.with_fault(error.code, error.message)
    return Finding(session.location, Kind.DAMAGED, error.code, error.message, error.next_step, faulty)


def counts_of(findings: Iterable[Finding]) -> dict[Kind, int]:
    """Return how many places there are of each kind, of some none."""
    counts = dict.fromkeys(Kind, 0)
    for finding in findings:
        counts[finding.kind] += 1
    return counts


def status_of(counts: Mapping[Kind, int]) -> ExitStatus:
    """Return the exit status: damage is certain, and counts before what can be read another time."""
    if counts[Kind.DAMAGED]:
        return ExitStatus.SESSION_DAMAGED
    return ExitStatus.SAFE_AFTER_FAULT if counts[Kind.UNREADABLE] else ExitStatus.PASS
