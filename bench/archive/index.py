"""Keeps the archive true: sessions are added, and looked at again from time to time.

One recorded session looked at: every byte of it verified, and what it says of itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.analysis import DOUBTFUL, REFUSED, estimates_of
from bench.archive.diagnosis import Recording, diagnosed
from bench.archive.issued import issued_of, standards_of
from bench.archive.places import Finding, Kind, brought_here, list_places, unreadable
from bench.archive.refit import computed_results, differences
from bench.archive.work import Compute, Outcome, in_parts
from bench.maths.verdict import worst
from bench.model.errors import InputError, InstallationError, SessionDamaged
from bench.model.installed import unforeseen
from bench.record import SessionReader
from bench.report import CERTIFICATE_FILE, SPECIMEN_FILE
from bench.session.released import began_utc_ns
from bench.session.view import SOFTWARE
from bench.store import ArchivedSession, Issued, StoreError, Unit, documents_of_units, enter_sessions, places_known


@dataclass(frozen=True)
class Examination:
    """A place to be read; ``session_sha256`` and ``bytes``: of its recording as archived, None and 0 if it never was.

    ``verifies``: its results are computed too, and another recording is not entered in its place.
    """

    location: str
    session_sha256: str | None = None
    bytes: int = 0
    verifies: bool = False


def examined(task: Examination) -> Finding:
    """Read a session whole; returns what it is, and what the index is to know of it.

    Raises: OSError if it cannot be read now, InstallationError if its analysis is not here: both say nothing of it.
    """
    known = ArchivedSession(task.location, "", 0, Path(task.location).name)
    try:
        with brought_here(task.location) as (folder, place):
            known = replace(known, fingerprint=place.fingerprint, bytes=place.bytes)
            recording = diagnosed(folder, task.session_sha256, place.bytes < task.bytes)
            if recording.fault is not None and recording.kind is not Kind.DAMAGED:
                fault = recording.fault
                return Finding(task.location, recording.kind, fault.code, fault.message, fault.next_step)
            for more in _read(folder, known, recording, task):
                known = more
    except (OSError, InstallationError):
        raise
    except Exception as error:  # of a session that nobody foresaw, too; it ends no other
        fault = unforeseen(error)
        known = replace(known, code=fault.code, fault=fault.message)
        return Finding(task.location, Kind.DAMAGED, fault.code, fault.message, fault.next_step, known)
    return Finding(task.location, Kind.ENTERED, session=known)


def _read(folder: Path, known: ArchivedSession, recording: Recording, task: Examination) -> Iterator[ArchivedSession]:
    """Yield what is known of a session, each time more: what was read before an error stays known."""
    reader = SessionReader(folder)
    with suppress(SessionDamaged):  # the manifest too
        known = _described(known, reader)
        yield known
    recording.check_archived(task.session_sha256 if task.verifies else None)
    manifest, results = reader.manifest, recording.results
    known = replace(known, session_sha256=recording.sha256)
    yield known
    if recording.results_fault is not None:
        raise recording.results_fault
    if results is not None:
        yield _released(known, results, manifest, folder)
        if task.verifies:
            _check_results(folder, results, manifest)


def _check_results(folder: Path, results: Mapping[str, Any], manifest: Mapping[str, Any]) -> None:
    """Refuse results that the recording does not give, computed with their method. Raises: SessionDamaged B-ARC-008."""
    rows = differences(results, computed_results(folder, str(results["method"]), {}), manifest)
    if rows:
        written, first = str(results["provenance"]["software"]), rows[0]
        raise SessionDamaged(
            "B-ARC-008",
            f"{len(rows)} of its results are not what the recording gives: {first['quantity']} {first['conditions']} "
            f"{first['released_value']}, computed {first['value']} {first['unit']}",
            next_step=f"look for the results.json that was released; it was written by {written}, this is {SOFTWARE}: "
            "if that is another release, its 'bench archive verify' decides",
        )


def _described(known: ArchivedSession, reader: SessionReader) -> ArchivedSession:
    """Return a session with what its manifest says. Raises: SessionDamaged B-REC-012, B-REC-014."""
    manifest = reader.manifest
    session = str(manifest.get("session", known.session))
    campaign = manifest.get("campaign", {})
    uut = campaign.get("uut", {})
    return replace(
        known,
        session=session,
        campaign=str(campaign.get("analysis", "none")),
        station=str(manifest.get("station", "")),
        started_utc_ns=began_utc_ns(reader, session),
        simulated=manifest.get("simulated") is not False,
        plan_sha256=str(manifest.get("plan_sha256", "")),
        frame_sha256=str(manifest.get("frame_sha256", {}).get(manifest.get("measurement_link"), "")),
        units=(Unit(str(uut.get("model", "")), str(uut.get("serial", ""))),),
        standards=standards_of(manifest),
    )


def _released(
    known: ArchivedSession, results: Mapping[str, Any], manifest: Mapping[str, Any], folder: Path
) -> ArchivedSession:
    qualities = {str(estimate.quality) for estimate in estimates_of(results)}
    checked = (manifest.get("campaign", {}).get("check_standard") or {}).get("serial")
    units = [document["uut"] for document in documents_of_units(results, manifest)]
    return replace(
        known,
        software=str(results["provenance"]["software"]),
        method=str(results["method"]),
        verdict=worst(str(estimate.verdict) for estimate in estimates_of(results)),
        quality=next((quality for quality in (REFUSED, DOUBTFUL) if quality in qualities), "sound"),
        units=tuple(Unit(str(uut["model"]), str(uut["serial"]), uut["serial"] == checked) for uut in units),
        certificates=tuple(_certificates(folder, known, results)),
    )


def _certificates(folder: Path, known: ArchivedSession, results: Mapping[str, Any]) -> Iterator[Issued]:
    """Yield the certificates of this recording in its folder; a file of others by that name is none."""
    for name in (CERTIFICATE_FILE, SPECIMEN_FILE):
        path = folder / name
        if not path.is_file():
            continue
        try:
            issued = issued_of(path.read_bytes(), results, known.standards)
        except InputError:
            continue
        if issued.session_sha256 == known.session_sha256:
            yield issued


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
    for some in in_parts(_findings(outcomes, done), AT_ONCE):
        enter_sessions(url, [finding.session for finding in some if finding.session], SOFTWARE)
        findings += some
    return sorted(findings, key=lambda finding: finding.location)


def _findings(outcomes: Iterable[Outcome], done: Told) -> Iterator[Finding]:
    for task, finding, wrong in outcomes:
        if finding is None:
            yield unreadable(task.location, wrong)
        else:
            done(task.location)
            yield finding
