"""``bench report --verify``: everything derived again from the raw bytes, and compared; nothing is written."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from bench.commands.console import console
from bench.commands.verify.certificate import check_certificates
from bench.commands.verify.trend import check_trend
from bench.model.errors import BenchError, ExitStatus, InputError, SessionDamaged
from bench.session.service import read_view
from bench.session.verification import RESULTS, Pages, Verification, check_coefficients, check_reports, check_results
from bench.session.view import SessionView, analyse_view


def verify(folder: Path, as_json: bool) -> int:
    """Say "identical", or list what the session does not give.

    Raises: SessionDamaged B-CLI-012 if a segment is damaged or a file is not what the session gives; InputError
    B-CLI-010 if there are no results to compare with, B-REC-010 if there is no session; BenchError of the analysis.
    """
    found = Verification()
    view = read_view(folder)
    _segments(found, folder, view)
    try:
        _computed(found, folder, view)
    except BenchError as error:
        if not found.changes:
            raise
        found.add(RESULTS, f"cannot be derived from what is left: {error}")
    check_trend(found, folder)
    _tell(found, folder, view, as_json)
    if found.changes:
        raise SessionDamaged(
            "B-CLI-012",
            f"{len(found.changes)} things are not what the raw bytes of the session give, they are listed above",
            where=str(folder),
            next_step="compare with a copy of the session; 'bench recover' lists what a damaged one still holds",
        )
    return ExitStatus.PASS


def _segments(found: Verification, folder: Path, view: SessionView) -> None:
    """Every segment is verified on the way: CRCs, running numbers, hash chain."""
    found.compared += sorted(path.name for path in folder.glob("session.*.mcap"))
    for place in view.damage:
        found.add(place.segment, place.inside)
    found.notes += view.notes


def _computed(found: Verification, folder: Path, view: SessionView) -> None:
    if not view.has_analysis:
        found.notes.append("the sequence of this session asks for no analysis: there is nothing to derive")
        return
    results, analysis = analyse_view(view)
    stored = check_results(found, folder, results)
    if stored is None and not found.changes:
        raise InputError(
            "B-CLI-010",
            "is not there, so there is nothing to compare with",
            where=str(folder / RESULTS),
            next_step="'bench fit' prints the results of the session",
        )
    check_reports(found, folder, Pages(view, results, analysis, stored or {}))
    check_coefficients(found, folder, view, results, analysis)
    check_certificates(found, folder, view.manifest, results)


def _tell(found: Verification, folder: Path, view: SessionView, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(_document(found, folder, view), indent=1, ensure_ascii=False) + "\n")
        return
    out = console()
    for change in found.changes:
        out.print(str(change))
    for note in found.notes:
        out.print(f"note: {note}")
    if found.absent:
        out.print(f"not there: {', '.join(found.absent)}")
    if not found.changes:
        out.print(
            f"identical: {folder}: {', '.join(_shortened(found.compared))}; {len(view.rows)} records, "
            f"{view.counts['frames']} frames, session sha256 {view.session_sha256}"
        )


def _shortened(names: list[str]) -> list[str]:
    """Return names of files; of many segments the number."""
    segments = [name for name in names if name.endswith(".mcap")]
    return [f"{len(segments)} segments" if len(segments) != 1 else segments[0], *names[len(segments) :]]


def _document(found: Verification, folder: Path, view: SessionView) -> dict[str, Any]:
    return {
        "session": str(folder),
        "identical": not found.changes,
        "session_sha256": view.session_sha256,
        "records": len(view.rows),
        **view.counts,
        "compared": found.compared,
        "absent": found.absent,
        "changes": [{"file": change.file, "what": change.what} for change in found.changes],
        "notes": found.notes,
    }
