"""Looks for misspelt instruments, actions and drivers in files that hold other mistakes and so cannot be compiled.

All mistakes are to be shown at once: a wrong unit at one end of a file must not hide a wrong name at the other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import RootModel

from bench.model.errors import InputError
from bench.model.yamlio import Document, load_yaml
from bench.plan.drivers import driver_actions
from bench.plan.findings import Findings, suggestion
from bench.plan.language.templated import ACTION_PATTERN

Place = tuple[str | int, ...]
SECTIONS = ("prepare", "steps", "timeline", "finally", "procedures")
_ACTION = re.compile(ACTION_PATTERN)
_NAMING = ("call", "verify")  # keys whose value may be an action


def plain_tree(path: Path) -> Document[RootModel[Any]] | None:
    """Return a YAML file as plain values with their positions; None if even the loader refuses it."""
    try:
        return load_yaml(path, RootModel[Any])
    except InputError:
        return None


def driver_names(tree: Document[RootModel[Any]], findings: Findings) -> dict[str, str]:
    """Drivers of a station file by role; those that do not exist are noted (B-PLAN-011)."""
    root = tree.model.root
    instruments = root.get("instruments") if isinstance(root, dict) else None
    found: dict[str, str] = {}
    for role, entry in instruments.items() if isinstance(instruments, dict) else ():
        driver = entry.get("driver") if isinstance(entry, dict) else None
        if isinstance(driver, str):
            found[role] = driver
            _known_driver(driver, tree.where(("instruments", role, "driver")), findings)
    return found


def _known_driver(driver: str, where: str, findings: Findings) -> None:
    try:
        driver_actions(driver)
    except InputError as error:
        if error.code == "B-PLAN-011":  # a name that is not plain is noted by the loader
            findings.add(error.code, where, error.message)


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
