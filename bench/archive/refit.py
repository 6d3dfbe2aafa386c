"""One archived session through today's decoder and analyses, beside what was released of it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bench.analysis import results_json
from bench.archive.examination import GONE, OTHER_RECORDING
from bench.archive.places import brought_here
from bench.model.errors import BenchError, FitError, InputError, SessionDamaged
from bench.record import SessionReader
from bench.session.one_unit import extract, serials_of
from bench.session.register import Register
from bench.session.released import released_results
from bench.session.service import analysed
from bench.session.units import results_of_all
from bench.session.view import SOFTWARE
from bench.store import MEASURED, documents_of_units

Row = dict[str, Any]
UNFORESEEN = "B-INT-001"
_NUMBERS = ("value", "std_uncertainty", "coverage_factor", "expanded_uncertainty", "n")
# name, type as Parquet calls it: a row for each estimate, or one for a session that gave none
COLUMNS = (
    ("session", "string"), ("session_sha256", "string"), ("started_utc", "string"), ("campaign", "string"),
    ("simulated", "bool"), ("uut_model", "string"), ("uut_serial", "string"), ("quantity", "string"),
    ("unit", "string"), ("conditions", "string"), ("value", "double"), ("std_uncertainty", "double"),
    ("coverage_factor", "double"), ("expanded_uncertainty", "double"), ("n", "int64"), ("verdict", "string"),
    ("quality", "string"), ("method", "string"), ("software", "string"), ("released_value", "double"),
    ("released_expanded_uncertainty", "double"), ("released_verdict", "string"), ("released_quality", "string"),
    ("released_method", "string"), ("released_software", "string"), ("code", "string"), ("fault", "string"),
)  # fmt: skip
_EMPTY: Row = {name: "" if kind == "string" else None for name, kind in COLUMNS}


@dataclass(frozen=True)
class RefitTask:
    """A session to be computed again; ``key``: its SHA-256, or its location if it was never read whole."""

    key: str
    location: str
    session: str
    started_utc: str
    campaign: str
    simulated: bool
    method: str | None
    register: Register

    @property
    def name(self) -> str:
        """Name that a person reads while it runs."""
        return self.session


def refit(task: RefitTask) -> list[Row]:
    """Return a row for each estimate of a session, or one row with the code of what kept it from giving any.

    The files of the session are read only, and lie on this machine while it is computed.
    Raises: OSError if it cannot be brought here now: that says nothing of the session.
    """
    head = {
        "session": task.session,
        "session_sha256": task.key,
        "started_utc": task.started_utc,
        "campaign": task.campaign,
        "simulated": task.simulated,
        "software": SOFTWARE,
    }
    try:
        with brought_here(task.location) as (folder, _):
            rows = _attempted(task, folder) or [{}]
    except FileNotFoundError:
        rows = [{"code": GONE, "fault": "there is no session any more"}]
    except InputError as error:
        rows = [{"code": error.code, "fault": error.message}]
    return [{**_EMPTY, **head, **row} for row in rows]


def _attempted(task: RefitTask, folder: Path) -> list[Row]:
    try:
        return list(_computed(task, folder))
    except BenchError as error:
        return [{"code": error.code, "fault": error.message}]
    except OSError:
        raise
    except Exception as error:  # a fault of an analysis is the row of this session, and ends no other
        return [{"code": UNFORESEEN, "fault": f"{type(error).__name__}: {' '.join(str(error).split())}"}]


def _computed(task: RefitTask, folder: Path) -> Iterator[Row]:
    manifest = SessionReader(folder).manifest
    serials = serials_of(manifest)
    results = _of_units(task, folder, serials) if serials else _of_one(task, folder)
    _check_recording(results["provenance"]["session_sha256"], task)
    now = json.loads(results_json(results))  # as the released ones are read: conditions in the order of the file
    return rows_of(released_results(folder), now, manifest)


def _check_recording(sha256: str, task: RefitTask) -> None:
    if sha256 != task.key:
        text = f"is not the recording that was archived ({sha256[:12]})"
        raise SessionDamaged(OTHER_RECORDING, text, where=task.location)


def _of_one(task: RefitTask, folder: Path) -> dict[str, Any]:
    return analysed(folder, task.method, strict=True, register=task.register)[0]


def _of_units(task: RefitTask, folder: Path, serials: Sequence[str]) -> dict[str, Any]:
    """Return results of a session that several units share; a unit that gives none is not in them, as when released.

    Raises: SessionDamaged; FitError if no unit gives any.
    """
    _check_recording(SessionReader(folder, strict=True).sha256, task)
    documents: dict[str, Mapping[str, Any]] = {}
    for serial in serials:
        with TemporaryDirectory(prefix="bench-archive-") as home:
            extract(folder, serial, Path(home, serial))
            try:
                documents[serial] = _of_one(task, Path(home, serial))
            except FitError:
                if serial == serials[-1] and not documents:
                    raise
    return results_of_all(folder, documents)


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


def _units(document: Mapping[str, Any], manifest: Mapping[str, Any]) -> dict[tuple[str, str], Sequence[Any]]:
    documents = documents_of_units(document, manifest)
    return {(str(part["uut"]["model"]), str(part["uut"]["serial"])): part["estimates"] for part in documents}


def _by_parameter(estimates: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str, str, int], Mapping[str, Any]]:
    """Return estimates by quantity, unit and conditions without what was measured; the number tells like ones apart."""
    by_parameter: dict[tuple[str, str, str, int], Mapping[str, Any]] = {}
    alike: Counter[tuple[str, str, str]] = Counter()
    for estimate in estimates:
        given = {name: value for name, value in estimate["conditions"].items() if name not in MEASURED}
        conditions = json.dumps(given, sort_keys=True, ensure_ascii=False)
        named = (str(estimate["quantity"]), str(estimate["unit"]), conditions)
        by_parameter[(*named, alike[named])] = estimate
        alike[named] += 1
    return by_parameter


def _of(estimate: Mapping[str, Any] | None, prefix: str, numbers: Sequence[str]) -> Row:
    """Return what a row says of an estimate; "" and None where there is none."""
    if estimate is None:
        return {f"{prefix}verdict": "", f"{prefix}quality": ""}
    said = {f"{prefix}{name}": estimate[name] for name in numbers}
    quality = str(estimate.get("quality", "sound"))
    return {**said, f"{prefix}verdict": str(estimate["verdict"]), f"{prefix}quality": quality}
