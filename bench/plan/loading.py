"""Reads a sequence, the station it is for, and the values of ``--set``.

All mistakes are to be shown at once: one in one file must not hide those in the other, and a wrong unit at one end of a
file not a wrong name at the other. So files that hold other mistakes, and cannot be compiled, are still searched for
misspelt instruments, actions and drivers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import RootModel

from bench.model.errors import InputError, InputErrors
from bench.model.shipped import find_beside
from bench.model.units import likely, read_quantity
from bench.model.yamlio import Document, load_yaml
from bench.plan.check.stations import check_station
from bench.plan.findings import Findings, suggestion
from bench.plan.language.sequence import Sequence, language_of_sequence
from bench.plan.station import Station, driver_actions, load_station
from bench.plan.values import ACTION_PATTERN

WORLD = "world."
_T = TypeVar("_T")
Place = tuple[str | int, ...]
SECTIONS = ("prepare", "steps", "timeline", "finally", "procedures")
_ACTION = re.compile(ACTION_PATTERN)
_NAMING = ("call", "verify")  # keys whose value may be an action


def split_overrides(
    document: Document[Sequence], overrides: Mapping[str, str], findings: Findings
) -> tuple[dict[str, str], dict[str, str]]:
    """Return parameters of the sequence, and options of the simulated world.

    A key that the sequence has no parameter for is left out and noted (B-PLAN-003), naming the known ones.
    """
    known = document.model.parameters
    for key in overrides:
        if not key.startswith(WORLD) and key not in known:
            meant = suggestion(key, [*known, "world.<option>"])
            findings.add("B-PLAN-003", f"--set {key}", f"{document.name} has no parameter {key!r}{meant}")
    parameters = {key: value for key, value in overrides.items() if key in known}
    world = {key.removeprefix(WORLD): value for key, value in overrides.items() if key.startswith(WORLD)}
    return parameters, world


def apply_parameters(document: Document[Sequence], given: Mapping[str, str], findings: Findings) -> dict[str, Any]:
    """Return parameters of the sequence with the given ones in place; each must be of the sort of the one it replaces.

    A list is given with commas, an empty one by nothing. One of another sort is noted (B-PLAN-005) and the shipped
    value stays.
    """
    parameters: dict[str, Any] = dict(document.model.parameters)
    for key, text in given.items():
        shipped = parameters[key]
        try:
            many = isinstance(shipped, list)
            parts = text.split(",") if many and text else []
            parameters[key] = [_like(shipped[0], part) for part in parts] if many else _like(shipped, text)
        except (ValueError, IndexError) as error:
            findings.add("B-PLAN-005", f"--set {key}", f"{text!r} cannot replace {shipped!r}: {error}")
    return parameters


def _like(shipped: Any, text: str) -> Any:
    text = text.strip()
    if isinstance(shipped, bool):
        if text not in ("true", "false"):
            raise ValueError("true or false is due")
        return text == "true"
    if isinstance(shipped, (int, float)):
        return _number_like(shipped, text)
    old, new = read_quantity(str(shipped)), read_quantity(text)
    if (old and old[1]) != (new and new[1]):
        raise ValueError(
            f"a quantity in {old[1]} is due{likely(text, old[1])}" if old else "a text without a unit is due"
        )
    return text


def _number_like(shipped: float, text: str) -> float:
    due = "a whole number is due" if isinstance(shipped, int) else "a number is due"
    try:
        number = type(shipped)(text)
    except (ValueError, OverflowError):
        raise ValueError(due) from None
    if not math.isfinite(number):
        raise ValueError(due)
    return number


def load_both(source: Path, station: Station | None) -> tuple[Document[Sequence], Station]:
    """Return the sequence, and the station given or else the one it names.

    Raises: InputErrors with the mistakes of both files; if one of them cannot be compiled, the names in it are still
    looked at.
    """
    findings = Findings()
    document = _read(lambda: load_yaml(source, language_of_sequence), findings)
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
    """Return file of the station that a sequence names, even if the rest of the sequence cannot be read."""
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


def plain_tree(path: Path) -> Document[RootModel[Any]] | None:
    """Return a YAML file as plain values with their positions; None if even the loader refuses it."""
    try:
        return load_yaml(path, RootModel[Any])
    except InputError:
        return None


def driver_names(tree: Document[RootModel[Any]], findings: Findings) -> dict[str, str]:
    """Return drivers of a station file by role; those that do not exist are noted (B-PLAN-011)."""
    root = tree.model.root
    instruments = root.get("instruments") if isinstance(root, dict) else None
    drivers: dict[str, str] = {}
    for role, entry in instruments.items() if isinstance(instruments, dict) else ():
        driver = entry.get("driver") if isinstance(entry, dict) else None
        if isinstance(driver, str):
            drivers[role] = driver
            try:
                driver_actions(driver)
            except InputError as error:
                if error.code == "B-PLAN-011":  # a name that is not plain is noted by the loader
                    findings.add(error.code, tree.where(("instruments", role, "driver")), error.message)
    return drivers


def check_names(tree: Document[RootModel[Any]], drivers: Mapping[str, str], findings: Findings) -> None:
    """Note every ``role.action`` of a sequence file that names no role (B-PLAN-040) or no action (B-PLAN-050)."""
    root = tree.model.root
    for section in SECTIONS if isinstance(root, dict) else ():
        for called, path in _calls(root.get(section), (section,)):
            role, name = called.split(".")
            if role not in drivers:
                message = f"the station has no instrument {role!r}{suggestion(role, drivers)}"
                findings.add("B-PLAN-040", tree.where(path), message)
                continue
            try:
                actions = driver_actions(drivers[role])
            except InputError:
                continue
            if name not in actions:
                message = f"{role} ({drivers[role]}) has no action {name!r}{suggestion(name, actions)}"
                findings.add("B-PLAN-050", tree.where(path), message)


def _calls(value: Any, path: Place) -> Iterator[tuple[str, Place]]:
    if isinstance(value, list):
        for index, item in enumerate(value):
            if isinstance(item, str) and _ACTION.fullmatch(item):
                yield item, (*path, index)
            yield from _calls(item, (*path, index))
    elif isinstance(value, dict):
        for key, item in value.items():
            if _ACTION.fullmatch(key):
                yield key, (*path, key)
            elif key in _NAMING and isinstance(item, str) and _ACTION.fullmatch(item):
                yield item, (*path, key)
            yield from _calls(item, (*path, key))
