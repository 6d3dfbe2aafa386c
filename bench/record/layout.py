"""Layout of a session and the files it is written to: topics, envelopes, canonical JSON (docs/session-format.md).

An envelope is 20 bytes, little endian: u32 CRC, u64 running number of the session, u64 monotonic time in ns. The CRC
is CRC-32/ISO-HDLC over the remaining 16 bytes and the payload, started from the CRC of the topic: zeros are never a
message, and a message cannot change its topic.

Files are reached in one way only: tests put another in its place to inject short writes and errors. After a failed
write a file is cut back to its last whole chunk.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from bench.model.errors import SessionDamaged
from bench.model.posix import ALONE, sync_folder
from bench.record import mcap_format

PROFILE = "inertial-bench/1"
LIBRARY = "inertial-bench recorder 1"
ENCODING = "inertial-bench/1"

MANIFEST = "/manifest"
TEXT = "/text/"
LINK = "/link/"
INSTRUMENT = "/instrument/"
EVENT = "/event"
CLOCK = "/clock"
CHAIN = "/chain"
CHAIN_START = bytes(32)

_PREFIXES = (LINK, INSTRUMENT, TEXT)
_EXACT = frozenset({MANIFEST, EVENT, CLOCK, CHAIN})
_STAMP = struct.Struct("<QQ")


class Message(NamedTuple):
    """One message of a session; ``t_ns`` is monotonic time, ``sequence`` runs through the whole session."""

    topic: str
    sequence: int
    t_ns: int
    payload: bytes

    def document(self) -> Any:
        """Return the payload as JSON. Raises: SessionDamaged B-REC-014 if it is none."""
        try:
            return json.loads(self.payload)
        except ValueError as error:
            raise self._not_as_documented(str(error)) from error

    def text(self) -> str:
        """Return the payload as text. Raises: SessionDamaged B-REC-014 if it is not UTF-8."""
        try:
            return self.payload.decode()
        except ValueError as error:
            raise self._not_as_documented(str(error)) from error

    def event(self) -> tuple[str, dict[str, Any]]:
        """Kind and fields of an event. Raises: SessionDamaged B-REC-014 if it is none."""
        document = self.document()
        if not isinstance(document, dict) or not isinstance(document.get("fields"), dict) or "kind" not in document:
            raise self._not_as_documented("an event has a kind and fields")
        return str(document["kind"]), document["fields"]

    def _not_as_documented(self, why: str) -> SessionDamaged:
        return SessionDamaged(
            "B-REC-014",
            f"the content is not what its topic promises: {why}",
            where=f"message {self.sequence} of {self.topic}",
            next_step="docs/session-format.md says what each topic holds",
        )


def segment_name(number: int) -> str:
    """File name of a segment, counted from 1."""
    return f"session.{number:04d}.mcap"


def is_bench_topic(topic: str) -> bool:
    """Return True if the topic belongs to the layout; other topics of a file are ignored."""
    return topic in _EXACT or topic.startswith(_PREFIXES)


def matches(topic: str, selection: frozenset[str]) -> bool:
    """Return True if ``topic`` is selected; a selected name that ends in "/" stands for all topics below it."""
    return topic in selection or any(topic.startswith(name) for name in selection if name.endswith("/"))


def payload_kind(topic: str) -> str:
    """Return what a payload is: ``raw`` bytes, ``text`` (UTF-8) or ``json`` (canonical JSON)."""
    if topic.startswith(LINK):
        return "raw"
    return "text" if topic.startswith(TEXT) else "json"


def topic_seed(topic: str) -> int:
    """Start value of the envelope's CRC for one topic."""
    return zlib.crc32(topic.encode())


def envelope_crc(seed: int, sequence: int, t_ns: int, payload: bytes) -> int:
    """CRC of an envelope: the running number, the time and the payload, started from the topic's CRC."""
    return zlib.crc32(payload, zlib.crc32(_STAMP.pack(sequence, t_ns), seed))


def _plain(value: object) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    item = getattr(value, "tolist", None)
    if item is not None:
        return item()
    return str(value)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return _finite(_plain(value)) if hasattr(value, "tolist") else value


_ENCODER = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, check_circular=False, default=_plain
)


def _encoding() -> Callable[[Any], str]:
    """Return what encodes JSON; made once, where ``JSONEncoder`` makes the same anew for each text."""
    make = getattr(json.encoder, "c_make_encoder", None)
    if make is None:  # a Python without it
        return _ENCODER.encode
    parts_of = make(None, _plain, json.encoder.encode_basestring, None, ":", ",", True, False, False)  # as _ENCODER
    return lambda value: "".join(parts_of(value, 0))


_encode = _encoding()


def canonical_json(value: Any) -> bytes:
    """Return JSON with sorted keys, no blanks, UTF-8; numbers that are not finite become null."""
    try:
        return _encode(value).encode()
    except (ValueError, TypeError):
        return _ENCODER.encode(_finite(value)).encode()


class AppendFile(Protocol):
    """A file that is written at its end."""

    def write(self, chunk: bytes) -> int:
        """Append; returns the number of bytes written, which may be less than asked. Raises OSError."""

    def truncate(self, size: int) -> None:
        """Cut the file back to ``size`` bytes and go on from there."""

    def sync(self) -> None:
        """Return when everything written is on the disk. Raises OSError."""

    def close(self) -> None:
        """Close the file."""


class Files(Protocol):
    """Where segments and journals are created."""

    def create(self, path: Path) -> AppendFile:
        """Return a new, empty file; an existing one is an error. Raises OSError."""

    def append(self, path: Path) -> AppendFile:
        """Return an existing or new file, positioned at its end. Raises OSError."""

    def remove(self, path: Path) -> None:
        """Remove a file if it is there."""

    def sync_folder(self, folder: Path) -> None:
        """Make the names in a folder durable."""


class _OsFile:
    def __init__(self, path: Path, flags: int) -> None:
        self._descriptor = os.open(path, flags | os.O_WRONLY | os.O_CREAT | ALONE, 0o644)

    def write(self, chunk: bytes) -> int:
        return os.write(self._descriptor, chunk)

    def truncate(self, size: int) -> None:
        os.ftruncate(self._descriptor, size)
        os.lseek(self._descriptor, size, os.SEEK_SET)

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


class OsFiles:
    """The real disk."""

    def create(self, path: Path) -> AppendFile:
        return _OsFile(path, os.O_EXCL)

    def append(self, path: Path) -> AppendFile:
        return _OsFile(path, os.O_APPEND)

    def remove(self, path: Path) -> None:
        path.unlink(missing_ok=True)

    def sync_folder(self, folder: Path) -> None:
        sync_folder(folder)


def write_all(file: AppendFile, block: bytes) -> None:
    """Write every byte of a block. Raises: OSError."""
    done = 0
    while done < len(block):
        count = file.write(block[done:] if done else block)
        if count <= 0:
            raise OSError(28, "nothing could be written")
        done += count


_HEAD_BYTES = mcap_format.ENVELOPED.size - mcap_format.RECORD.size


@dataclass(frozen=True)
class Channel:
    """A topic with its number and its record; numbers are the same in every segment of a session."""

    number: int
    topic: str
    seed: int
    record: bytes

    @classmethod
    def make(cls, number: int, topic: str) -> Channel:
        """Return channel ``number`` for ``topic``; the record says what its payload is."""
        record = mcap_format.channel(number, topic, ENCODING, {"payload": payload_kind(topic)})
        return cls(number, topic, topic_seed(topic), record)


@dataclass(slots=True)
class ChunkBuffer:
    """Messages of the chunk that is being filled: complete records, and where each channel's messages begin."""

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    start_ns: int = 0
    end_ns: int = 0
    entries: dict[int, list[int]] = field(default_factory=dict)  # channel -> log time, offset, log time, offset ...

    def add(self, channel: Channel, sequence: int, t_ns: int, payload: bytes) -> None:
        """Append one message: record head and envelope, then the payload."""
        at = self.size
        if not at:
            self.start_ns = self.end_ns = t_ns
        elif t_ns > self.end_ns:
            self.end_ns = t_ns
        elif t_ns < self.start_ns:
            self.start_ns = t_ns
        number = channel.number
        entry = self.entries.get(number)
        if entry is None:
            self.entries[number] = [t_ns, at]
        else:
            entry += (t_ns, at)
        crc = envelope_crc(channel.seed, sequence, t_ns, payload)
        size = len(payload)
        head = mcap_format.ENVELOPED.pack(
            mcap_format.MESSAGE, _HEAD_BYTES + size, number, sequence & 0xFFFFFFFF, t_ns, t_ns, crc, sequence, t_ns
        )
        self.parts += (head, payload)
        self.size = at + mcap_format.ENVELOPED.size + size

    def append(self, later: ChunkBuffer) -> None:
        """Append all messages of the chunk that comes next."""
        begin = self.size
        self.start_ns = min(self.start_ns, later.start_ns)
        self.end_ns = max(self.end_ns, later.end_ns)
        for number, entries in later.entries.items():
            self.entries.setdefault(number, []).extend(_moved(entries, begin))
        self.parts += later.parts
        self.size += later.size


def _moved(entries: list[int], by: int) -> list[int]:
    return [value + by if place % 2 else value for place, value in enumerate(entries)]


class SegmentWriter:
    """Writes one segment. ``chain`` is the chain value of the segment before (32 zero bytes for the first)."""

    def __init__(self, file: AppendFile, number: int, chain: bytes) -> None:
        self.file = file
        self.number = number
        self.offset = 0
        self._previous = chain
        self._hash = hashlib.sha256(chain)
        self._data_crc = 0
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self._chunk_indexes = bytearray()  # one object: a second of an hour each would tear the heap
        self._chunks = 0
        self._start_ns = -1
        self._end_ns = 0
        self._write(mcap_format.MAGIC + mcap_format.header(PROFILE, LIBRARY))

    def write_chunks(self, buffers: Sequence[ChunkBuffer], channels: Sequence[Channel]) -> None:
        """Write each buffer as a chunk, all in one call; nothing is changed if it fails. Raises OSError.

        ``channels`` are the session's, by number - 1; those new to this segment get their record in front.
        """
        parts: list[bytes] = []
        indexes: list[bytes] = []
        known = self._channels
        at = self.offset
        for buffer in buffers:
            prefix = b""
            if not buffer.entries.keys() <= known.keys():
                fresh = {number: channels[number - 1] for number in buffer.entries if number not in known}
                prefix = b"".join([channel.record for channel in fresh.values()])
                known = known | fresh
            entries = buffer.entries
            if prefix:
                entries = {number: _moved(entry, len(prefix)) for number, entry in entries.items()}
            records = b"".join((prefix, *buffer.parts))
            chunk, size, listed = mcap_format.chunk_of(records, (buffer.start_ns, buffer.end_ns), entries, at)
            parts += chunk
            indexes.append(listed)
            at += size
        self._write(b"".join(parts))
        self._chunk_indexes += b"".join(indexes)
        self._chunks += len(indexes)
        self._channels = known
        for buffer in buffers:
            self._count(buffer)

    def _count(self, buffer: ChunkBuffer) -> None:
        for number, entries in buffer.entries.items():
            self._counts[number] = self._counts.get(number, 0) + len(entries) // 2
        if self._start_ns < 0 or buffer.start_ns < self._start_ns:
            self._start_ns = buffer.start_ns
        self._end_ns = max(self._end_ns, buffer.end_ns)

    def chain(self) -> bytes:
        """SHA-256 over the chain value before and every byte of this segment so far."""
        return self._hash.digest()

    def chain_fields(self) -> dict[str, object]:
        """Content of the hash-chain message: it stands alone in the last chunk and covers all bytes before."""
        return {
            "segment": self.number,
            "bytes": self.offset,
            "previous": self._previous.hex(),
            "sha256": self.chain().hex(),
        }

    def finish(self) -> None:
        """Write data end, summary and footer. Raises OSError; the file is then cut back and stays readable.

        The index is forgotten: a finished segment may wait long for its sync.
        """
        indexes, self._chunk_indexes = self._chunk_indexes, bytearray()
        groups = [
            (mcap_format.CHANNEL, b"".join(self._channels[number].record for number in sorted(self._channels))),
            (
                mcap_format.STATISTICS,
                mcap_format.statistics(
                    len(self._channels), self._chunks, (max(self._start_ns, 0), self._end_ns), self._counts
                ),
            ),
            (mcap_format.CHUNK_INDEX, bytes(indexes)),
        ]
        self._write(mcap_format.ending(self._data_crc, self.offset, groups))

    def _write(self, block: bytes) -> None:
        try:
            write_all(self.file, block)
        except OSError:
            self._cut_back()
            raise
        self._hash.update(block)
        self._data_crc = zlib.crc32(block, self._data_crc)
        self.offset += len(block)

    def _cut_back(self) -> None:
        try:
            self.file.truncate(self.offset)
        except OSError:
            return  # the torn tail stays; the reader ends at the last whole chunk
