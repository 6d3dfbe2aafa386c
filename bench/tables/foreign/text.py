"""A binary log as the lines of a delimited one: a session holds text that needs no library to be read again.

Numbers are written with all their digits, so nothing is rounded. Decision 0033.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.model.errors import InputError
from bench.plan import ROWS, LogMapping, suggestion
from bench.replay import file_lines
from bench.tables.foreign.opening import ForeignTable, kind_of, open_table

_HASHED_BYTES = 1 << 20


def log_lines(path: Path, mapping: LogMapping, size: int | None = None) -> Iterator[bytes]:
    """Yield lines of a log, with their ends: those of a text file as they are, those of a binary one made of its rows.

    Args:    size: of the lines in bytes where the log was surveyed before: what was added since is left out.
    Raises:  InputError B-IMP-001 (cannot be read), B-IMP-003 (no such column), B-IMP-009 to -011, B-TAB-001.
    """
    kind = kind_of(path)
    if kind is None:
        yield from file_lines(path, size)
        return
    _plain_form(path, kind, mapping)
    left = size
    for line in _lines(path, open_table(path, kind, mapping.file.topic), mapping):
        if left is not None and len(line) > left:
            return
        left = None if left is None else left - len(line)
        yield line


def origin_of(path: Path) -> dict[str, str | int]:
    """Return kind, size and SHA-256 of a binary log for the manifest; empty for text, whose bytes the session holds."""
    kind = kind_of(path)
    if kind is None:
        return {}
    if path.is_dir():
        return {"kind": kind}
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while part := stream.read(_HASHED_BYTES):
            digest.update(part)
    return {"kind": kind, "bytes": path.stat().st_size, "sha256": digest.hexdigest()}


def _plain_form(path: Path, kind: str, mapping: LogMapping) -> None:
    odd = sorted(mapping.file.model_fields_set - {"topic", "names"})
    if odd:
        raise InputError(
            "B-IMP-009",
            f"is a table in binary form ({kind}), so {odd[0]!r} under 'file' means nothing",
            where=str(path),
            next_step=f"remove {', '.join(odd)} from the mapping",
        )


def _lines(path: Path, table: ForeignTable, mapping: LogMapping) -> Iterator[bytes]:
    named = mapping.file.names is not None
    names = table.names if named else _mapped(path, table, mapping)
    if not named:
        yield _line(names)
    try:
        for row in table.rows(names):
            yield _line(row)
    except InputError as error:
        raise InputError(error.code, error.message, where=str(path), next_step=error.next_step) from error


def _line(values: Sequence[object]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(values)
    return text.getvalue().replace("\n", " ")[:-1].encode() + b"\n"


def _mapped(path: Path, table: ForeignTable, mapping: LogMapping) -> list[str]:
    """Return the columns that the mapping reads; one that numbers rows need not be there."""
    header, time = mapping.time
    due = [*([] if time.format == ROWS and header not in table.names else [header]), *mapping.values]
    for name in due:
        if name not in table.names:
            raise InputError(
                "B-IMP-003",
                f"has no column {name!r}{suggestion(name, list(table.names)[:40])}",
                where=str(path),
                next_step="'bench import --guess FILE' lists all columns",
            )
    return due
