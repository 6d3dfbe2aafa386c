"""Reads a sequence and the station it is for; a mistake in one file must not hide those in the other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from bench.model.errors import InputError, InputErrors
from bench.model.shipped import find_beside
from bench.model.yamlio import Document, load_yaml
from bench.plan.check.stations import check_station
from bench.plan.findings import Findings
from bench.plan.language.names import check_names, driver_names, plain_tree
from bench.plan.language.sequence import Sequence, sequence_model
from bench.plan.station import Station, load_station

_T = TypeVar("_T")


def load_both(source: Path, station: Station | None) -> tuple[Document[Sequence], Station]:
    """Return the sequence, and the station given or else the one it names.

    Raises: InputErrors with the mistakes of both files; if one of them cannot be compiled, the names in it are still
    looked at.
    """
    findings = Findings()
    document = _read(lambda: load_yaml(source, sequence_model()), findings)
    file = None if station is not None else _station_file(source, document, findings)
    if file is not None:
        station = _read(lambda: load_station(file), findings)
    if document is not None and station is not None:
        return document, station
    if station is not None:
        check_station(station, findings)
        drivers = {role: entry.driver for role, entry in station.instruments.items()}
    else:
        bench = None if file is None else plain_tree(file)
        drivers = {} if bench is None else driver_names(bench, findings)
    tree = plain_tree(source)
    if tree is not None and drivers:
        check_names(tree, drivers, findings)
    raise InputErrors(findings.sorted())


def _read(load: Callable[[], _T], findings: Findings) -> _T | None:
    try:
        return load()
    except InputError as error:
        findings.extend(error)
        return None


def _station_file(source: Path, document: Document[Sequence] | None, findings: Findings) -> Path | None:
    """File of the station that a sequence names, even if the rest of the sequence cannot be read."""
    place = document if document is not None else plain_tree(source)
    if document is not None:
        name: object = document.model.station
    else:
        root = None if place is None else place.model.root  # type: ignore[union-attr]
        name = root.get("station") if isinstance(root, dict) else None
    if place is None or not isinstance(name, str):
        return None
    try:
        return find_beside(source, "stations", name)
    except InputError as error:
        findings.add("B-PLAN-045", place.where(("station",)), error.message, error.next_step)
        return None
