"""What the first rows of a log show: how the file is written, its columns and their values."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice
from pathlib import Path

from bench.model.errors import InputError
from bench.replay import CONTROL, file_lines, text_forms
from bench.tables import kind_of, open_table, topics_of

ROWS = 2000  # that are looked at
_DELIMITERS = (";", "\t", ",", "|")
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./]*")
_COMMENTS = ("#", "%", "//")


@dataclass(frozen=True)
class Seen:
    """Columns by name, as texts of the first rows; ``form``: entries of the section ``file`` of a mapping."""

    columns: Mapping[str, Sequence[str]]
    kind: str
    form: Mapping[str, str] = field(default_factory=dict)


def sniff(path: Path) -> list[Seen]:
    """Return what a log shows, by topic if it has several that can be read.

    Raises: InputError B-IMP-001 (cannot be read, empty), B-IMP-004 (no table in it), B-IMP-009 to -011, B-TAB-001.
    """
    kind = kind_of(path)
    if kind is None:
        return [_of_text(path)]
    topics, seen = topics_of(path, kind), list[Seen]()
    for topic in topics if len(topics) > 1 else ():
        with suppress(InputError):
            seen.append(_of_table(path, kind, topic))
    return seen or [_of_table(path, kind, None)]


def _of_table(path: Path, kind: str, topic: str | None) -> Seen:
    """Return the columns of the length that holds most values: those of other lengths belong to other tables."""
    table = open_table(path, kind, topic)
    columns = {name: [str(row[0]) for row in islice(table.rows([name]), ROWS)] for name in table.names}
    values: Counter[int] = Counter()
    for column in columns.values():
        values[len(column)] += len(column)
    most = max(values, key=lambda length: (values[length], length))
    form = {"topic": quoted(topic)} if topic else {}
    return Seen({name: column for name, column in columns.items() if len(column) == most}, kind, form)


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
    texts = [line for line in lines if line.strip() and not CONTROL.search(line)]
    kept = [line for line in texts if not (comment and line.startswith(comment))]
    delimiter = _delimiter(kept)
    rows = [_fields(line, delimiter) for line in kept]
    if sum(row[-1:] == [""] for row in rows) > len(rows) / 2:
        rows = [row[:-1] if row[-1] == "" else row for row in rows]
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    begin = next((place for place, row in enumerate(rows) if len(row) == width), 0)
    if width < 1 or len(rows) - begin < 2 or len(texts) < len(lines) / 2:
        raise InputError(
            "B-IMP-004",
            "holds no table that can be told",
            where=path,
            next_step="write the mapping by hand (docs/importing.md), or name another file",
        )
    form = {} if delimiter == "," else {"delimiter": "whitespace" if delimiter is None else quoted(delimiter)}
    form |= {"encoding": encoding} if encoding != "utf-8" else {}
    form |= {"comment": quoted(comment)} if comment else {}
    if named := not any(is_number(text) or moment_of(text) for text in rows[begin]):
        names = [text.strip() for text in rows[begin]]
        if len(set(told := list(filter(None, names)))) < len(told):
            if not any(map(is_number, below := rows[begin + 1])) and len(below) == width:
                names, begin = [f"{name}_{text.strip()}" for name, text in zip(names, below, strict=True)], begin + 1
            names = [name if names.index(name) == place else f"{name}_{place}" for place, name in enumerate(names)]
            form["names"] = f"[{', '.join(map(quoted, names))}]"
        if begin or kept[0] != lines[0]:
            form["header"] = str(lines.index(kept[begin]) + 1)
    else:
        above = texts[: texts.index(kept[0])][-1:] if comment else []
        names = [text.strip() for line in above for text in _fields(line.lstrip(f"{comment} "), delimiter)]
        if len(names) != width or len(set(names) - {""}) < width:
            names = [f"c{place}" for place in range(width)]
        form["names"] = f"[{', '.join(map(quoted, names))}]"
    body = [row for row in rows[begin + named :] if len(row) == width]
    columns = {name: [row[place].strip() for row in body] for place, name in enumerate(names) if name}
    if delimiter != "," and any("," in text and is_number(text.replace(",", ".")) for row in body for text in row):
        columns = {name: [text.replace(",", ".") for text in values] for name, values in columns.items()}
        form["decimal"] = "','"
    return Seen(columns, " ".join(["text", *text_forms(path)]), form)


def quoted(text: str) -> str:
    """Return a text as YAML has it."""
    if not text.isprintable():
        return json.dumps(text)
    return text if _PLAIN.fullmatch(text) else "'" + text.replace("'", "''") + "'"


def _delimiter(lines: Sequence[str]) -> str | None:
    """Return the character that stands in the lines equally often, None for blanks."""
    for mark in _DELIMITERS:
        counts = Counter(line.count(mark) for line in lines[:200])
        often, times = counts.most_common(1)[0] if counts else (0, 0)
        if often > 0 and times > 0.5 * len(lines[:200]):
            return mark
    return "," if lines and moment_of(lines[0]) else None


def moment_of(text: str) -> datetime | None:
    """Return the time that a text of the ISO form is."""
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def _fields(line: str, delimiter: str | None) -> list[str]:
    return line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter))


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
