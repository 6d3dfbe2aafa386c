"""The columns of an imported log, read again from the bytes of its session; nothing but the session is used."""

from __future__ import annotations

import hashlib
import re
import zlib
from array import array
from codecs import getincrementaldecoder
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from gzip import GzipFile
from io import BufferedReader
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS
from bench.model.errors import InputError, SessionDamaged
from bench.model.yamlio import parse_yaml
from bench.plan import LogMapping, language_of_mapping
from bench.record import SessionReader
from bench.replay.delimited import LogCounts, LogParser, lines_of, listed
from bench.replay.wording import say

READ_BYTES = 1 << 20
_WIDE = {
    "utf-16-le": re.compile(rb"\xff\xfe|([^\0]\0){8}"),
    "utf-16-be": re.compile(rb"\xfe\xff|(\0[^\0]){8}"),
}
IMPORT = "import"  # ``kind`` in the manifest of an imported session
LINK = "log"
MAPPING = "mapping.yaml"
_TOPIC = f"/link/{LINK}/rx"


@dataclass(frozen=True)
class Survey:
    """Times of the first and last row, UTC in ns since 1970; size and SHA-256 of the file as it was read."""

    first_ns: int
    last_ns: int
    counts: LogCounts
    size: int
    sha256: str


def survey(lines: Iterable[bytes], mapping: LogMapping, name: str) -> Survey:
    """Read the lines of a log through a mapping; ``name`` is the file in messages.

    Raises: InputError B-IMP-001 (empty), B-IMP-005 (too many rows cannot be read), and those of
            bench.replay.delimited.LogParser.
    """
    parser, digest, size = LogParser(mapping, name), hashlib.sha256(), 0
    first_ns = last_ns = None
    for line in lines:
        digest.update(line)
        size += len(line)
        row = parser.row(line)
        if row is not None:
            first_ns = row.t_ns if first_ns is None else first_ns
            last_ns = row.t_ns
    if size == 0:
        raise InputError("B-IMP-001", "is empty", where=name, next_step="name the file of the log")
    _few_bad_rows(parser.counts, mapping, name)
    parser.finish()
    assert first_ns is not None
    assert last_ns is not None
    return Survey(first_ns, last_ns, parser.counts, size, digest.hexdigest())


def file_lines(path: Path, size: int | None = None) -> Iterator[bytes]:
    """Yield lines of a text, or of its first ``size`` bytes: a log may grow while it is read. Raises B-IMP-001."""
    yield from lines_of(_chunks(path, size))


def text_forms(path: Path) -> list[str]:
    """Return by its first bytes what a text is freed of: gzip, utf-16-le or -be, CR; none if it is read as it is."""
    with path.open("rb") as file:
        return _plain(file)[0]


def _plain(file: BufferedReader) -> tuple[list[str], Iterator[bytes]]:
    """Return what a text is freed of, and its bytes; of a packed one that is cut, as many as there are."""
    packed = file.peek(2).startswith(b"\x1f\x8b")
    stream = GzipFile(fileobj=file) if packed else file
    first = stream.read1(READ_BYTES)
    wide = next((form for form, begin in _WIDE.items() if begin.match(first)), None)
    decoder = getincrementaldecoder(wide or "latin-1")()
    returns = b"\r" in first and b"\n" not in first

    def chunks() -> Iterator[bytes]:
        part = first
        with suppress(EOFError, zlib.error):
            while part:
                text = decoder.decode(part).encode() if wide else part
                yield text.replace(b"\r", b"\n") if returns else text
                part = stream.read1(READ_BYTES)

    return [*(["gzip"] if packed else []), *([wide] if wide else []), *(["CR"] if returns else [])], chunks()


def _chunks(path: Path, size: int | None) -> Iterator[bytes]:
    left = size
    try:
        with path.open("rb") as stream:
            for chunk in _plain(stream)[1]:
                yield chunk[:left]
                if left is not None and (left := left - len(chunk)) <= 0:
                    return
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
        step = "correct the mapping, or allow more there with 'bad_rows: 1 %'; they are left out and counted"
        if mapping.counts_rows:
            step = "correct those lines, or cut the file in front of them: the mapping counts rows, so none is left out"
        raise InputError(
            "B-IMP-005",
            f"{counts.bad_rows} of {lines} rows cannot be read, {100 * mapping.bad_rows:g} % may be: "
            f"{listed(counts.bad)}",
            where=name,
            next_step=step,
        )


@dataclass(frozen=True)
class ImportedSeries:
    """Columns by quantity, (n,) each, base units, NaN where the instrument overloaded; "t_s" from the first row on.

    ``sha256``: of the bytes of the file; ``notes``: sentences on what is left out or changed.
    """

    columns: Mapping[str, NDArray[np.float64]]
    counts: LogCounts
    sha256: str
    notes: tuple[str, ...]


def replay_series(folder: Path) -> ImportedSeries:
    """Read the log of an imported session again.

    Raises: SessionDamaged B-IMP-007 if the session holds no mapping, B-REC-012 (no manifest); InputError B-IMP-002 to
            B-IMP-006 if the log cannot be read through its mapping.
    """
    reader = SessionReader(folder)
    manifest, texts = reader.manifest, reader.texts
    if MAPPING not in texts:
        raise SessionDamaged(
            "B-IMP-007",
            f"the text of {MAPPING!r} is not in the session, so its log cannot be read",
            where=str(folder),
            next_step="import the file again, or see 'bench recover' for what the session still holds",
        )
    mapping = parse_yaml(texts[MAPPING], MAPPING, language_of_mapping).model
    names = [column.quantity for column in mapping.values.values()]
    parser, digest = LogParser(mapping, str(manifest.get("log", {}).get("file", folder))), hashlib.sha256()
    held = [array("d") for _ in ("t_s", *names)]
    first_ns = None
    for line in lines_of(_payloads(reader)):
        digest.update(line)
        row = parser.row(line)
        if row is not None:
            first_ns = row.t_ns if first_ns is None else first_ns
            for store, value in zip(held, ((row.t_ns - first_ns) / NS, *row.values), strict=True):
                store.append(value)
    parser.finish()
    columns = {name: np.array(store) for name, store in zip(("t_s", *names), held, strict=True)}
    return ImportedSeries(columns, parser.counts, digest.hexdigest(), _notes(manifest, parser, digest.hexdigest()))


def _payloads(reader: SessionReader) -> Iterator[bytes]:
    for message in reader.messages(frozenset({_TOPIC})):
        yield message.payload


def _notes(manifest: Mapping[str, object], parser: LogParser, sha256: str) -> tuple[str, ...]:
    said = parser.counts.sentences()
    log = manifest.get("log")
    log = log if isinstance(log, Mapping) else {}
    if broken := log.get("origin", {}).get("broken"):
        said.append(say("log.broken", parts=broken))
    recorded = log.get("sha256")
    if recorded is not None and recorded != sha256:
        said.append(say("log.changed", then=recorded[:12], now=sha256[:12]))
    return tuple(said)
