"""What a recording is by its length, its hash and its events: the one answer for add, verify and refit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.archive.census import Kind
from bench.model.errors import BenchError, InputError, SessionDamaged
from bench.model.events import Closed, End, Resume, event_of
from bench.model.segments import OPEN_MARKER
from bench.record import SessionReader
from bench.session.released import check_same_recording, released_results
from bench.store import StoreError

GONE, OTHER_RECORDING = "B-ARC-003", "B-ARC-004"
ALTERED, COPIES = "B-ARC-008", "B-ARC-009"
RESULTS_IN_QUESTION = (ALTERED, COPIES)  # of a recording that is whole
_COPY = "copy it again from where it is whole"
_OPEN = "is being recorded, or its run was killed (session.open)"
_WAIT = "wait for its end and add it again; 'bench resume' goes on with one that was killed"


@dataclass(frozen=True)
class Due:
    """What the index has of a place: the hash of its recording, None if it was never whole, and its bytes."""

    session_sha256: str | None = None
    bytes: int = 0


@dataclass(frozen=True)
class Recording:
    """A recording with what was released of it; ``kind`` is ENTERED if it is whole and has ended.

    ``fault``: why it is not, or has not; ``results_fault``: why ``results`` is None although there is a results.json.
    """

    kind: Kind
    sha256: str
    fault: BenchError | None = None
    results: Mapping[str, Any] | None = None
    results_fault: BenchError | None = None


def diagnosed(folder: Path, size: int, due: Due, where: str) -> Recording:
    """Read a recording whole and say what it is.

    Args:   size: bytes of the session.   due: what the index has of it.
    Raises: SessionDamaged B-REC-013; OSError if it cannot be read.
    """
    results, results_fault = _released(folder)
    reader = SessionReader(folder)
    is_shorter = due.session_sha256 is not None and size < due.bytes
    if reader.damage or reader.unfinished:
        has_finished = any((due.session_sha256, results, results_fault))
        kind, fault = _of_torn(reader, is_shorter, has_finished)
    else:
        kind, fault = _of_whole(reader, is_shorter, due, results)
    if fault is None and results is not None:
        try:
            check_same_recording(results, reader.sha256, where)
        except StoreError as error:
            results, results_fault = None, error
    return Recording(kind, reader.sha256, fault, results, results_fault)


def _released(folder: Path) -> tuple[Mapping[str, Any] | None, BenchError | None]:
    try:
        return released_results(folder), None
    except InputError as error:
        return None, error


def _of_whole(
    reader: SessionReader, is_shorter: bool, due: Due, results: Mapping[str, Any] | None
) -> tuple[Kind, BenchError | None]:
    """Return the kind of a recording of which every byte that is there is right: its last segments may be gone."""
    named = None if results is None else results["provenance"]["session_sha256"]
    if reader.sha256 in (due.session_sha256, named):
        return Kind.ENTERED, None
    last, is_closed = _ends(reader)
    is_named = results is not None and results["session"] == reader.manifest.get("session")
    if not is_closed and (is_shorter or (is_named and not _is_open(reader))):
        return Kind.DAMAGED, _shorter()
    if not is_closed and _is_open(reader):
        return Kind.UNFINISHED, _not_ended(_OPEN, _WAIT)
    if isinstance(last, Resume) or (last is not None and last.error is not None):
        return Kind.STOPPED, _not_ended("was stopped, nothing was released of it", "'bench resume' goes on with it")
    return Kind.ENTERED, None


def _of_torn(reader: SessionReader, is_shorter: bool, has_finished: bool) -> tuple[Kind, BenchError | None]:
    """Return the kind of a recording that is damaged or has no end; ``has_finished``: index or results say that."""
    damage, endless = reader.damage, reader.unfinished
    if endless and _is_open(reader) and not is_shorter:
        return Kind.UNFINISHED, _not_ended(_OPEN, _WAIT)
    if is_shorter or (endless and has_finished):
        return Kind.DAMAGED, _shorter()
    if damage:
        more = f" and {len(damage) - 1} more" if len(damage) > 1 else ""
        step = "'bench recover' lists what the session still holds"
        return Kind.DAMAGED, SessionDamaged("B-REC-011", f"{damage[0]}{more}", where=reader.folder, next_step=step)
    step = "'bench recover' lists what it holds; if it is a copy, make it again"
    return Kind.DAMAGED, _not_ended("the run did not finish", step)


def _is_open(reader: SessionReader) -> bool:
    return (reader.folder / OPEN_MARKER).exists()


def _not_ended(text: str, next_step: str) -> StoreError:
    return StoreError("B-STORE-013", text, next_step=next_step)


def _ends(reader: SessionReader) -> tuple[End | Resume | None, bool]:
    """Return the last event of a run's end or of its going on, and whether the recorder closed behind it."""
    told = (event_of(kind, fields) for kind, _, fields in reader.events())
    events = [event for event in told if isinstance(event, End | Resume | Closed)]
    turns = [event for event in events if not isinstance(event, Closed)]
    return (turns[-1] if turns else None), bool(events) and isinstance(events[-1], Closed)


def _shorter() -> SessionDamaged:
    return SessionDamaged(OTHER_RECORDING, "shorter than what was archived", next_step=_COPY)


def other_recording(due: str, sha256: str) -> SessionDamaged:
    """Return the error of a whole recording that is not the archived one."""
    text = f"is not the recording that was archived ({due[:12]}, this is {sha256[:12]})"
    return SessionDamaged(OTHER_RECORDING, text, next_step="look for a copy; 'bench archive add' enters this one")


def unforeseen(error: Exception) -> BenchError:
    """Return whatever a session or its analysis provoked as an error of that session, which ends no other."""
    text = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return BenchError("B-INT-001", text, next_step="report this with the session")
