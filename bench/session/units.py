"""Results of a session that several units share: each unit by itself, and one list of all for whoever reads a session.

The file results.json of the whole has every estimate with the serial number of its unit as condition ``unit``; results,
report and coefficients of a unit are those of its own session, in the folder ``units/<serial number>``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.analysis import results_json, validate_results
from bench.model.errors import BenchError, ExitStatus, FitError, InstallationError
from bench.plan import UNIT
from bench.record import SessionReader
from bench.session.finish import Finished, finish
from bench.session.one_unit import serials_of, session_of_unit
from bench.session.output import write_file
from bench.session.service import read_view

RESULTS = "results.json"


@dataclass(frozen=True)
class UnitFinished:
    """What came of one unit: its files, or why there are no results."""

    serial: str
    folder: Path
    finished: Finished | None = None
    error: BenchError | None = None


def finish_units(folder: Path, history: str) -> list[UnitFinished]:
    """Write results, report and coefficients of each unit, enter each in the history, then the list of all.

    Raises: BenchError of the disk; what an analysis raises is told of its unit.
    """
    outcomes = []
    for serial in serials_of(SessionReader(folder).manifest):
        with session_of_unit(folder, serial) as home:
            try:
                done = finish(home, read_view(home), history)
                done.written = [(kind, path) for kind, path in done.written if kind != "session"]  # it is gone again
                outcomes.append(UnitFinished(serial, home, done))
            except (FitError, InstallationError) as error:
                outcomes.append(UnitFinished(serial, home, error=error))
    documents = {done.serial: done.finished.results for done in outcomes if done.finished is not None}
    if documents:
        write_file(folder / RESULTS, results_json(results_of_all(folder, documents)))
    return outcomes


def in_each_unit(folder: Path, do: Callable[[Path], int]) -> int:
    """Do something with the session of each unit, in the folder of its results; returns the worst exit status."""
    statuses = []
    for serial in serials_of(SessionReader(folder).manifest):
        with session_of_unit(folder, serial) as home:
            statuses.append(do(home))
    return max(statuses, default=int(ExitStatus.PASS))


def results_of_all(folder: Path, documents: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return results.json of the whole session, from those of its units by serial number."""
    reader = SessionReader(folder)
    manifest, first = reader.manifest, next(iter(documents.values()))
    whole = {
        **first,
        "session": manifest["session"],
        "uut": dict(manifest["campaign"]["uut"]),
        "estimates": [{**entry, "conditions": {**entry["conditions"], UNIT: serial}}
                      for serial, document in documents.items() for entry in document["estimates"]],
        "quality": {name: sum(document["quality"][name] for document in documents.values()) for name in
                    first["quality"]},
        "provenance": {
            **first["provenance"],
            "plan_sha256": manifest["plan_sha256"],
            "session_sha256": reader.sha256,
            "units_sha256": {serial: document["provenance"]["session_sha256"] for serial, document in
                             documents.items()},
        },
        "notes": [f"{serial}: {note}" for serial, document in documents.items() for note in document["notes"]],
    }  # fmt: skip
    plain: dict[str, Any] = json.loads(json.dumps(whole))
    validate_results(plain)
    return plain
