"""The values of a plan by their names: which reading each is of, under which conditions, and what is expected of it."""

from __future__ import annotations

import json
from typing import Any

from bench.plan.values import SUFFIX

_UNITS = {suffix: unit for unit, suffix in SUFFIX.items() if suffix}


class NamedValues:
    """The values of one plan, in the order in which they are first read."""

    def __init__(self) -> None:
        self._entries: dict[tuple[str, str], dict[str, Any]] = {}
        self._read_by: dict[str, str] = {}
        self._conditions: dict[str, None] = {}

    @property
    def entries(self) -> list[dict[str, Any]]:
        """Each with quantity, unit and conditions, and of low, high, span and uncertainty those that are stated."""
        return list(self._entries.values())

    def add(self, entry: dict[str, Any], read_by: str) -> str:
        """Take a value; return what is wrong with it, "" if nothing is."""
        name = entry["quantity"]
        key = name, json.dumps(entry["conditions"], sort_keys=True)
        if self._read_by.setdefault(name, read_by) != read_by:
            return f"{name!r} is read by {self._read_by[name]} and by {read_by}: one name is of one reading"
        if self._entries.setdefault(key, entry) != entry:
            return f"{name!r} is expected elsewhere under the same conditions, and to be another value"
        self._conditions.update(dict.fromkeys(entry["conditions"]))
        return ""

    def unit_of(self, name: str) -> str | None:
        """Return the unit of a quantity, None if nothing of this name is read."""
        return next((entry["unit"] for entry in self.entries if entry["quantity"] == name), None)

    def condition(self, name: str) -> tuple[str, str] | None:
        """Return a condition by the name it has in the sequence, with its unit; None if no value has it."""
        for known in self._conditions:
            suffix = known.removeprefix(f"{name}_")
            if known == name or (known != suffix and suffix in _UNITS):
                return known, "1" if known == name else _UNITS[suffix]
        return None

    @property
    def names(self) -> list[str]:
        """Names of all quantities."""
        return list(self._read_by)
