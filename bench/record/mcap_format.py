"""The MCAP container as far as sessions use it: its records, and the summary section of a finished segment.

Source: MCAP specification, version 0.

Bytes of a segment: a small one is read, a large one is a view of its file, so that memory stays bounded.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import lz4.frame
import numpy as np
from numpy.typing import NDArray

from bench.model.arrays import Integers

Content = bytes | mmap.mmap
WHOLE_BYTES = 64_000_000  # more than an hour of two links: a segment as it is written is read as a whole
_PIECE_BYTES = 16_000_000


def segment_bytes(path: Path) -> Content:
    """Return the bytes of a segment. Raises: OSError."""
    with path.open("rb") as stream:
        if stream.seek(0, 2) <= WHOLE_BYTES:
            stream.seek(0)
            return stream.read()
        return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)


def let_go(content: Content) -> None:
    """Give back the memory of what was read of a large segment; it is read again if it is needed again."""
    if isinstance(content, mmap.mmap) and hasattr(content, "madvise"):
        content.madvise(mmap.MADV_DONTNEED)


def pieces(content: Content, stop: int) -> Iterator[memoryview]:
    """Yield the first ``stop`` bytes, a piece at a time."""
    view = memoryview(content)
    for begin in range(0, stop, _PIECE_BYTES):
        yield view[begin : min(begin + _PIECE_BYTES, stop)]
        let_go(content)


MAGIC = b"\x89MCAP0\r\n"
HEADER = 0x01
FOOTER = 0x02
CHANNEL = 0x04
MESSAGE = 0x05
CHUNK = 0x06
MESSAGE_INDEX = 0x07
CHUNK_INDEX = 0x08
STATISTICS = 0x0B
SUMMARY_OFFSET = 0x0E
DATA_END = 0x0F
KNOWN = frozenset(range(0x01, 0x10))
RECORD = struct.Struct("<BQ")  # opcode, length of the content
# a message and its envelope: opcode, length, channel, sequence, log time, publish time; CRC, running number, time
ENVELOPED = struct.Struct("<BQHIQQIQQ")
CHUNK_HEAD = struct.Struct("<BQQQQII")  # opcode, length, start, end, uncompressed size, CRC, compression text length
_LZ4 = b"lz4"
_LZ4_HEAD = struct.Struct(f"{CHUNK_HEAD.format}{len(_LZ4)}sQ")  # the compression text, bytes of the compressed records
CHUNK_FIXED = 40  # content of a chunk without the compression text and the records: 8 + 8 + 8 + 4 + 4 + 8
FOOTER_RECORD = struct.Struct("<BQQQI")
_CHUNK_INDEX_HEAD = struct.Struct("<QQQQI")  # start, end, offset, length, bytes of the per-channel map
_CHUNK_INDEX_FIXED = _CHUNK_INDEX_HEAD.size + 8 + 4 + len(_LZ4) + 8 + 8  # content without the per-channel map
_CHUNK_INDEX = np.dtype(
    [("start_ns", "<u8"), ("end_ns", "<u8"), ("offset", "<u8"), ("length", "<u8"), ("map_bytes", "<u4")]
)
_CHANNEL_ENTRY = np.dtype([("channel", "<u2"), ("offset", "<u8")])


def record(opcode: int, content: bytes) -> bytes:
    """Return a complete record."""
    return RECORD.pack(opcode, len(content)) + content


def text(value: str) -> bytes:
    """Return a length-prefixed UTF-8 string."""
    raw = value.encode()
    return len(raw).to_bytes(4, "little") + raw


def text_map(values: Mapping[str, str]) -> bytes:
    """Return a length-prefixed map of strings, sorted by key."""
    raw = b"".join(text(key) + text(values[key]) for key in sorted(values))
    return len(raw).to_bytes(4, "little") + raw


def header(profile: str, library: str) -> bytes:
    """Header record."""
    return record(HEADER, text(profile) + text(library))


def channel(number: int, topic: str, encoding: str, metadata: Mapping[str, str]) -> bytes:
    """Return channel record without a schema."""
    content = struct.pack("<HH", number, 0) + text(topic) + text(encoding) + text_map(metadata)
    return record(CHANNEL, content)


def chunk_head(start_ns: int, end_ns: int, size: int, crc: int, packed_size: int) -> bytes:
    """Return what stands before the compressed records of a chunk."""
    length = CHUNK_FIXED + len(_LZ4) + packed_size
    return _LZ4_HEAD.pack(CHUNK, length, start_ns, end_ns, size, crc, len(_LZ4), _LZ4, packed_size)


def message_index(number: int, entries: list[int]) -> bytes:
    """Return message index of one channel in one chunk; ``entries`` is log time, offset, log time, offset ..."""
    count = len(entries)
    return _index_of(count).pack(MESSAGE_INDEX, 6 + 8 * count, number, 8 * count, *entries)


@lru_cache(maxsize=64)
def _index_of(count: int) -> struct.Struct:
    return struct.Struct(f"<BQHI{count}Q")


def chunk_index(
    span: tuple[int, int], place: tuple[int, int], indexes: Sequence[int], index_bytes: int, sizes: tuple[int, int]
) -> bytes:
    """Return chunk index: ``span`` start and end time, ``place`` offset and length, ``sizes`` compressed, uncompressed.

    ``indexes`` is channel, offset of its message index, channel, offset ...
    """
    count = len(indexes) // 2
    map_bytes = _CHANNEL_ENTRY.itemsize * count
    head = (CHUNK_INDEX, _CHUNK_INDEX_FIXED + map_bytes, *span, *place, map_bytes)
    return _listed_of(count).pack(*head, *indexes, index_bytes, len(_LZ4), _LZ4, *sizes)


@lru_cache(maxsize=64)
def _listed_of(count: int) -> struct.Struct:
    return struct.Struct(f"<BQQQQQI{'HQ' * count}QI{len(_LZ4)}sQQ")


def chunk_of(
    records: bytes, span: tuple[int, int], entries: Mapping[int, list[int]], place: int
) -> tuple[list[bytes], int, bytes]:
    """Return messages as the chunk at ``place`` of a file.

    That is: its parts with the message indexes behind it, their bytes, and its entry in the summary.
    ``entries``: log time, offset, log time, offset ... by channel.   ``span``: times of the first and last message.
    """
    packed = lz4.frame.compress(records)
    head = chunk_head(*span, len(records), zlib.crc32(records), len(packed))
    parts = [head, packed]
    length = at = len(head) + len(packed)
    places: list[int] = []
    for number, listed in entries.items():
        index = message_index(number, listed)
        parts.append(index)
        places += (number, place + at)
        at += len(index)
    sizes = len(packed), len(records)
    return parts, at, chunk_index(span, (place, length), places, at - length, sizes)


def statistics(channels: int, chunks: int, span: tuple[int, int], counts: Mapping[int, int]) -> bytes:
    """Statistics record; ``counts`` is messages by channel."""
    per_channel = b"".join(struct.pack("<HQ", number, counts[number]) for number in sorted(counts))
    head = struct.pack("<QHIIIIQQI", sum(counts.values()), 0, channels, 0, 0, chunks, *span, len(per_channel))
    return record(STATISTICS, head + per_channel)


def ending(crc: int, place: int, groups: Sequence[tuple[int, bytes]]) -> bytes:
    """Return data end, summary and footer behind the ``place`` bytes of data, whose CRC is ``crc``.

    ``groups``: records of the summary, by opcode.
    """
    data_end = record(DATA_END, crc.to_bytes(4, "little"))
    start = at = place + len(data_end)
    offsets = b""
    for opcode, content in groups:
        offsets += record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, at, len(content)))
        at += len(content)
    summary = b"".join([*(content for _, content in groups), offsets])
    footer = FOOTER_RECORD.pack(FOOTER, 20, start, at, 0)[:-4]
    checked = zlib.crc32(footer, zlib.crc32(summary)).to_bytes(4, "little")
    return b"".join((data_end, summary, footer, checked, MAGIC))


@dataclass(frozen=True)
class Summary:
    """Summary of a finished segment: ``channels`` number -> topic; its records lie in [start, stop) of the content."""

    channels: dict[int, str]
    start: int
    stop: int


def channel_of(content: bytes) -> tuple[int, str]:
    """Return number and topic of a channel record's content. Raises ValueError if it is damaged."""
    if len(content) < 8:
        raise ValueError("channel record is too short")
    number, _, size = struct.unpack_from("<HHI", content)
    if 8 + size > len(content):
        raise ValueError("topic is longer than its record")
    return number, content[8 : 8 + size].decode()


def read_summary(content: Content, at_byte: int = 0) -> Summary | None:
    """Read the summary of a segment; None if the segment is not finished or its summary is damaged.

    ``content`` is the segment, or its end from ``at_byte`` on, as long as all of the summary is in it.
    """
    size = FOOTER_RECORD.size
    at = len(content) - len(MAGIC) - size
    if at < len(MAGIC) or content[-len(MAGIC) :] != MAGIC:
        return None
    opcode, length, start, _, crc = FOOTER_RECORD.unpack_from(content, at)
    begin = start - at_byte if start else at
    if opcode != FOOTER or length != size - RECORD.size or not 0 <= begin <= at:
        return None
    if start and crc and zlib.crc32(memoryview(content)[begin : at + size - 4]) != crc:
        return None
    try:
        channels = dict(channel_of(content[first:end]) for first, end in _records(content, begin, at, CHANNEL))
    except (ValueError, struct.error):
        return None
    return Summary(channels, begin, at)


def chunks_with(content: bytes, summary: Summary, numbers: frozenset[int]) -> list[tuple[int, int]] | None:
    """Return offset and length of the chunks that hold messages of any of these channels; None if nobody says."""
    begins = [begin for begin, _ in _records(content, summary.start, summary.stop, CHUNK_INDEX)]
    if not begins:
        return None
    at = np.array(begins)
    heads = _at(content, at, _CHUNK_INDEX)
    entries = heads["map_bytes"].astype(np.int64) // _CHANNEL_ENTRY.itemsize
    if not entries.all():
        return None
    at += _CHUNK_INDEX.itemsize
    holds = np.zeros(len(at), np.bool_)
    for index in range(int(entries.max())):
        more = np.flatnonzero(entries > index)
        channels = _at(content, at[more] + index * _CHANNEL_ENTRY.itemsize, _CHANNEL_ENTRY)["channel"]
        holds[more] |= np.isin(channels, list(numbers))
    return list(zip(heads["offset"][holds].tolist(), heads["length"][holds].tolist(), strict=True))


def _at(content: bytes, begins: Integers, kind: np.dtype[np.void]) -> NDArray[np.void]:
    """Return what stands at some places. Raises: ValueError if a place lies outside."""
    room = len(content) - kind.itemsize + 1
    if room <= 0 or int(begins.max(initial=0)) >= room:
        raise ValueError("record is longer than the summary")
    return np.ndarray((room,), kind, content, 0, (1,))[begins]


def chunk_spans(content: bytes, summary: Summary) -> list[tuple[int, int, int, int]]:
    """Start and end time in ns, offset in the file and length of every chunk that the summary lists."""
    return [
        _CHUNK_INDEX_HEAD.unpack_from(content, begin)[:4]
        for begin, _ in _records(content, summary.start, summary.stop, CHUNK_INDEX)
    ]


def _records(content: Content, at: int, stop: int, wanted: int) -> list[tuple[int, int]]:
    """Return where the contents of the records of one kind begin and end. Raises: ValueError, struct.error."""
    unpack, found = RECORD.unpack_from, []
    while at < stop:
        opcode, length = unpack(content, at)
        begin = at + RECORD.size
        at = begin + length
        if opcode == wanted:
            found.append((begin, at))
    if at > stop:
        raise ValueError("record is longer than the summary")
    return found
