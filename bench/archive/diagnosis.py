"""What a recording is by its length, its hash and its events: the one answer for add, verify and refit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.archive.places import Kind
from bench.model.errors import BenchError, SessionDamaged
from bench.model.events import End, Resume, event_of
from bench.model.segments import OPEN_MARKER
from bench.record import SessionReader, damaged
from bench.session.released import check_same_recording
from bench.session.verification import RESULTS, released_results
from bench.store import StoreError

_OTHER = "B-ARC-004"


@dataclass(frozen=True)
class Recording:
    """A recording with what was released of it; ``kind`` is ENTERED if it is whole and has ended.

    ``fault``: why it is not, or has not; ``results_fault``: why ``results`` is None although there is a results.json.
    """

    kind: Kind
    sha256: str
    fault: BenchError | None
    results: Mapping[str, Any] | None = None
    results_fault: BenchError | None = None

    def check_archived(self, sha256: str | None) -> None:
        """Refuse what is damaged, or is not the archived recording. Raises: the fault; SessionDamaged B-ARC-004."""
        if self.fault is not None:
            raise self.fault
        if sha256 not in (None, self.sha256):
            text = f"is not the recording that was archived ({str(sha256)[:12]}, this is {self.sha256[:12]})"
            step = "look for a copy; 'bench archive add --all' with this folder enters this one"
            raise SessionDamaged(_OTHER, text, next_step=step)


def diagnosed(folder: Path, archived_sha256: str | None, is_shorter: bool) -> Recording:
    """Read a recording whole and say what it is.

    Args:   archived_sha256: its hash in the index, None if it was never whole.   is_shorter: it has fewer bytes now.
    Raises: SessionDamaged B-REC-013; OSError if it cannot be read.
    """
    results, results_fault = None, None
    reader = SessionReader(folder)
    try:
        results = released_results(folder)
        if results is not None:
            check_same_recording(results, reader.sha256, "")
    except BenchError as error:
        results, results_fault = None, error
    kind, fault = Kind.ENTERED, None
    if reader.damage or reader.unfinished or (results is None and reader.sha256 != archived_sha256):
        kind, fault = _ended(reader, is_shorter)
    return Recording(kind, reader.sha256, fault, results, results_fault)


def _ended(reader: SessionReader, is_shorter: bool) -> tuple[Kind, BenchError | None]:
    """Return what a recording is of which nothing says that it is the archived or released one."""
    damage, is_open = reader.damage, (reader.folder / OPEN_MARKER).exists()
    told = (event_of(kind, fields) for kind, _, fields in reader.events())
    last = next((event for event in reversed(list(told)) if isinstance(event, End | Resume)), None)
    is_endless = bool(reader.unfinished) or not (damage or isinstance(last, End))
    if is_endless and is_open and not is_shorter:
        step = "wait for its end and add it again; 'bench resume' goes on with one that was killed"
        return Kind.UNFINISHED, _not_ended("is being recorded, or its run was killed (session.open)", step)
    has_results = (reader.folder / RESULTS).exists()  # a run that goes on has none yet
    if (is_shorter and damage) or (is_endless and (is_shorter or has_results)):
        step = "copy it again from where it is whole"
        return Kind.DAMAGED, SessionDamaged(_OTHER, "shorter than what was archived", next_step=step)
    if damage:
        return Kind.DAMAGED, damaged(reader.folder, damage)
    if reader.unfinished:
        step = "'bench recover' lists what it holds; if it is a copy, make it again"
        return Kind.DAMAGED, _not_ended("the run did not finish", step)
    if last is not None and (isinstance(last, Resume) or last.error is not None):
        return Kind.STOPPED, _not_ended("was stopped, nothing was released of it", "'bench resume' goes on with it")
    return Kind.ENTERED, None


def _not_ended(text: str, next_step: str) -> StoreError:
    return StoreError("B-STORE-013", text, next_step=next_step)
