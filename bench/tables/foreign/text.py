"""A binary log as the lines of a delimited one: a session holds text that needs no library to be read again.

Numbers are written with all their digits, so nothing is rounded. Decision: docs/decisions/0028-python-api.md.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench.model.errors import InputError
from bench.plan import ROWS, LogMapping, suggestion
from bench.replay import file_lines, first_bytes, text_forms
from bench.tables.foreign.opening import ForeignTable, kind_of, open_table


class OtherLog:
    """A log of another system: text as it is, or a table in binary form whose rows become text.

    Raises: InputError B-IMP-009 to -011, B-TAB-001; when its lines are read, B-IMP-001 and B-IMP-003.
    """

    def __init__(self, path: Path, mapping: LogMapping) -> None:
        self._path, self._mapping = path, mapping
        self._kind = kind_of(path)
        self._table = None
        if self._kind is not None:
            _plain_form(path, self._kind, mapping)
            self._table = open_table(path, self._kind, mapping.file.topic)

    def lines(self, size: int | None = None) -> Iterator[bytes]:
        """Return lines with their ends; ``size``: of a survey before, in bytes: what was added since is left out."""
        if self._table is None:
            return file_lines(self._path, size)
        return first_bytes(_lines(self._path, self._table, self._mapping), size)

    @property
    def origin(self) -> dict[str, str | int]:
        """Kind, size and SHA-256 of the file for the manifest; empty if the session holds its bytes."""
        kind = self._kind or " ".join(text_forms(self._path))
        if not kind:
            return {}
        broken = getattr(self._table, "broken", 0)
        told: dict[str, str | int] = {"kind": kind, **({"broken": broken} if broken else {})}
        if self._path.is_dir():
            return told
        with self._path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256")
        return {**told, "bytes": self._path.stat().st_size, "sha256": digest.hexdigest()}


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
