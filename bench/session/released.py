"""What a session says of its own release: the results in its folder, of this recording, and when it began."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.analysis import validate_results
from bench.model.errors import InputError
from bench.record import SessionReader
from bench.store import StoreError, started_utc_ns

_CLOCK = frozenset({"/clock"})


def released_results(folder: Path) -> Mapping[str, Any] | None:
    """Return results.json of a session, None without one. Raises: InputError B-FIT-010 if it is not in its form."""
    path = folder / "results.json"
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise InputError(
            "B-FIT-010",
            f"cannot be read ({error})",
            where=str(path),
            next_step="remove it to have the results computed again",
        ) from error
    validate_results(document, str(path))
    results: Mapping[str, Any] = document
    return results


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
