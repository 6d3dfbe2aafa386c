"""``bench report --verify``: everything derived again from the raw bytes, and compared; nothing is written.

Of a certificate the hashes it names and every number of its results are compared; of the trend, from which the page
draws its history, every byte.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

from bench.analysis import results_json, without_check_standard
from bench.commands.console import console, print_json
from bench.frame import BENCH
from bench.model.errors import BenchError, ExitStatus, InputError, SessionDamaged
from bench.record import FOLDER, HEAD, LEVELS_S, OPEN_MARKER, SessionReader, read_head
from bench.replay import build_trend
from bench.report import (
    CERTIFICATE_FILE,
    DCC,
    SPECIMEN_FILE,
    Calibration,
    certificate_text,
    laboratory_of,
    nobody,
    session_of,
)
from bench.session.one_unit import serials_of
from bench.session.service import read_view
from bench.session.units import in_each_unit
from bench.session.verification import (
    REPORT,
    RESULTS,
    Pages,
    Verification,
    check_coefficients,
    check_reports,
    check_results,
    no_results,
)
from bench.session.view import SessionView, analyse_view

FILES = {"results": RESULTS, "report": REPORT}
_RESULTS = f".//{{{DCC}}}results"
_ANY_DAY = date(2000, 1, 1)  # stands nowhere in what is compared
ADVICE = "it is no part of the recording: remove the folder 'trend', and the page makes it again"


def verify(folder: Path, as_json: bool) -> int:
    """Say "identical", or list what the session does not give.

    Raises: SessionDamaged B-CLI-012 if a segment is damaged or a file is not what the session gives; InputError
    B-CLI-010 if there are no results to compare with, B-REC-010 if there is no session; BenchError of the analysis.
    """
    if serials_of(SessionReader(folder).manifest):
        return in_each_unit(folder, lambda home: verify(home, as_json))
    verification = Verification()
    view = read_view(folder)
    _segments(verification, folder, view)
    try:
        _computed(verification, folder, view)
    except BenchError as error:
        if not verification.changes:
            raise
        verification.add(RESULTS, f"cannot be derived from what is left: {error.code}: {error.message}")
    check_trend(verification, folder)
    _tell(verification, folder, view, as_json)
    if verification.changes:
        raise SessionDamaged(
            "B-CLI-012",
            f"{len(verification.changes)} things are not what the raw bytes of the session give, they are listed above",
            where=folder,
            next_step="compare with a copy of the session; 'bench recover' lists what a damaged one still holds",
        )
    return ExitStatus.PASS


def _segments(verification: Verification, folder: Path, view: SessionView) -> None:
    """Every segment is verified on the way: CRCs, running numbers, hash chain."""
    verification.compared += sorted(path.name for path in folder.glob("session.*.mcap"))
    for place in view.damage:
        verification.add(place.segment, place.inside)
    verification.notes += view.notes


def _computed(verification: Verification, folder: Path, view: SessionView) -> None:
    if not view.has_analysis:
        verification.notes.append("the sequence of this session asks for no analysis: there is nothing to derive")
        return
    results, analysis = analyse_view(view)
    stored = check_results(verification, folder, results)
    if stored is None and not verification.changes:
        raise no_results(folder)
    check_reports(verification, folder, Pages(view, results, analysis, stored or {}, laboratory_of(folder)))
    check_coefficients(verification, folder, view, results, analysis)
    check_certificates(verification, folder, view.manifest, results)


def _tell(verification: Verification, folder: Path, view: SessionView, as_json: bool) -> None:
    if as_json:
        print_json(_document(verification, folder, view), ensure_ascii=False)
        return
    out = console()
    for change in verification.changes:
        out.print(str(change))
    for note in verification.notes:
        out.print(f"note: {note}")
    if verification.absent:
        out.print(f"not there: {', '.join(verification.absent)}")
    if not verification.changes:
        out.print(
            f"identical: {folder}: {', '.join(_shortened(verification.compared))}; {len(view.rows)} records, "
            f"{view.counts['frames']} frames, session sha256 {view.session_sha256}"
        )


def _shortened(names: list[str]) -> list[str]:
    """Return names of files; of many segments the number."""
    segments = [name for name in names if name.endswith(".mcap")]
    return [f"{len(segments)} segments" if len(segments) != 1 else segments[0], *names[len(segments) :]]


def _document(verification: Verification, folder: Path, view: SessionView) -> dict[str, Any]:
    return {
        "session": str(folder),
        "identical": not verification.changes,
        "session_sha256": view.session_sha256,
        "records": len(view.rows),
        **view.counts,
        "compared": verification.compared,
        "absent": verification.absent,
        "changes": [{"file": change.file, "what": change.what} for change in verification.changes],
        "notes": verification.notes,
    }


def check_certificates(
    verification: Verification, folder: Path, manifest: Mapping[str, Any], results: Mapping[str, Any]
) -> None:
    """Compare the certificates that are in the session's folder; what a laboratory says of itself is not compared."""
    results = json.loads(results_json(results))  # as a certificate reads them: conditions in the order of the file
    for name in (CERTIFICATE_FILE, SPECIMEN_FILE):
        content = verification.content(folder / name) if (folder / name).exists() else None
        if content is None:
            continue
        try:
            verification.add(name, *_hashes(content, folder, results), *_numbers(content, manifest, results))
        except InputError as error:
            verification.add(name, error.message)


def _hashes(content: bytes, folder: Path, results: Mapping[str, Any]) -> list[str]:
    certified = session_of(content)
    wrong = []
    if certified.hashes["session"] != results["provenance"]["session_sha256"]:
        wrong.append(f"is of another recording, {certified.session} {certified.hashes['session']}")
    for key, name in FILES.items():
        path = folder / name
        if key in certified.hashes and path.is_file():
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            if digest != certified.hashes[key]:
                wrong.append(f"is of another {name}: sha256 {certified.hashes[key]} -> {digest}")
    return wrong


def _numbers(content: bytes, manifest: Mapping[str, Any], results: Mapping[str, Any]) -> list[str]:
    """Return where the results of a certificate are not those of the session."""
    specimen = session_of(content).specimen
    of_unit = without_check_standard(results, manifest.get("campaign", {}))
    calibration = Calibration(of_unit, manifest, nobody(), {}, _ANY_DAY, _ANY_DAY, specimen=specimen)
    said, due = _leaves(content), _leaves(certificate_text(calibration).encode())
    if said == due:
        return []
    if len(said) != len(due):
        return [f"its results have {len(said)} entries, the session gives {len(due)}"]
    return [f"results: {value} -> {other}" for value, other in zip(said, due, strict=True) if value != other][:5]


def _leaves(content: str | bytes) -> list[str]:
    """Return every text and name below the results, in order; references to other parts are the laboratory's."""
    texts = []
    for results in ET.fromstring(content).findall(_RESULTS):
        for element in results.iter():
            marks = sorted(f"{key}={value}" for key, value in element.attrib.items() if not key.endswith("refId"))
            texts.append(" ".join([element.tag.rpartition("}")[2], *marks, (element.text or "").strip()]).strip())
    return texts


def check_trend(verification: Verification, folder: Path) -> None:
    """Make the trend again and compare its files byte by byte; what differs is noted, with what to do.

    Of the bench's own temperatures nothing is compared: a trend that is made again knows the times of set-points by the
    plan alone (docs/session-format.md). A session that is damaged or not closed is not looked at.
    """
    if verification.changes or (folder / OPEN_MARKER).exists() or not (folder / FOLDER).is_dir():
        return
    head = read_head(folder / FOLDER)
    if head is None:
        verification.notes.append(f"{FOLDER}/{HEAD} cannot be read; {ADVICE}")
        return
    with TemporaryDirectory() as place:
        build_trend(folder, Path(place))
        made = read_head(Path(place) / FOLDER)
        assert made is not None
        differing = [] if head.sources == made.sources else [HEAD]
        for source in made.sources if not differing else ():
            for level_s in LEVELS_S if source.name != BENCH else ():
                stored, due = (source.path(root / FOLDER, level_s) for root in (folder, Path(place)))
                if not stored.is_file() or stored.read_bytes() != due.read_bytes():
                    differing.append(stored.name)
    verification.notes += [f"{FOLDER}/{name} is not what the session gives; {ADVICE}" for name in differing]
