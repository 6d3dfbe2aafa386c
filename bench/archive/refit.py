"""One archived session through today's decoder and analyses, beside what was released of it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.analysis import Estimate, Estimates, estimates_of, results_json
from bench.archive.changes import is_changed, is_flip
from bench.archive.diagnosis import diagnosed
from bench.archive.places import brought_here
from bench.model.errors import FitError
from bench.model.installed import unforeseen
from bench.record import SessionReader
from bench.session.one_unit import extract, serials_of
from bench.session.register import Register
from bench.session.service import analysed
from bench.session.units import results_of_all
from bench.session.view import SOFTWARE
from bench.store import MEASURED, columns_of, documents_of_units

Row = dict[str, Any]
_NUMBERS = ("value", "std_uncertainty", "coverage_factor", "expanded_uncertainty", "n")
# a row for each estimate, or one for a session that gave none
COLUMNS = columns_of(
    (
        "session", "session_sha256", "started_utc", "campaign", "simulated", "uut_model", "uut_serial", "quantity",
        "unit", "conditions", "value", "std_uncertainty", "coverage_factor", "expanded_uncertainty", "n", "verdict",
        "quality", "method", "software", "released_value", "released_expanded_uncertainty", "released_verdict",
        "released_quality", "released_method", "released_software", "code", "fault",
    ),
    simulated="bool", value="double", std_uncertainty="double", coverage_factor="double",
    expanded_uncertainty="double", n="int64", released_value="double", released_expanded_uncertainty="double",
)  # fmt: skip
_EMPTY: Row = {name: "" if kind == "string" else None for name, kind in COLUMNS}


@dataclass(frozen=True)
class RefitTask:
    """A session to be computed again; ``head``: what all its rows say of it.

    ``bytes``: that were archived, 0 if it was never whole.
    """

    location: str
    head: Row
    method: str | None
    register: Register
    bytes: int

    @property
    def key(self) -> str:
        """The SHA-256 of the session, or its location if it was never read whole."""
        return str(self.head["session_sha256"])

    @property
    def name(self) -> str:
        """Name that a person reads while it runs."""
        return str(self.head["session"])


def refit(task: RefitTask) -> list[Row]:
    """Return a row for each estimate of a session, or one row with the code of what kept it from giving any.

    The files of the session are read only, and lie on this machine while it is computed.
    Raises: OSError if it cannot be brought here now: that says nothing of the session.
    """
    try:
        with brought_here(task.location) as (folder, place):
            rows = _computed(task, folder, place.bytes < task.bytes) or [{}]
    except OSError:
        raise
    except Exception as error:  # a fault of an analysis is the row of this session, and ends no other
        fault = unforeseen(error)
        rows = [{"code": fault.code, "fault": fault.message}]
    return [{**_EMPTY, **task.head, "software": SOFTWARE, **row} for row in rows]


def _computed(task: RefitTask, folder: Path, is_shorter: bool) -> list[Row]:
    """Return the rows of a session; one that is not what was archived is told as add and verify tell it."""
    archived = task.key if task.bytes else None
    recording = diagnosed(folder, archived, is_shorter)
    recording.check_archived(archived)
    wrong = recording.results_fault
    fault = "" if wrong is None else f"{wrong.code}: {wrong.message}"
    now = computed_results(folder, task.method, task.register)
    return [{**row, "fault": fault} for row in rows_of(recording.results, now, SessionReader(folder).manifest)]


def computed_results(folder: Path, method: str | None, register: Register) -> dict[str, Any]:
    """Return the results of a whole session, as they are read from results.json: conditions in the order of the file.

    A unit of several that gives none is not in them, as when they were released.
    Raises: SessionDamaged; FitError if no unit gives any; InputError.
    """
    serials = serials_of(SessionReader(folder).manifest)
    results = _of_units(folder, serials, method, register) if serials else _of_one(folder, method, register)
    plain: dict[str, Any] = json.loads(results_json(results))
    return plain


def _of_one(folder: Path, method: str | None, register: Register) -> dict[str, Any]:
    return analysed(folder, method, strict=True, register=register)[0]


def _of_units(folder: Path, serials: Sequence[str], method: str | None, register: Register) -> dict[str, Any]:
    documents: dict[str, Mapping[str, Any]] = {}
    for serial in serials:
        with TemporaryDirectory(prefix="bench-archive-") as home:
            extract(folder, serial, Path(home, serial))
            try:
                documents[serial] = _of_one(Path(home, serial), method, register)
            except FitError:
                if serial == serials[-1] and not documents:
                    raise
    return results_of_all(folder, documents)


def differences(released: Mapping[str, Any], other: Mapping[str, Any], manifest: Mapping[str, Any]) -> list[Row]:
    """Return the rows of released estimates that have another number, verdict or quality in other results, to 1e-9."""
    rows = ({**_EMPTY, **row} for row in rows_of(released, other, manifest))
    return [row for row in rows if row["released_quality"] and (is_changed(row) or is_flip(row))]


def rows_of(released: Mapping[str, Any] | None, now: Mapping[str, Any], manifest: Mapping[str, Any]) -> Iterator[Row]:
    """Yield a row for each estimate that is released or computed now, in the order of results.json, by unit."""
    before = {} if released is None else _units(released, manifest)
    after = _units(now, manifest)
    versions = {"method": str(now["method"])}
    if released is not None:
        versions["released_method"] = str(released["method"])
        versions["released_software"] = str(released["provenance"]["software"])
    for uut in dict.fromkeys((*before, *after)):
        old, new = _by_parameter(before.get(uut, [])), _by_parameter(after.get(uut, []))
        for parameter in dict.fromkeys((*old, *new)):
            quantity, unit, conditions, _ = parameter
            yield {
                **versions,
                "uut_model": uut[0],
                "uut_serial": uut[1],
                "quantity": quantity,
                "unit": unit,
                "conditions": conditions,
                **_of(new.get(parameter), "", _NUMBERS),
                **_of(old.get(parameter), "released_", ("value", "expanded_uncertainty")),
            }


def _units(document: Mapping[str, Any], manifest: Mapping[str, Any]) -> dict[tuple[str, str], Estimates]:
    documents = documents_of_units(document, manifest)
    return {(str(part["uut"]["model"]), str(part["uut"]["serial"])): estimates_of(part) for part in documents}


def _by_parameter(estimates: Estimates) -> dict[tuple[str, str, str, int], Estimate]:
    """Return estimates by quantity, unit and conditions without what was measured; the number tells like ones apart."""
    by_parameter: dict[tuple[str, str, str, int], Estimate] = {}
    alike: Counter[tuple[str, str, str]] = Counter()
    for estimate in estimates:
        given = {name: value for name, value in estimate.conditions.items() if name not in MEASURED}
        conditions = json.dumps(given, sort_keys=True, ensure_ascii=False)
        named = (estimate.quantity, estimate.unit, conditions)
        by_parameter[(*named, alike[named])] = estimate
        alike[named] += 1
    return by_parameter


def _of(estimate: Estimate | None, prefix: str, numbers: Sequence[str]) -> Row:
    """Return what a row says of an estimate; "" and None where there is none."""
    if estimate is None:
        return {f"{prefix}verdict": "", f"{prefix}quality": ""}
    said = {f"{prefix}{name}": getattr(estimate, name) for name in numbers}
    return {**said, f"{prefix}verdict": estimate.verdict, f"{prefix}quality": estimate.quality}
