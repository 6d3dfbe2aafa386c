"""Changes a sequence as text: what the user wrote stays, with its comments, but for the lines that are changed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import RootModel

from bench.model.errors import InputError
from bench.model.yamlio import Path_, parse_yaml


class _Tree(RootModel[dict[str, Any]]):
    """A sequence as plain values."""


class SequenceText:
    """The lines of a sequence, and where each value stands in them; changes are made when the text is asked for."""

    def __init__(self, text: str, name: str) -> None:
        """Read a text that compiles; ``name`` is its file in messages."""
        self._document = parse_yaml(text, name, _Tree)
        self._lines = text.splitlines()
        self._changes: dict[int, tuple[int, list[str]]] = {}  # first line -> line behind the last, what comes instead

    @property
    def tree(self) -> dict[str, Any]:
        """Return all values, as YAML reads them."""
        return self._document.model.root

    def where(self, path: Path_) -> str:
        """Return ``file:line:column`` of a value."""
        return self._document.where(path)

    def block(self, path: Path_) -> list[str]:
        """Return the lines of a list entry or of a key with all below it, as changed so far.

        Comments behind it belong to what follows. Raises: InputError B-DES-005.
        """
        return self._changed(*self._extent(path))

    def count(self, words: str) -> int:
        """Return how often words stand in the given text."""
        return "\n".join(self._lines).count(words)

    def set_value(self, path: Path_, value: str, reason: str) -> None:
        """Write another value behind a key that has one line, and the reason as a comment before that of the user.

        Raises: InputError B-DES-005 if it has more lines.
        """
        first, behind = self._extent(path)
        line = self._lines[first]
        key, colon, rest = line.partition(f"{path[-1]}:")
        if behind - first != 1 or not colon:
            raise self._shared(path)
        comment = "; ".join(part for part in (reason, rest.partition(" #")[2].strip()) if part)
        self._changes[first] = behind, [f"{key}{colon} {value}{f'  # {comment}' if comment else ''}"]

    def replace_below(self, path: Path_, lines: Sequence[str]) -> None:
        """Write other lines below a key. Raises: InputError B-DES-005 if what it has stands on its own line."""
        first, behind = self._below(path)
        self._changes[first] = behind, list(lines)

    def remove(self, path: Path_) -> None:
        """Leave out a key or list entry. Raises: InputError B-DES-005 if it shares a line."""
        first, behind = self._extent(path)
        self._changes[first] = behind, []

    def insert_below(self, path: Path_, lines: Sequence[str]) -> None:
        """Write lines as the first ones below a key. Raises: InputError B-DES-005 as ``replace_below``."""
        at, _ = self._below(path)
        self._changes[at] = at, list(lines)

    def text(self, heading: Sequence[str]) -> str:
        """Return the changed text under a heading of comments."""
        lines = self._changed(0, len(self._lines))
        return "\n".join([*(f"# {line}".rstrip() for line in heading), "#", *lines]) + "\n"

    def _changed(self, begin: int, end: int) -> list[str]:
        lines = self._lines[begin:end]
        for first, (behind, instead) in sorted(self._changes.items(), reverse=True):
            if begin <= first < end:
                lines[first - begin : behind - begin] = instead
        return lines

    def _below(self, path: Path_) -> tuple[int, int]:
        first, behind = self._extent(path)
        if self._lines[first].partition(" #")[0].rstrip()[-1:] != ":":
            raise self._shared(path)
        return first + 1, behind

    def _shared(self, path: Path_) -> InputError:
        message = f"{path[-1]!r} cannot be changed: it has more than a line, or shares one"
        return InputError("B-DES-005", message, where=self.where(path), next_step="write it on a line of its own")

    def _extent(self, path: Path_) -> tuple[int, int]:
        mark = self._document.marks[path]
        first = mark.line - 1
        if self._lines[first][: mark.column - 1].strip(" -"):
            raise self._shared(path)
        indent, is_entry = _indent(self._lines[first]), isinstance(path[-1], int)
        behind = first + 1
        for number in range(first + 1, len(self._lines)):
            line = self._lines[number].strip()
            if line and not line.startswith("#"):
                below = _indent(self._lines[number]) > indent - (line[:1] == "-" and not is_entry)
                if not below:
                    break
                behind = number + 1
        return first, behind


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" "))
