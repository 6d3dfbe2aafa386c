"""One recorded session looked at: every byte of it verified, and what it says of itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.analysis import DOUBTFUL, REFUSED
from bench.archive.census import Finding, Kind, damaged
from bench.archive.diagnosis import ALTERED, GONE, Due, diagnosed, other_recording, unforeseen
from bench.archive.issued import issued_of, standards_of
from bench.archive.places import Place, brought_here
from bench.archive.recomputation import computed_results, differences
from bench.maths.verdict import worst
from bench.model.errors import BenchError, InputError, InstallationError, SessionDamaged
from bench.record import SessionReader
from bench.report import CERTIFICATE_FILE, SPECIMEN_FILE
from bench.session.released import began_utc_ns
from bench.session.view import SOFTWARE
from bench.store import ArchivedSession, Issued, Unit, documents_of_units


@dataclass(frozen=True)
class Examination:
    """A place to be read; ``due``: what the index has of it.

    ``computes``: the results too, and compares them.   ``verifies``: another recording is not entered in its place.
    """

    place: Place
    due: Due
    computes: bool = False
    verifies: bool = False

    @property
    def name(self) -> str:
        """The folder's own name, which a person reads while it is looked at."""
        return self.place.name

    @classmethod
    def again(cls, row: Mapping[str, Any]) -> Examination:
        """Return what reads a session of the archive again, given its row."""
        place = Place(row["location"], row["bytes"], row["fingerprint"])
        return cls(place, Due(row["session_sha256"], row["bytes"]), computes=True, verifies=True)


def examined(task: Examination) -> Finding:
    """Read a session whole; returns what it is, and what the index is to know of it.

    Raises: OSError if it cannot be read now, InstallationError if its analysis is not here: both say nothing of it.
    """
    place = task.place
    known = ArchivedSession(place.location, place.fingerprint, place.bytes, place.name)
    try:
        with brought_here(place.location) as (folder, now):
            known = replace(known, fingerprint=now.fingerprint, bytes=now.bytes)
            return _read(folder, known, task)
    except FileNotFoundError:
        gone = "bring it back, or add the place where it is now"
        return damaged(known, SessionDamaged(GONE, "there is no session any more", next_step=gone))
    except (OSError, InstallationError):
        raise
    except BenchError as error:
        return damaged(known, error)
    except Exception as error:  # of a session that nobody foresaw; it ends no other
        return damaged(known, unforeseen(error))


def _read(folder: Path, known: ArchivedSession, task: Examination) -> Finding:
    """Return what a session that lies here is; of a damaged one too what could be read."""
    recording = diagnosed(folder, known.bytes, task.due, known.location)
    fault, sha256, due = recording.fault, recording.sha256, task.due.session_sha256
    if fault is not None and recording.kind is not Kind.DAMAGED:
        return Finding(known.location, recording.kind, fault.code, fault.message, fault.next_step)
    try:
        reader = SessionReader(folder)
        known = _described(known, reader)
    except SessionDamaged as error:
        return damaged(known, fault or error)
    if fault is None and task.verifies and due not in (None, sha256):
        fault = other_recording(str(due), sha256)
    if fault is None:
        known, fault = replace(known, session_sha256=sha256), recording.results_fault
        if recording.results is not None:
            known = _released(known, recording.results, reader.manifest, folder)
            fault = _altered(folder, recording.results, reader.manifest) if task.computes else None
    return Finding(known.location, Kind.ENTERED, session=known) if fault is None else damaged(known, fault)


def _altered(folder: Path, results: Mapping[str, Any], manifest: Mapping[str, Any]) -> BenchError | None:
    """Return the error of results that the recording does not give, computed again with their method."""
    rows = differences(results, computed_results(folder, str(results["method"]), {}), manifest)
    if not rows:
        return None
    written, first = str(results["provenance"]["software"]), rows[0]
    text = f"{len(rows)} of its results are not what the recording gives: {first['quantity']} {first['conditions']} "
    text += f"{first['released_value']}, computed {first['value']} {first['unit']}"
    step = "look for the results.json that was released"
    if written != SOFTWARE:
        step += f"; it was written by {written}, this is {SOFTWARE}: 'bench archive verify' of that release decides"
    return SessionDamaged(ALTERED, text, next_step=step)


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
    qualities = {str(estimate.get("quality", "sound")) for estimate in results["estimates"]}
    checked = (manifest.get("campaign", {}).get("check_standard") or {}).get("serial")
    units = [document["uut"] for document in documents_of_units(results, manifest)]
    return replace(
        known,
        software=str(results["provenance"]["software"]),
        method=str(results["method"]),
        verdict=worst(str(estimate["verdict"]) for estimate in results["estimates"]),
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
