"""What the history asks of a session: results of this recording, and when it began."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.record import SessionReader
from bench.store import StoreError, started_utc_ns

_CLOCK = frozenset({"/clock"})


def check_same_recording(results: Mapping[str, Any], session_sha256: str, where: str) -> None:
    """Refuse results that were computed from another recording. Raises: StoreError B-STORE-013."""
    computed_from = results["provenance"]["session_sha256"]
    if computed_from != session_sha256:
        raise StoreError(
            "B-STORE-013",
            f"results.json was computed from another recording ({computed_from[:12]}, this is {session_sha256[:12]})",
            where=where,
            next_step="'bench recover' says whether the recording is whole; without results.json they are computed",
        )


def began_utc_ns(reader: SessionReader, session: str) -> int | None:
    """Return when a session began: as its name says, else by its first pair of clocks; None if nothing says it."""
    named = started_utc_ns(session)
    if named is not None:
        return named
    message = next(reader.select(_CLOCK), None)
    return None if message is None else int(message.document()["t_utc_ns"])
