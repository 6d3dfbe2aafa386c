"""``bench import --guess``: a mapping proposed from what a log shows; what it cannot tell is marked ``FILL_IN``.

What the first rows of a log show: how the file is written, its columns and their values.
"""

from __future__ import annotations

import csv
import json
import math
import re
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.commands.console import warn
from bench.model.declaration import Hint
from bench.model.errors import ExitStatus, InputError
from bench.model.systems import system_refusals, systems
from bench.model.units import dimension_of, likely, read_quantity
from bench.replay import CONTROL, file_lines, text_forms
from bench.tables import LOG_TIME, kind_of, open_table, topics_of

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


FILL_IN = "FILL_IN"
_TIME = re.compile(r"(^|[^a-z])(t|ts|utc|tow|sec|secs|seconds|ms|us|ns)([^a-z]|$)|time|date|stamp|epoch")
_EPOCHS = (("s", 5e8, 5e9), ("ms", 5e11, 5e12), ("us", 5e14, 5e15), ("ns", 5e17, 5e18))
_NO_DATE = "1970-01-01T00:00:00Z"
_DATES = ("%d/%m/%Y", "%m/%d/%Y", "%d/%m/%y", "%m/%d/%y", "%d.%m.%Y", "%d.%m.%y", "%d-%m-%Y", "%Y/%m/%d", "%Y.%m.%d")
_PATTERNS = [f"{date} %H:%M:%S{more}" for date in _DATES for more in ("", ".%f")]
_PATTERNS += [f"{date} %I:%M:%S{more}%p" for date in ("%m/%d/%Y", "%m/%d/%y") for more in (" ", "", ".%f ")]
_DAY_s = 86400.0
_SERIAL_DAYS = (36526.0, 73051.0)  # of the years 2000 to 2099 in a spreadsheet
_LONG_s = 120.0  # between rows whose times are such days
_OVERLOAD = 9.0e36  # what an instrument writes in place of a number is as large
_AXES = 3  # of a triad
_ODD_TEXTS = 3  # among the numbers of a column
_AXIS = re.compile(r"[xyz](?![a-z]|\d{3})")
_NUMBER = re.compile(r"\d+\]?$")
_UNIT = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$")
_POWER = re.compile(r"[ *]([a-z]+)\^?-([12])$")
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class _Column:
    """A column, or those that differ by a number; values are None for texts."""

    name: str
    values: Numbers | None
    hint: Hint | None
    axis: str


def guess(path: Path) -> int:
    """Print the proposal; it runs as soon as each FILL_IN is replaced."""
    seen = sniff(path)
    most = max(seen, key=lambda one: sum(_hint(name) is not None for name in one.columns))
    sys.stdout.write(proposal(most, path, [one.form["topic"] for one in seen if one is not most]))
    for offer, error in system_refusals():
        warn(f"without {offer.what} of {offer.release}: {error}")
    return ExitStatus.PASS


def proposal(seen: Seen, path: Path, others: Sequence[str] = ()) -> str:
    """Return the text of a mapping; it names the other topics."""
    odd: set[str] = set()
    numbers = {name: _numbers(values, odd) for name, values in seen.columns.items()}
    time, time_line = _time(seen, numbers)
    columns = _columns({name: values for name, values in numbers.items() if name != time}, path.stem)
    units = _units(columns)
    analysis, more = _analysis([column.hint for column in columns if column.hint is not None])
    slug = re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_")
    name = slug if slug[:1].isalpha() else f"log_{slug}"
    form = ", ".join(f"{key}: {value}" for key, value in seen.form.items())
    peaks = [np.nanmax(np.abs(column.values)) for column in columns if column.values is not None]
    overload = [f"at_least: {_OVERLOAD:.1e}"] if max(peaks, default=0.0) >= _OVERLOAD else []
    overload += [f"values: [{', '.join(map(quoted, sorted(odd)))}]"] if odd else []
    head = [
        f"# Proposed for {path.name} ({seen.kind}) by its first {max(map(len, seen.columns.values()))} rows.",
        f"# Replace each {FILL_IN}, look at roles and units, and name an analysis (docs/importing.md).",
        f"mapping: {name[:40].rstrip('_')}",
        f"uut: {{model: {FILL_IN}, serial: {FILL_IN}}}",
        f"analysis: {analysis}{more}",
        *([f"file: {{{form}}}" + (f"  # or: {', '.join(others)}" if others else "")] if form else []),
        *([f"overload: {{{', '.join(overload)}}}  # what stands for no number"] if overload else []),
        "columns:",
        time_line,
    ]
    lines = [f"  {quoted(column.name)}: {_entry(column, units)}  # {_range(column.values)}" for column in columns]
    return "\n".join([*head, *lines]) + "\n"


def _analysis(hints: Sequence[Hint]) -> tuple[str, str]:
    """Return an analysis that takes all roles and asks for nothing more, and a comment with the others that do."""
    roles = {hint.role for hint in hints}
    taking = [
        declared.name
        for system in systems()
        for declared in system.analyses
        if hints
        and declared.roles
        and roles <= {*declared.roles, "temperature"}
        and all(sum(hint.role == role for hint in hints) == _AXES for role in declared.triads)
    ]
    proposed = next((hint.analysis for hint in hints if hint.analysis in taking), "none")
    others = [name for name in taking if name != proposed]
    return proposed, f"  # or: {', '.join(others)}" if others else ""


def _columns(numbers: Mapping[str, Numbers | None], stem: str) -> list[_Column]:
    """Return the columns with what names tell; those of one role that come by number as one, ``{0..423}`` in its name.

    The name of the file tells what x, y and z are, or its only column.
    """
    bare = ("x", "y", "z") if len(numbers) > 1 else ("x", "y", "z", "c0")
    columns = []
    groups: dict[tuple[str, str], dict[int, _Column]] = {}
    for name, values in numbers.items():
        label = f"{stem}_{name}" if name in bare else name
        hint, digits = None if values is None else _hint(label), list(re.finditer(r"\d+", name))
        column = _Column(name, values, hint, _axis(label, list(numbers)))
        if hint is not None and hint.numbered and digits:
            around = name[: digits[-1].start()], name[digits[-1].end() :]
            groups.setdefault(around, {})[int(digits[-1][0])] = column
        else:
            columns.append(column)
    for (before, behind), group in groups.items():
        values = np.concatenate([column.values for column in group.values() if column.values is not None])
        name = f"{before}{{{min(group)}..{max(group)}}}{behind}"
        columns.append(replace(group[min(group)], name=name, values=values))
    return _one_of_each(columns)


def _one_of_each(columns: Sequence[_Column]) -> list[_Column]:
    """Return the columns, those ignored that play a role which another one plays, or plays better."""
    taken, kept = set[tuple[str, str]](), []
    for column in columns:
        hint = column.hint
        if hint is not None and not hint.numbered:
            place = hint.role, column.axis if hint.by_axis else ""
            axes = {other.axis for other in columns if other.hint is hint}
            if place in taken or (hint.by_axis and column.axis == FILL_IN and len(axes) > 1):
                column = replace(column, hint=None)
            taken.add(place)
        kept.append(column)
    return kept


def _numbers(values: Sequence[str], odd: set[str]) -> Numbers | None:
    """Return a column as numbers, NaN for the texts that stand for none, which are noted; None if it holds others."""
    texts = {text for text in values if not is_number(text) or math.isnan(float(text))}
    if len(texts) > _ODD_TEXTS or sum(text in texts for text in values) > len(values) / 2:
        return None
    odd |= texts
    return np.array([np.nan if text in texts else float(text) for text in values])


def _time(seen: Seen, numbers: Mapping[str, Numbers | None]) -> tuple[str | None, str]:
    """Return the column that says when a row was taken and its line, or a line that numbers the rows."""
    found = list[tuple[int, int, str, str]]()
    for name, values in numbers.items():
        told, entry = _TIME.search(name.lower()) is not None, None
        if told and values is not None and 0.0 <= values.min() <= values.max() < 2**32:
            values = np.unwrap(values, period=2**32)
        if values is None:
            entry = _dated(seen.columns[name])
        elif _rises(values) and (told or np.all(np.diff(values) == 1.0) or _may_be_time(name, numbers)):
            entry = _counted(name, values, told)
        if entry is not None:
            seconds = values is not None and not np.median(np.diff(values))  # several rows share each of them
            rank = 4 if not told else 3 if seconds or f"unit: {FILL_IN}" in entry else 0
            rank = 2 if "format: samples" in entry else 1 if name == LOG_TIME else rank  # of the recorder, not the unit
            found.append((rank, len(found), name, entry))
    if found:
        *_, name, entry = min(found)
        return name, f"  {quoted(name)}: {entry}"
    return None, f"  row: {{role: time, format: rows, rate: {FILL_IN}, start: {_NO_DATE}}}  # no column tells the time"


def _may_be_time(name: str, names: Collection[str]) -> bool:
    """Return False for what is known as something else that rises, such as a counter, or is one of x, y and z."""
    hint = _hint(name)
    coordinate = name[-1:] in "xyz" and all(name[:-1] + axis in names for axis in "xyz")
    return (hint is None or hint.by_axis) and not coordinate


def _rises(values: Numbers) -> bool:
    return values.size > 1 and bool(np.all(np.diff(values) >= 0.0)) and bool(values[-1] > values[0])


def _dated(values: Sequence[str]) -> str | None:
    """Return the entry of a column of dates; its format is to be filled in where day and month look alike."""
    first = moment_of(values[0])
    if first is not None:
        return f"{{role: time, format: iso, zone: {'UTC' if first.tzinfo else FILL_IN}}}  # {values[0]}"
    fitting = [pattern for pattern in _PATTERNS if all(_reads(text, pattern) for text in values)]
    form = quoted(fitting[0]) if len(fitting) == 1 else FILL_IN
    entry = f"{{role: time, format: {form}, zone: {FILL_IN}}}  # {values[0]}: {' or '.join(map(quoted, fitting))}"
    return entry if fitting else None


def _reads(text: str, pattern: str) -> bool:
    with suppress(ValueError):
        return bool(datetime.strptime(text, pattern))
    return False


def _counted(name: str, values: Numbers, told: bool) -> str:
    """Return the entry of a column of time in numbers, with the step that it means."""
    step, is_fine = float(values[-1] - values[0]) / (values.size - 1), "sampletimefine" in name.lower()  # of Xsens
    for unit, low, high in _EPOCHS:
        if low < values[0] < high and not is_fine:
            return f"{{role: time, format: unix, unit: {unit}}}  # a step of {step:.6g} {unit}"
    words = [_known_unit(word) for word in re.split(r"[^a-z]+", name.lower())] if told else []
    units = (word for word in words if (read_quantity(f"1 {word}") or (0, ""))[1] == "s")
    unit = "0.1 ms" if is_fine else next(units, "")
    step_s, (low, high) = step * _DAY_s, _SERIAL_DAYS
    if told and not unit and low <= values[0] < high and round(step_s, 1) in range(1, int(_LONG_s)):
        return (
            "{role: time, format: elapsed, unit: d, start: 1899-12-30T00:00:00Z}"
            f"  # days of a spreadsheet, a step of {step_s:.6g} s; its zone in place of Z"
        )
    if not unit and step == 1.0 and np.all(values == np.round(values)):
        return f"{{role: time, format: samples, rate: {FILL_IN}, start: {_NO_DATE}}}  # numbers of samples"
    unit = unit or ("s" if 0.0 < step < 1.0 else FILL_IN)
    return f"{{role: time, format: elapsed, unit: {unit}, start: {_NO_DATE}}}  # a step of {step:.6g}"


def _hints() -> list[Hint]:
    return [hint for system in systems() for hint in system.log_hints]


def _hint(name: str) -> Hint | None:
    plain = re.sub(r"[\[(][^\])0-9]*[\])]", "", name).lower()
    if "timestamp" in plain:
        return None
    return next((hint for hint in _hints() if re.search(hint.pattern, plain)), None)


def _known_unit(text: str) -> str:
    """Return a unit as the bench writes it, "" if it knows none such."""
    plain = _POWER.sub(lambda power: f"/{power[1]}{power[2].replace('1', '')}", text)
    return plain if read_quantity(f"1 {plain}") else likely(f"1 {plain}").partition("'1 ")[2].rstrip("'?")


def _units(columns: Sequence[_Column]) -> dict[str, str]:
    """Return the unit of each role by the largest magnitude of its columns, where ranges tell."""
    largest: dict[str, float] = {}
    for column in columns:
        if column.hint is not None and column.values is not None and np.isfinite(column.values).any():
            role = column.hint.role
            largest[role] = max(largest.get(role, 0.0), float(np.nanmedian(np.abs(column.values))))
    found = {}
    for hint in _hints():
        fitting = [unit for unit, low, high in hint.units or () if low <= largest.get(hint.role, -1.0) < high]
        if len(fitting) == 1:
            found[hint.role] = fitting[0]
    return found


def _entry(column: _Column, units: Mapping[str, str]) -> str:
    hint = column.hint
    if hint is None:
        return "{role: ignore}"
    written = _UNIT.search(column.name)
    unit = _known_unit(written[1]) if written and not written[1].isdigit() else ""
    due = {dimension_of(known) for known, _, _ in hint.units or ()}
    unit = unit if not unit or not due or dimension_of(unit) in due else ""
    entries = [f"role: {hint.role}", *([f"axis: {column.axis}"] if hint.by_axis else [])]
    entries += [f"{key}: {value}" for key, value in hint.more.items()]
    entries += [] if hint.units is None else [f"unit: {unit or units.get(hint.role, FILL_IN)}"]
    return f"{{{', '.join(entries)}}}"


def _axis(name: str, names: Sequence[str]) -> str:
    """Return the axis by the last letter x, y or z of a name, or by its number among three columns at its end."""
    stem = _NUMBER.sub("", name)
    letters = [] if stem.endswith("[") else _AXIS.findall(name.lower())
    siblings = [other for other in names if other != stem and _NUMBER.sub("", other) == stem]
    by_number = "xyz"[siblings.index(name)] if len(siblings) == 3 and name in siblings else FILL_IN
    return letters[-1] if letters else by_number


def _range(values: Numbers | None) -> str:
    if values is None or not np.isfinite(values).any():
        return "texts" if values is None else "no numbers"
    return f"{np.nanmin(values):.4g} to {np.nanmax(values):.4g}, median {np.nanmedian(values):.4g}"
