"""Collects every mistake found in a plan, each place once, with the loop it was met in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Generic

from bench.model.errors import InputError, InputErrors, listed
from bench.model.yamlio import Document, ModelT, Path_


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?``, or else the words that are known."""
    words = sorted(known)
    close = get_close_matches(word, words, n=1)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(words) or 'none'}"


class Findings:
    """Mistakes in order of discovery; the same code at the same place from the same origin is listed once.

    ``way``: the decisions that lead to where the check is now, by place, and their outcomes.
    """

    def __init__(self) -> None:
        self.way: Mapping[str, str] = {}
        self._found: dict[tuple[str, str, str], InputError] = {}

    def add(self, code: str, where: str, message: str, next_step: str = "", origin: str = "") -> None:
        """Note a mistake; ``origin`` says where a wrong value was written, if that is another place."""
        if (code, where, origin) not in self._found:
            text = f"{message} (from {origin})" if origin else message
            way = ", ".join(f"{place} takes '{outcome}'" for place, outcome in self.way.items())
            text = f"{text}, where {way}" if way else text
            self._found[code, where, origin] = InputError(code, text, where=where, next_step=next_step)

    def extend(self, error: InputError) -> None:
        """Note what was raised elsewhere: one mistake, or all those of an InputErrors."""
        for single in error.errors if isinstance(error, InputErrors) else [error]:
            self._found.setdefault((single.code, single.where, single.message), single)

    def __bool__(self) -> bool:
        return bool(self._found)

    def all(self) -> list[InputError]:
        """Return every mistake by file and position."""
        unique = {(error.code, error.where, error.message): error for error in self._found.values()}
        return sorted(unique.values(), key=lambda error: _position(error.where))

    def sorted(self) -> list[InputError]:
        """Return the first mistakes by file and position, and how many more there are (B-YAML-017)."""
        return listed(self.all())


@dataclass
class Draft(Generic[ModelT]):
    """A file as it is checked, and the mistakes that are found in it."""

    document: Document[ModelT]
    findings: Findings

    @property
    def model(self) -> ModelT:
        """What the file says."""
        return self.document.model

    def fail(self, code: str, path: Path_, message: str, next_step: str = "", origin: str = "") -> None:
        """Note a mistake at a place of the file."""
        self.findings.add(code, self.document.where(path), message, next_step, origin)

    def line(self, path: Path_) -> str:
        """Return the number of the line of a place of the file."""
        return self.document.where(path).split(":")[-2]


def _position(where: str) -> tuple[str, int, int]:
    name, _, rest = where.partition(":")
    line, _, column = rest.partition(":")
    return name, int(line) if line.isdecimal() else 0, int(column) if column.isdecimal() else 0
