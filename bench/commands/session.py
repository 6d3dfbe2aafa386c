"""``bench replay`` and ``coefficients``: commands that compute from the raw bytes of recorded sessions."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.analysis import results_json
from bench.commands.console import console, say, warn
from bench.commands.tables import print_results
from bench.model.errors import ExitStatus, InputError, SessionDamaged
from bench.record import SessionReader
from bench.replay import ABSENT
from bench.session.coefficients import Coefficients, coefficients_of_session, merged_coefficients
from bench.session.one_unit import serials_of
from bench.session.service import analysed, read_view
from bench.session.units import in_each_unit
from bench.session.verification import no_results, released_results, software_of, value_differences
from bench.session.view import analyse_view

SHOWN_DIFFERENCES = 20


def replay(folder: Path, as_json: bool) -> int:
    """Decode the raw bytes again and compare every number with results.json; exit 5 if one differs."""
    if serials_of(SessionReader(folder).manifest):
        return in_each_unit(folder, lambda home: replay(home, as_json))
    results, analysis, view = analysed(folder, None, strict=True)
    stored = _stored_results(folder)
    found = value_differences(stored, results)
    differences = [difference for difference in found if difference.first != ABSENT]
    if as_json:
        sys.stdout.write(results_json({"identical": not differences, "results": results}))
    else:
        print_results(console(), results, analysis)
        for note in view.remarks:
            say(note)
    if differences:
        for difference in differences[:SHOWN_DIFFERENCES]:
            warn(f"  {difference}")
        raise SessionDamaged(
            "B-CLI-009",
            f"{len(differences)} values differ between results.json and the replay, the first are listed above",
            where=folder,
            next_step=_why(stored, results),
        )
    if added := len(found) - len(differences):
        console(stderr=as_json).print(f"{added} values are new: the software of the run did not give them")
    console(stderr=as_json).print(f"replay of {folder}: every number is identical")
    return ExitStatus.PASS


def _why(stored: Mapping[str, Any], results: Mapping[str, Any]) -> str:
    """Return what to look at first: the recording, the software, or else the file of results."""
    then, now = (document.get("provenance", {}) for document in (stored, results))
    if then.get("session_sha256") != now.get("session_sha256"):
        return "results.json is of another recording, or this one is not whole: 'bench recover' says which"
    if then.get("analysis_sha256") != now.get("analysis_sha256"):
        return "the analysis of the lab folder is another file today; the text of the run's own is in the session"
    if software_of(stored) != software_of(results):
        return f"compare the software: stored {software_of(stored)}, now {software_of(results)}"
    return "the recording and the software are the same, so results.json was changed, or made on another machine"


def _stored_results(folder: Path) -> Mapping[str, Any]:
    stored = released_results(folder)
    if stored is None:
        raise no_results(folder)
    return stored


def coefficients(folders: Sequence[Path], out: Path) -> None:
    """Fit the sessions again, merge their coefficients and write both files.

    Raises: InputError B-COEF-001 to -007; SessionDamaged for a session that is not whole.
    """
    merged = merged_coefficients([_of_folder(folder) for folder in folders])
    for path in merged.write(out):
        say(f"wrote    {path}")
    for source in merged.document["sources"]:
        for result in source["missing"]:
            say(f"MISSING  {result}")


def _of_folder(folder: Path) -> Coefficients:
    view = read_view(folder, strict=True)
    if view.has_analysis:
        results, analysis = analyse_view(view)
        coefficients = coefficients_of_session(analysis, results, view.manifest["campaign"])
        if coefficients is not None:
            return coefficients
    raise InputError(
        "B-COEF-005",
        "the session gives no coefficients",
        where=folder,
        next_step="name a session of a scale-factor or bias campaign with more than one temperature",
    )
