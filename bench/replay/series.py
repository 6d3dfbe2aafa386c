"""The columns of an imported log, read again from the bytes of its session; nothing but the session is used."""

from __future__ import annotations

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

from bench.model.errors import InputError, SessionDamaged
from bench.model.yamlio import parse_yaml
from bench.plan import LogMapping, language_of_mapping
from bench.record import SessionReader
from bench.replay.delimited import LogCounts, LogParser, lines_of
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


def survey(lines: Iterable[bytes], mapping: LogMapping, name: str) -> tuple[LogParser, array[int]]:
    """Read the lines of a log through a mapping; ``name`` is the file in messages.

    Returns: what was read, and of each line the time of the newest row, ns from the first one on.
    Raises: InputError B-IMP-001 to B-IMP-006, as bench.replay.delimited.LogParser.
    """
    parser, lines_ns = LogParser(mapping, name), array("q")
    for times_ns, _ in parser.read(lines):
        lines_ns.frombytes(times_ns.tobytes())
    parser.finish()
    return parser, lines_ns


def file_lines(path: Path, size: int | None = None) -> Iterator[bytes]:
    """Yield lines of a text, or of its first ``size`` bytes: a log may grow while it is read. Raises B-IMP-001."""
    yield from lines_of(first_bytes(_chunks(path), size))


def first_bytes(chunks: Iterable[bytes], size: int | None) -> Iterator[bytes]:
    """Yield chunks of bytes up to so many in all; None: all."""
    for chunk in chunks:
        yield chunk[:size]
        if size is not None and (size := size - len(chunk)) <= 0:
            return


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


def _chunks(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as stream:
            yield from _plain(stream)[1]
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            "B-IMP-001",
            f"cannot be read: {reason}",
            where=str(path),
            next_step="check the path and the permissions",
        ) from error


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
    log = manifest.get("log", {})
    parser = LogParser(mapping, str(log.get("file", folder)))
    held = array("d")
    for _, rows in parser.read(lines_of(message.payload for message in reader.messages(frozenset({_TOPIC})))):
        held.frombytes(rows.tobytes())
    parser.finish()
    held_columns = np.frombuffer(held).reshape(-1, 1 + len(names)).T
    columns = {name: column.copy() for name, column in zip(("t_s", *names), held_columns, strict=True)}
    said, sha256, recorded = parser.counts.sentences(), parser.digest.hexdigest(), log.get("sha256")
    if broken := log.get("origin", {}).get("broken"):
        said.append(say("log.broken", parts=broken))
    if recorded not in (None, sha256):
        said.append(say("log.changed", then=recorded[:12], now=sha256[:12]))
    return ImportedSeries(columns, parser.counts, sha256, tuple(said))
