"""Flushed journal of finished steps: one line each, so that a stopped run knows where it was.

A line is the CRC-32 of its JSON text, started from the number of the line (from 1), in eight hex digits, a blank and
the text. Zeros, a torn line or a line out of place are never taken for a step.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.record.files import Files, OsFiles
from bench.record.layout import canonical_json
from bench.record.writer import RecordError

JOURNAL_NAME = "journal.jsonl"
_CRC_DIGITS = 8


@dataclass(frozen=True)
class JournalEntry:
    """A finished step: its number and phase, when it ended, and the conditions it ran under."""

    number: int
    phase: str
    t_mono_ns: int
    conditions: Mapping[str, Any]


@dataclass(frozen=True)
class JournalState:
    """What a journal proves: its entries, the size of its good part in bytes, and whether something follows that."""

    entries: tuple[JournalEntry, ...]
    good_bytes: int
    torn: bool


class Journal:
    """Appends to ``<folder>/journal.jsonl``; an existing journal is cut back to its good part and continued.

    Raises: RecordError B-REC-005 if a line cannot be written; the file is cut back then.
    """

    def __init__(self, folder: Path, files: Files | None = None) -> None:
        self.path = folder / JOURNAL_NAME
        before = read_journal(folder)
        self._lines = len(before.entries)
        self._size = before.good_bytes
        try:
            self._file = (files or OsFiles()).append(self.path)
            if before.torn:
                self._file.truncate(self._size)
        except OSError as error:
            raise self._failure(error) from error

    def step(self, number: int, phase: str, t_mono_ns: int, conditions: Mapping[str, Any]) -> None:
        """Write one finished step and hand it to the operating system."""
        text = canonical_json({"c": conditions, "n": number, "p": phase, "t": t_mono_ns})
        line = b"%08x %b\n" % (zlib.crc32(text, self._lines + 1), text)
        try:
            if self._file.write(line) != len(line):
                raise OSError(28, "short write")
        except OSError as error:
            self._file.truncate(self._size)
            raise self._failure(error) from error
        self._lines += 1
        self._size += len(line)

    def sync(self) -> None:
        """Wait until every line is on the disk."""
        self._file.sync()

    def close(self) -> None:
        """Close the journal."""
        self._file.close()

    def _failure(self, error: OSError) -> RecordError:
        return RecordError(
            "B-REC-005",
            f"the step journal cannot be written: {error.strerror or error}",
            where=str(self.path),
            next_step="free space or repair the disk, then start again",
        )


def read_journal(folder: Path) -> JournalState:
    """Read a journal up to its first line that is not whole; no journal is an empty one."""
    path = folder / JOURNAL_NAME
    content = path.read_bytes() if path.is_file() else b""
    entries: list[JournalEntry] = []
    at = 0
    while (stop := content.find(b"\n", at)) >= 0:
        entry = _parse(content[at:stop], len(entries) + 1)
        if entry is None:
            break
        entries.append(entry)
        at = stop + 1
    return JournalState(tuple(entries), at, at < len(content))


def _parse(line: bytes, number: int) -> JournalEntry | None:
    text = line[_CRC_DIGITS + 1 :]
    if line[: _CRC_DIGITS + 1] != b"%08x " % zlib.crc32(text, number):
        return None
    try:
        fields = json.loads(text)
        return JournalEntry(fields["n"], fields["p"], fields["t"], fields["c"])
    except (ValueError, KeyError, TypeError):
        return None
