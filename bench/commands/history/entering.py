"""``bench history import``: a recorded session, with the results it holds, into the history."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.commands.console import print_json, say, warn
from bench.commands.requests import Place
from bench.model.errors import BenchError, ExitStatus
from bench.record import SessionReader
from bench.report import Laboratory, laboratory_of
from bench.session.released import began_utc_ns, check_same_recording
from bench.session.service import analysed
from bench.session.verification import released_results
from bench.store import Recorded, StoreError, digest_of_file, record_calibration

NO_ANALYSIS = "none"


def import_sessions(sessions: list[Path], reason: str, place: Place, as_json: bool) -> int:
    """Add each session; what cannot be added is said, and the others are added all the same.

    ``sessions/*`` also names the history itself, files of simulated truth and recordings without an analysis: with
    other names beside them these are passed over, each with a line.
    """
    url = place.of([str(folder) for folder in sessions])
    done: list[Recorded] = []
    status: int = ExitStatus.PASS
    for folder in sessions:
        try:
            if len(sessions) > 1 and (why := _no_calibration(folder)):
                warn(f"{'skipped':<10} {folder}: {why}")
            else:
                done.append(import_session(url, folder, reason))
        except BenchError as error:
            warn(error)
            status = error.exit_status
    if as_json:
        print_json({"sessions": [vars(recorded) for recorded in done]})
    else:
        for recorded in done:
            say(f"{recorded.outcome:<10} {recorded.session}, revision {recorded.revision}")
    return status


def _no_calibration(folder: Path) -> str:
    """Return why something beside the sessions is no session of a calibration, else ""."""
    if folder.is_file():
        return "a file, no session"
    analysis = SessionReader(folder).manifest["campaign"].get("analysis", NO_ANALYSIS)
    return "its sequence asks for no analysis" if analysis == NO_ANALYSIS else ""


def import_session(url: str, folder: Path, reason: str = "") -> Recorded:
    """Add one session with its results.json (computed again if it is lost) and the hash of its report.

    Raises: StoreError B-STORE-001 to B-STORE-006 (the history), B-STORE-008 (the documents), B-STORE-013 (the run did
            not finish, or the results are of another recording); InputError B-REC-010, B-CLI-008, B-FIT-010;
            SessionDamaged B-REC-011, B-REC-012.
    """
    reader = SessionReader(folder)
    manifest, report = reader.manifest, folder / "report.html"
    document = released_results(folder) or _computed(reader)
    check_same_recording(document, reader.sha256, str(folder))
    laboratory = laboratory_of(folder)
    return record_calibration(
        url,
        document,
        manifest,
        digest_of_file(report) if report.is_file() else None,
        reason=reason,
        started_utc_ns=began_utc_ns(reader, str(document["session"])),
        adjustment=None if laboratory is None else _adjustment(laboratory),
    )


def _computed(reader: SessionReader) -> Mapping[str, Any]:
    """Return results of a whole session that has none."""
    if reader.unfinished:
        raise StoreError(
            "B-STORE-013",
            "the run did not finish and has no results",
            where=reader.folder,
            next_step="'bench fit' prints what its records give; only complete campaigns enter the history",
        )
    return analysed(reader.folder, None, strict=True)[0]


def _adjustment(laboratory: Laboratory) -> tuple[str, str, str] | None:
    """Return what the laboratory says of the unit around an adjustment, and who signs for it."""
    if laboratory.adjustment is None:
        return None
    signs = next(person.name for person in laboratory.responsible if person.signs)
    return laboratory.adjustment.results, laboratory.adjustment.what, signs
