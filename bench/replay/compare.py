"""Says whether two results are the same to the last bit, and where they are not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

ABSENT = "(absent)"


@dataclass(frozen=True)
class Difference:
    """One value that differs; ``path`` such as ``estimates[3].value``."""

    path: str
    first: Any
    second: Any

    def __str__(self) -> str:
        return f"{self.path}: {self.first!r} != {self.second!r}"


def compare(first: Any, second: Any, path: str = "") -> list[Difference]:
    """Return every difference between two JSON documents (mappings, lists, numbers, texts), in order.

    Numbers are equal only if every bit is: 1 and 1.0 differ, 0.0 and -0.0 differ, NaN equals NaN.
    """
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        differences = []
        for key in sorted({*first, *second}):
            name = f"{path}.{key}" if path else str(key)
            differences += compare(first.get(key, ABSENT), second.get(key, ABSENT), name)
        return differences
    if _is_list(first) and _is_list(second):
        differences = []
        for index in range(max(len(first), len(second))):
            element = first[index] if index < len(first) else ABSENT
            other = second[index] if index < len(second) else ABSENT
            differences += compare(element, other, f"{path}[{index}]")
        return differences
    same = type(first) is type(second) and repr(first) == repr(second)
    return [] if same else [Difference(path, first, second)]


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))
