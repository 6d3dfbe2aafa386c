"""Approvals: somebody stands for a revision of a calibration; nothing that was approved is ever changed."""

from __future__ import annotations

from dataclasses import dataclass

from bench.model.clock import Clock, WallClock
from bench.store.database import reading, writing
from bench.store.errors import StoreError
from bench.store.selection import find_calibration
from bench.store.tables import approvals


@dataclass(frozen=True)
class Approved:
    """The revision that was approved."""

    session: str
    revision: int
    report_sha256: str | None


def approve(
    url: str, name: str, by: str, statement: str, report_sha256: str | None = None, clock: Clock | None = None
) -> Approved:
    """Approve the newest revision of a calibration.

    Args:   url: of the history.   name: session or the beginning of its SHA-256.   by, statement: who says what.
            report_sha256: of the report that was looked at, if there is one: it must be the one of the newest revision.
    Raises: StoreError B-STORE-010 (nobody or nothing said, or another report), B-STORE-001 to B-STORE-009.
    """
    if not by.strip() or not statement.strip():
        raise StoreError(
            "B-STORE-010",
            "an approval needs a name and a statement",
            where=name,
            next_step="give both: --by NAME --statement TEXT",
        )
    with reading(url):  # an approval begins no history
        pass
    with writing(url, "") as connection:
        found = find_calibration(connection, name)
        if report_sha256 is not None and report_sha256 != found["report_sha256"]:
            raise StoreError(
                "B-STORE-010",
                f"the report in the folder is not the one of revision {found['revision']}",
                where=name,
                next_step="'bench history import SESSION' makes it a revision, then approve that",
            )
        row = {
            "revision_id": found["revision_id"],
            "approved_by": by.strip(),
            "statement": statement.strip(),
            "approved_utc_ns": (clock or WallClock()).utc_ns(),
        }
        connection.execute(approvals.insert(), row)
    return Approved(found["session"], found["revision"], found["report_sha256"])
