"""A delimited log read once before anything is written: whether it can be imported, and what it holds."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.model.errors import InputError
from bench.plan import LogMapping
from bench.replay.delimited import LogCounts, LogParser, lines_of, listed

READ_BYTES = 1 << 20


@dataclass(frozen=True)
class Survey:
    """Times of the first and last row, UTC in ns since 1970; size and SHA-256 of the file as it was read."""

    first_ns: int
    last_ns: int
    counts: LogCounts
    size: int
    sha256: str


def survey(path: Path, mapping: LogMapping) -> Survey:
    """Read a log through a mapping.

    Raises: InputError B-IMP-001 (cannot be read, empty), B-IMP-005 (too many rows cannot be read), and those of
            bench.replay.delimited.LogParser.
    """
    parser, digest, size = LogParser(mapping, str(path)), hashlib.sha256(), 0
    first_ns = last_ns = None
    for line in file_lines(path):
        digest.update(line)
        size += len(line)
        row = parser.row(line)
        if row is not None:
            first_ns = row.t_ns if first_ns is None else first_ns
            last_ns = row.t_ns
    if size == 0:
        raise InputError("B-IMP-001", "is empty", where=str(path), next_step="name the file of the log")
    _few_bad_rows(parser.counts, mapping, str(path))
    parser.finish()
    assert first_ns is not None
    assert last_ns is not None
    return Survey(first_ns, last_ns, parser.counts, size, digest.hexdigest())


def file_lines(path: Path, size: int | None = None) -> Iterator[bytes]:
    """Yield lines of a file, or of its first ``size`` bytes: a log may grow while it is read. Raises B-IMP-001."""
    yield from lines_of(_chunks(path, size))


def _chunks(path: Path, size: int | None) -> Iterator[bytes]:
    try:
        with path.open("rb") as stream:
            left = size
            while chunk := stream.read(READ_BYTES if left is None else min(READ_BYTES, left)):
                yield chunk
                left = None if left is None else left - len(chunk)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            "B-IMP-001",
            f"cannot be read: {reason}",
            where=str(path),
            next_step="check the path and the permissions",
        ) from error


def _few_bad_rows(counts: LogCounts, mapping: LogMapping, name: str) -> None:
    lines = counts.rows + counts.bad_rows
    if counts.rows and counts.bad_rows > mapping.bad_rows * lines:
        raise InputError(
            "B-IMP-005",
            f"{counts.bad_rows} of {lines} rows cannot be read, {100 * mapping.bad_rows:g} % may be: "
            f"{listed(counts.bad)}",
            where=name,
            next_step="correct the mapping, or allow more there with 'bad_rows: 1 %'; they are left out and counted",
        )
