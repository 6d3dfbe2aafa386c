"""Flushed journal of finished steps: one line each, so that a stopped run knows where it was.

A line is the CRC-32 of its JSON text, started from the number of the line (from 1), in eight hex digits, a blank and
the text. Zeros, a torn line or a line out of place are never taken for a step, and are cut away.

This is the first form, and its lines name no version. A later form has other fields (``v`` is to say which it is), so
a line with a right sum and any field more or less is of other software: it is refused, never cut or read as less.
"""

from __future__ import annotations

import json
import os
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from bench.model.errors import NEXT_FORM, InputError
from bench.model.posix import ALONE, lock_file
from bench.model.quantities import Values
from bench.record.layout import Files, OsFiles, canonical_json
from bench.record.writer import RecordError

JOURNAL_NAME = "journal.jsonl"
_CRC_DIGITS = 8
_FIELDS = {"n": int, "p": str, "t": int, "c": dict}  # of every line, each with its type
_SETPOINT = {"s": dict}  # of the lines of steps that set something


@dataclass(frozen=True)
class JournalEntry:
    """A finished step: its number and phase, when it ended, the conditions it ran under, and what it set.

    ``setpoint``: {"role.action": arguments} as the instrument confirmed it, empty if the step set nothing.
    """

    number: int
    phase: str
    t_mono_ns: int
    conditions: Values
    setpoint: Values = field(default_factory=dict)


@dataclass(frozen=True)
class JournalState:
    """The proven part of a journal: its entries, its size in bytes, and whether something follows that."""

    entries: tuple[JournalEntry, ...]
    good_bytes: int
    torn: bool


class Journal:
    """Appends to ``<folder>/journal.jsonl``; an existing journal is cut back to its good part and continued.

    The file is locked as long as it is open, so that nobody goes on with a session that a living process still writes.
    Raises: RecordError B-REC-005 if a line cannot be written (the file is cut back then), B-REC-006 if another process
            has the journal open; InputError B-REC-007 if it was written by other software (nothing is cut then).
    """

    def __init__(self, folder: Path, files: Files | None = None) -> None:
        self.path = folder / JOURNAL_NAME
        self._lock = -1
        self._torn = False
        try:
            self._file = (files or OsFiles()).append(self.path)
        except OSError as error:
            raise self._failure(error) from error
        try:
            self._lock = _locked(self.path)
            before = read_journal(folder)
            self._lines = len(before.entries)
            self._size = before.good_bytes
            if before.torn:
                self._file.truncate(self._size)
        except BlockingIOError as error:
            self.close()
            raise RecordError(
                "B-REC-006",
                "another process is writing this session",
                where=str(self.path),
                next_step="wait for its end, or stop that run first",
            ) from error
        except OSError as error:
            self.close()
            raise self._failure(error) from error
        except InputError:
            self.close()
            raise

    def step(
        self,
        number: int,
        phase: str,
        t_mono_ns: int,
        conditions: Values,
        setpoint: Values | None = None,
    ) -> None:
        """Write one finished step and hand it to the operating system."""
        fields = {"c": conditions, "n": number, "p": phase, "t": t_mono_ns}
        text = canonical_json({**fields, "s": setpoint} if setpoint else fields)
        line = b"%08x %b\n" % (zlib.crc32(text, self._lines + 1), text)
        try:
            self._cut_back()
            if self._file.write(line) != len(line):
                raise OSError(28, "short write")
        except OSError as error:
            self._torn = True
            with suppress(OSError):  # where this fails too it is tried before the next line: none may follow a torn one
                self._cut_back()
            raise self._failure(error) from error
        self._lines += 1
        self._size += len(line)

    def _cut_back(self) -> None:
        if self._torn:
            self._file.truncate(self._size)
            self._torn = False

    def sync(self) -> None:
        """Wait until every line is on the disk. Raises: RecordError B-REC-005 if that is not sure."""
        try:
            self._file.sync()
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Close the journal and let others have it."""
        self._file.close()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def _failure(self, error: OSError) -> RecordError:
        return RecordError(
            "B-REC-005",
            f"the step journal cannot be written: {error.strerror or error}",
            where=str(self.path),
            next_step="free space or repair the disk, then start again",
        )


def _locked(path: Path) -> int:
    """Descriptor that holds the lock of a file until it is closed or its process ends, however that happens."""
    descriptor = os.open(path, os.O_RDONLY | ALONE)
    try:
        lock_file(descriptor)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def is_being_written(folder: Path) -> bool:
    """Return whether a living process has the journal of a session open."""
    path = folder / JOURNAL_NAME
    if not path.is_file():
        return False
    try:
        os.close(_locked(path))
    except BlockingIOError:
        return True
    return False


def read_journal(folder: Path) -> JournalState:
    """Read a journal up to its first line that is not whole; no journal is an empty one.

    Raises: InputError B-REC-007 at a line that is whole and whose form this software does not know.
    """
    path = folder / JOURNAL_NAME
    content = path.read_bytes() if path.is_file() else b""
    entries: list[JournalEntry] = []
    at = 0
    while (stop := content.find(b"\n", at)) >= 0:
        text = content[at + _CRC_DIGITS + 1 : stop]
        if content[at : at + _CRC_DIGITS + 1] != b"%08x " % zlib.crc32(text, len(entries) + 1):
            break
        entries.append(_entry(text, f"{path}:{len(entries) + 1}"))
        at = stop + 1
    return JournalState(tuple(entries), at, at < len(content))


def _entry(text: bytes, where: str) -> JournalEntry:
    """Return the entry of a line whose sum is right. Raises: InputError B-REC-007 for another form than today's."""
    try:
        fields = json.loads(text)
    except ValueError:
        fields = None
    kinds = {name: type(value) for name, value in fields.items()} if isinstance(fields, dict) else {}
    if kinds not in (_FIELDS, _FIELDS | _SETPOINT):
        raise InputError(
            "B-REC-007",
            f"the step journal was written by another version of the bench: its sum is right, and its fields "
            f"{', '.join(sorted(kinds)) or 'are none'} are not {', '.join(sorted(_FIELDS))}",
            where=where,
            next_step=NEXT_FORM,
        )
    return JournalEntry(fields["n"], fields["p"], fields["t"], fields["c"], fields.get("s", {}))
