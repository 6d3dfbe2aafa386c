"""Commands that read a recorded session and nothing else: replay, fit, report."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis.analysis import Analysis
from bench.analysis.results import INCOMPLETE, results_json
from bench.commands.console import console
from bench.commands.tables import print_results
from bench.model.errors import ExitStatus, InputError, SessionDamaged
from bench.record.writer import OPEN_MARKER
from bench.replay import compare, replay_rows
from bench.replay.compare import ABSENT, Difference
from bench.replay.rows import Replayed
from bench.replay.series import IMPORT, replay_series
from bench.session.merge import merged
from bench.session.output import write_file
from bench.session.view import KEPT_EVENTS, SessionView, analyse_view, plan_steps_of, report_of

SHOWN_DIFFERENCES = 20
SOFTWARE_PATH = "provenance.software"  # another version may give the same numbers
DAMAGED = "damaged: "  # how the notes of a session begin that name a damaged place


def replay(folder: Path, as_json: bool) -> int:
    """Decode the raw bytes again and compare every number with results.json; exit 5 if one differs."""
    results, analysis, view = _analysed(folder, None, strict=True)
    stored = _stored_results(folder)
    differences, added = _differences(stored, json.loads(results_json(results)))
    if as_json:
        sys.stdout.write(results_json({"identical": not differences, "results": results}))
    else:
        print_results(console(), results, analysis)
        for note in view.notes:
            console().print(note)
    if differences:
        for one in differences[:SHOWN_DIFFERENCES]:
            console(stderr=True).print(f"  {one}")
        raise SessionDamaged(
            "B-CLI-009",
            f"{len(differences)} values differ between results.json and the replay, the first are listed above",
            where=str(folder),
            next_step=_why(stored, results),
        )
    if added:
        console(stderr=as_json).print(f"{added} values are new: the software of the run did not give them")
    console(stderr=as_json).print(f"replay of {folder}: every number is identical")
    return ExitStatus.PASS


def _differences(stored: Any, now: Any) -> tuple[list[Difference], int]:
    """What the run wrote and is not the same now, and how many values only today's software gives."""
    found = [one for one in compare(stored, now) if one.path != SOFTWARE_PATH]
    added = sum(one.first == ABSENT for one in found)
    return [one for one in found if one.first != ABSENT], added


def _why(stored: Mapping[str, Any], results: Mapping[str, Any]) -> str:
    """What to look at first: the recording, the software, or else the file of results."""
    recordings = [one.get("provenance", {}).get("session_sha256") for one in (stored, results)]
    if recordings[0] != recordings[1]:
        return "results.json is of another recording, or this one is not whole: 'bench recover' says which"
    if software_of(stored) != software_of(results):
        return f"compare the software: stored {software_of(stored)}, now {software_of(results)}"
    return "the recording and the software are the same, so results.json was changed, or made on another machine"


def software_of(results: Mapping[str, Any]) -> str:
    """Name and version of the software that wrote results."""
    return str(results.get("provenance", {}).get("software", "unknown"))


def fit(folder: Path, method: str | None, as_json: bool, make_up: Sequence[Path] = ()) -> int:
    """Print the results of a session by a method, together with sessions that make up for it; nothing is written."""
    results, analysis, view = _analysed(folder, method, make_up=make_up)
    if as_json:
        sys.stdout.write(results_json(results))
        return _status(view)
    print_results(console(), results, analysis)
    for note in [*([INCOMPLETE] if view.incomplete else []), *analysis.notes, *view.notes]:
        console().print(note)
    return _status(view)


def report(folder: Path, pdf: bool = False) -> int:
    """Write report.html again, and report.pdf if asked for."""
    results, analysis, view = _analysed(folder, None)
    drawn = report_of(view, results, analysis)
    path = folder / "report.html"
    write_file(path, drawn.html())
    console().print(f"report   {path}")
    if pdf:
        paper = folder / "report.pdf"
        write_file(paper, drawn.pdf())
        console().print(f"report   {paper}")
    return _status(view)


def _analysed(
    folder: Path, method: str | None, strict: bool = False, make_up: Sequence[Path] = ()
) -> tuple[dict[str, Any], Analysis, SessionView]:
    view = read_view(folder, strict=strict)
    if make_up:
        view = merged(view, [read_view(other) for other in make_up])
    if not view.has_analysis:
        raise InputError("B-CLI-008", "the sequence of this session asks for no analysis", where=str(folder))
    results, analysis = analyse_view(view, method)
    return results, analysis, view


def read_view(folder: Path, strict: bool = False) -> SessionView:
    """A session as its folder holds it; damage is listed in its notes, unless ``strict`` (then SessionDamaged)."""
    replayed = replay_rows(folder, strict=strict)
    notes = [*replayed.notes, *(f"{DAMAGED}{one}" for one in replayed.damage)]
    notes += [f"{name} has no end: the run stopped there, or goes on" for name in replayed.unfinished]
    series: Mapping[str, NDArray[np.float64]] = {}
    if replayed.manifest.get("kind") == IMPORT:
        imported = replay_series(folder)
        series = imported.columns
        notes += imported.notes
    return SessionView(
        manifest=replayed.manifest,
        rows=replayed.measurement_rows,
        counts=replayed.totals,
        session_sha256=replayed.session_sha256,
        plan_steps=plan_steps_of(replayed.texts),
        events=[event for event in replayed.events if event[0] in KEPT_EVENTS],
        notes=notes,
        damaged=bool(replayed.damage),
        series=series,
        splices=replayed.splices,
        incomplete=_is_incomplete(folder, replayed),
        utc_offset_ns=replayed.utc_offset_ns,
        texts=replayed.texts,
    )


def _is_incomplete(folder: Path, replayed: Replayed) -> bool:
    """The run goes on, was stopped, or its last segment has no end; other software may write no "end" event."""
    last = next((fields for kind, _, fields in reversed(replayed.events) if kind in ("end", "resume")), None)
    stopped = last is not None and (last.get("error") is not None or "steps" not in last)
    newest = max(path.name for path in folder.glob("session.*.mcap"))
    return stopped or newest in replayed.unfinished or (folder / OPEN_MARKER).exists()


def _status(view: SessionView) -> int:
    return ExitStatus.SESSION_DAMAGED if view.damaged else ExitStatus.PASS


def _stored_results(folder: Path) -> Mapping[str, Any]:
    path = folder / "results.json"
    try:
        stored: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(
            "B-CLI-010",
            f"cannot be read ({error}), so there is nothing to compare with",
            where=str(path),
            next_step="'bench fit' prints the results of the session",
        ) from error
    return stored
