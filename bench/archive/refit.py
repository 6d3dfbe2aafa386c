"""One archived session through today's decoder and analyses, beside what was released of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.archive.diagnosis import GONE, Due, diagnosed, other_recording, unforeseen
from bench.archive.places import Place, brought_here
from bench.archive.recomputation import EMPTY, Row, computed_results, rows_of
from bench.model.errors import BenchError
from bench.record import SessionReader
from bench.session.register import Register
from bench.session.view import SOFTWARE


@dataclass(frozen=True)
class RefitTask:
    """A session to be computed again; ``key``: its SHA-256, or its location if it was never read whole."""

    key: str
    location: str
    session: str
    started_utc: str
    campaign: str
    simulated: bool
    method: str | None
    register: Register
    bytes: int  # that were archived, 0 if it was never whole
    fault: str  # of the released results, which are not beside the new ones then

    @property
    def name(self) -> str:
        """Name that a person reads while it runs."""
        return self.session


def refit(task: RefitTask) -> list[Row]:
    """Return a row for each estimate of a session, or one row with the code of what kept it from giving any.

    The files of the session are read only, and lie on this machine while it is computed.
    Raises: OSError if it cannot be brought here now: that says nothing of the session.
    """
    head = {
        "session": task.session,
        "session_sha256": task.key,
        "started_utc": task.started_utc,
        "campaign": task.campaign,
        "simulated": task.simulated,
        "software": SOFTWARE,
    }
    try:
        with brought_here(task.location) as (folder, place):
            rows = _attempted(task, folder, place) or [{}]
    except FileNotFoundError:
        rows = [{"code": GONE, "fault": "there is no session any more"}]
    except BenchError as error:
        rows = [_row_of(error)]
    return [{**EMPTY, **head, **row} for row in rows]


def _attempted(task: RefitTask, folder: Path, place: Place) -> list[Row]:
    """Return the rows of a session; one that is not what was archived is told as add and verify tell it."""
    whole = task.key if task.bytes else None
    recording = diagnosed(folder, place.bytes, Due(whole, task.bytes), task.location)
    if recording.fault is not None:
        return [_row_of(recording.fault)]
    if whole not in (None, recording.sha256):
        return [_row_of(other_recording(task.key, recording.sha256))]
    released = None if task.fault else recording.results
    wrong = recording.results_fault
    fault = task.fault if wrong is None else f"{wrong.code}: {wrong.message}"
    try:
        now = computed_results(folder, task.method, task.register)
        return [{**row, "fault": fault} for row in rows_of(released, now, SessionReader(folder).manifest)]
    except BenchError as error:
        return [_row_of(error)]
    except OSError:
        raise
    except Exception as error:  # a fault of an analysis is the row of this session, and ends no other
        return [_row_of(unforeseen(error))]


def _row_of(error: BenchError) -> Row:
    return {"code": error.code, "fault": error.message}
