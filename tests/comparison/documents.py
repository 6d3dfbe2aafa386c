"""Two folders of files, compared by their formats.

Sessions message by message, JSON field by field, pages by what a reader sees, other texts by line.
"""

import difflib
import json
import re
import sqlite3
import struct
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from fnmatch import fnmatchcase
from html.parser import HTMLParser
from itertools import zip_longest
from pathlib import Path
from typing import Any

from mcap.stream_reader import StreamReader
from views import UNAVAILABLE

ABSENT = "(absent)"
_SEALED = struct.Struct("<IQQ")  # in front of each payload: CRC, running number, time
_REVISION = re.compile(r"\b[0-9a-f]{40}\b( with local modifications)?")
_DISTRIBUTION = re.compile(r"^.*>software\.distributions\..*\n", re.MULTILINE)  # of younger sessions only


@dataclass(frozen=True)
class Difference:
    """One place of one file; ``place`` is a path in a document, or a line of a text."""

    file: str
    place: str
    base: str
    new: str


@dataclass(frozen=True)
class Named:
    """Differences that are expected, by patterns of file and place, and why."""

    files: str
    place: str
    reason: str

    def covers(self, difference: Difference) -> bool:
        """Return whether it explains this difference."""
        return fnmatchcase(difference.file, self.files) and fnmatchcase(difference.place, self.place)


def named_differences(path: Path) -> list[Named]:
    """Read the list of expected differences."""
    entries = tomllib.loads(path.read_text(encoding="utf-8")).get("difference", [])
    return [Named(entry["files"], entry["place"], entry["reason"]) for entry in entries]


def compare_folders(base: Path, new: Path) -> Iterator[Difference]:
    """Yield every difference between the files of two folders of one case, by name."""
    folders = (base, new)
    names = [{str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} for folder in folders]
    marks = [_session_marks(folder.parent) for folder in folders]
    for name in sorted(names[0] | names[1]):
        if name not in names[0] or name not in names[1]:
            yield Difference(name, "file", *("there" if name in files else ABSENT for files in names))
        elif (base / name).read_bytes() != (new / name).read_bytes():
            first, second = (_document(folder / name, mark) for folder, mark in zip(folders, marks, strict=True))
            if not (_is_unavailable(first) or _is_unavailable(second)):  # that is told of each side
                yield from (Difference(name, *found) for found in _differences(first, second))


def unavailable_views(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield each file below a folder that its revision could not write, and why."""
    for path in sorted([*folder.rglob("live_state.json"), *folder.rglob("*.plan.json")]):
        document = json.loads(path.read_text(encoding="utf-8"))
        if _is_unavailable(document):
            yield str(path.relative_to(folder)), document[UNAVAILABLE]


def _is_unavailable(document: Any) -> bool:
    return isinstance(document, dict) and document.keys() == {UNAVAILABLE}


def _session_marks(folder: Path) -> dict[str, str]:
    """Map the hash of each session of a side to a word: it covers the manifest, which names the revision."""
    marks = {}
    for path in sorted(folder.rglob("results.json")):
        value = json.loads(path.read_text(encoding="utf-8")).get("provenance", {}).get("session_sha256")
        if value:
            marks[value] = "<hash of the session>"
    return marks


def _document(path: Path, marks: Mapping[str, str]) -> Any:
    """Read a file as the JSON-like document in which it is compared."""
    if path.suffix == ".mcap":
        return _messages(path)
    if path.suffix == ".sqlite":
        return _tables(path)
    content = path.read_bytes()
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        return {"bytes": content.hex()}
    if path.suffix == ".json":
        return json.loads(text)
    return _lines("\n".join(_Text(text).parts) if path.suffix == ".html" else text, marks)


class _Text(HTMLParser):
    """What a reader sees of a page, a piece for each stretch of text; its figures are drawn from numbers."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.parts: list[str] = []
        self._hidden = 0
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self._hidden += tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:
        self._hidden -= tag in ("script", "style")

    def handle_data(self, data: str) -> None:
        if not self._hidden and (text := " ".join(data.split())):
            self.parts.append(text)


def _tables(path: Path) -> dict[str, Any]:
    """Return the rows of each table of a database, by table and column."""
    with closing(sqlite3.connect(path)) as connection:
        connection.row_factory = sqlite3.Row
        names = [row["name"] for row in connection.execute("select name from sqlite_master where type = 'table'")]
        return {name: [dict(row) for row in connection.execute(f'select * from "{name}"')] for name in names}


def _lines(text: str, marks: Mapping[str, str]) -> tuple[str, ...]:
    for value, word in marks.items():
        text = text.replace(value, word)
    text = _DISTRIBUTION.sub("", _REVISION.sub("<revision>", text))
    return tuple(text.splitlines())


def _messages(path: Path) -> dict[str, Any]:
    """Return the messages of a segment by topic, in order, with their times; and the order of the topics."""
    topics: dict[int, str] = {}
    document: dict[str, Any] = {"order": []}
    with path.open("rb") as stream:
        for record in StreamReader(stream).records:
            if type(record).__name__ == "Channel":
                topics[record.id] = record.topic
            elif type(record).__name__ == "Message":
                topic = topics[record.channel_id]
                _, number, t_ns = _SEALED.unpack_from(record.data)
                payload = record.data[_SEALED.size :]
                document["order"].append([number, topic])
                document.setdefault(topic, []).append({"t_ns": t_ns, "payload": _payload(payload)})
    return document


def _payload(payload: bytes) -> Any:
    try:
        return json.loads(payload)
    except ValueError:
        return payload.hex()


def _differences(base: Any, new: Any, place: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield place, base and new of what is not the same to the last bit."""
    if isinstance(base, dict) and isinstance(new, dict):
        for key in sorted({*base, *new}):
            yield from _differences(base.get(key, ABSENT), new.get(key, ABSENT), f"{place}.{key}" if place else key)
    elif isinstance(base, list) and isinstance(new, list):
        for index, (first, second) in enumerate(zip_longest(base, new, fillvalue=ABSENT)):
            yield from _differences(first, second, f"{place}[{index}]")
    elif isinstance(base, tuple) and isinstance(new, tuple):
        yield from _line_differences(base, new)
    elif type(base) is not type(new) or repr(base) != repr(new):
        yield place, _short(base), _short(new)


def _line_differences(base: tuple[str, ...], new: tuple[str, ...]) -> Iterator[tuple[str, str, str]]:
    """Yield the lines that are not alike, by their numbers in the base; a line that comes new moves no other one."""
    for tag, a, b, c, d in difflib.SequenceMatcher(None, base, new, autojunk=False).get_opcodes():
        if tag != "equal":
            for index, (first, second) in enumerate(zip_longest(base[a:b], new[c:d], fillvalue=ABSENT)):
                yield f"line {a + 1 + index}", _short(first), _short(second)


def _short(value: Any) -> str:
    text = value if value is ABSENT else repr(value)
    return text if len(text) <= 100 else f"{text[:97]}..."
