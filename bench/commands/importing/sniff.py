"""What the first rows of a log show: how the file is written, its columns and their values."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from bench.model.errors import InputError
from bench.replay import file_lines
from bench.tables import kind_of, open_table

ROWS = 2000  # that are looked at
_DELIMITERS = (";", "\t", ",", "|")
_COMMENTS = ("#", "%", "//")


@dataclass(frozen=True)
class Seen:
    """Columns by name, as texts of the first rows; ``form``: entries of the section ``file`` of a mapping."""

    columns: Mapping[str, Sequence[str]]
    kind: str
    form: Mapping[str, str] = field(default_factory=dict)


def sniff(path: Path) -> Seen:
    """Return what a log shows.

    Raises: InputError B-IMP-001 (cannot be read, empty), B-IMP-004 (no table in it), B-IMP-009 to -011, B-TAB-001.
    """
    kind = kind_of(path)
    return _of_text(path) if kind is None else _of_table(path, kind)


def _of_table(path: Path, kind: str) -> Seen:
    """Return the columns of the commonest length: those of other lengths belong to other tables."""
    table = open_table(path, kind, None)
    columns: dict[str, list[str]] = {}
    lengths: Counter[int] = Counter()
    for name in table.names:
        columns[name] = [str(row[0]) for row in islice(table.rows([name]), ROWS)]
        lengths[len(columns[name])] += 1
    longest = max(lengths, key=lambda length: (lengths[length], length))
    return Seen({name: values for name, values in columns.items() if len(values) == longest}, kind)


def _of_text(path: Path) -> Seen:
    raw = list(islice(file_lines(path), ROWS))
    if not raw:
        raise InputError("B-IMP-001", "is empty", where=path, next_step="name the file of the log")
    try:
        lines, encoding = [line.decode("utf-8-sig") for line in raw], "utf-8"
    except UnicodeDecodeError:
        lines, encoding = [line.decode("latin-1") for line in raw], "latin-1"
    lines = [line.strip("\r\n") for line in lines]
    comment = next((mark for mark in _COMMENTS if lines[0].startswith(mark)), None)
    kept = [line for line in lines if line.strip() and not (comment and line.startswith(comment))]
    delimiter = _delimiter(kept)
    rows = [_fields(line, delimiter) for line in kept]
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    begin = next((place for place, row in enumerate(rows) if len(row) == width), 0)
    if width < 1 or len(rows) - begin < 2:
        raise InputError(
            "B-IMP-004",
            "holds no table that can be told",
            where=path,
            next_step="write the mapping by hand (docs/importing.md), or name another file",
        )
    named = not any(_is_number(text) for text in rows[begin])
    names = [text.strip() for text in rows[begin]] if named else [f"c{place}" for place in range(width)]
    body = [row for row in rows[begin + named :] if len(row) == width]
    comma = delimiter != "," and any("," in text and _is_number(text.replace(",", ".")) for row in body for text in row)
    columns = {name: [row[place].strip() for row in body] for place, name in enumerate(names) if name}
    if comma:
        columns = {name: [text.replace(",", ".") for text in values] for name, values in columns.items()}
    form = {} if delimiter == "," else {"delimiter": "whitespace" if delimiter is None else repr(delimiter)}
    form |= {"decimal": "','"} if comma else {}
    form |= {"encoding": encoding} if encoding != "utf-8" else {}
    form |= {"comment": repr(comment)} if comment else {}
    if not named:
        form["names"] = f"[{', '.join(names)}]"
    elif begin:
        form["header"] = str(lines.index(kept[begin]) + 1)
    return Seen(columns, "text", form)


def _delimiter(lines: Sequence[str]) -> str | None:
    """Return the character that stands in the lines equally often, None for blanks."""
    for mark in _DELIMITERS:
        counts = Counter(line.count(mark) for line in lines[:200])
        often, times = counts.most_common(1)[0] if counts else (0, 0)
        if often > 0 and times > 0.5 * len(lines[:200]):
            return mark
    return None


def _fields(line: str, delimiter: str | None) -> list[str]:
    return line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
