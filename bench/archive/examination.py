"""One recorded session looked at: every byte of it verified, and what it says of itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.analysis import DOUBTFUL, REFUSED
from bench.archive.issued import issued_of, standards_of
from bench.archive.places import Place, brought_here
from bench.maths.verdict import worst
from bench.model.errors import BenchError, InputError
from bench.record import SessionReader
from bench.report import CERTIFICATE_FILE, SPECIMEN_FILE
from bench.session.released import began_utc_ns, check_same_recording, released_results
from bench.store import ArchivedSession, Issued, StoreError, Unit, documents_of_units

GONE, OTHER_RECORDING = "B-ARC-003", "B-ARC-004"


def examined(place: Place) -> ArchivedSession:
    """Read a session whole; what keeps it from being used stands in ``code`` and ``fault``.

    Raises: OSError if it cannot be read now: that says nothing of the session.
    """
    known = ArchivedSession(place.location, place.fingerprint, place.bytes, place.name)
    try:
        with brought_here(place.location) as (folder, now):
            for more in _read(folder, replace(known, fingerprint=now.fingerprint, bytes=now.bytes)):
                known = more
    except FileNotFoundError:
        return replace(known, code=GONE, fault="there is no session any more")
    except BenchError as error:
        return replace(known, session_sha256=None, code=error.code, fault=error.message)
    return known


def reexamined(archived: Mapping[str, Any]) -> ArchivedSession:
    """Read a session that is known; one that is whole, but another recording, is told by its code. Raises: OSError."""
    place = Place(archived["location"], archived["bytes"], archived["fingerprint"])
    seen, due = examined(place), archived["session_sha256"]
    if seen.code or due in (None, seen.session_sha256):
        return seen
    fault = f"is not the recording that was archived ({str(due)[:12]}, this is {str(seen.session_sha256)[:12]})"
    return replace(seen, session_sha256=None, code=OTHER_RECORDING, fault=fault)


def _read(folder: Path, known: ArchivedSession) -> Iterator[ArchivedSession]:
    """Yield what is known of a session, each time more: what was read before an error stays known."""
    reader = SessionReader(folder, strict=True)
    manifest = reader.manifest
    session = str(manifest.get("session", known.session))
    campaign = manifest.get("campaign", {})
    uut = campaign.get("uut", {})
    known = replace(
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
    yield known
    sha256 = reader.sha256
    if reader.unfinished:
        raise StoreError("B-STORE-013", "the run did not finish", where=known.location)
    known = replace(known, session_sha256=sha256)
    results = released_results(folder)
    if results is not None:
        check_same_recording(results, sha256, known.location)
        known = _released(known, results, manifest, folder)
    yield known


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
