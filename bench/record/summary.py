"""Summary section of a finished segment: its channels, and which chunk holds messages of which channel."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

from bench.record import mcap_format as mcap

_CHUNK_INDEX_HEAD = struct.Struct("<QQQQI")  # start, end, offset, length, bytes of the per-channel map
_CHANNEL_ENTRY = 10  # channel u16, offset u64


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


def read_summary(content: bytes, at_byte: int = 0) -> Summary | None:
    """Read the summary of a segment; None if the segment is not finished or its summary is damaged.

    ``content`` is the segment, or its end from ``at_byte`` on, as long as all of the summary is in it.
    """
    size = mcap.FOOTER_RECORD.size
    at = len(content) - len(mcap.MAGIC) - size
    if at < len(mcap.MAGIC) or not content.endswith(mcap.MAGIC):
        return None
    opcode, length, start, _, crc = mcap.FOOTER_RECORD.unpack_from(content, at)
    begin = start - at_byte if start else at
    if opcode != mcap.FOOTER or length != size - mcap.RECORD.size or not 0 <= begin <= at:
        return None
    if start and crc and zlib.crc32(memoryview(content)[begin : at + size - 4]) != crc:
        return None
    try:
        channels = dict(
            channel_of(content[first:end])
            for opcode, first, end in _records(content, begin, at)
            if opcode == mcap.CHANNEL
        )
    except (ValueError, struct.error):
        return None
    return Summary(channels, begin, at)


def chunks_with(content: bytes, summary: Summary, numbers: frozenset[int]) -> list[int] | None:
    """Return offsets of the chunks that hold messages of any of these channels; None if the file does not say."""
    offsets = []
    indexed = False
    for opcode, begin, _ in _records(content, summary.start, summary.stop):
        if opcode == mcap.CHUNK_INDEX:
            indexed = True
            _, _, place, _, map_bytes = _CHUNK_INDEX_HEAD.unpack_from(content, begin)
            if not map_bytes:
                return None
            first = begin + _CHUNK_INDEX_HEAD.size
            held = struct.unpack_from("<" + "HQ" * (map_bytes // _CHANNEL_ENTRY), content, first)[::2]
            if not numbers.isdisjoint(held):
                offsets.append(place)
    return offsets if indexed else None


def chunk_spans(content: bytes, summary: Summary) -> list[tuple[int, int, int, int]]:
    """Start and end time in ns, offset in the file and length of every chunk that the summary lists."""
    return [
        _CHUNK_INDEX_HEAD.unpack_from(content, begin)[:4]
        for opcode, begin, _ in _records(content, summary.start, summary.stop)
        if opcode == mcap.CHUNK_INDEX
    ]


def _records(content: bytes, at: int, stop: int) -> Iterator[tuple[int, int, int]]:
    unpack = mcap.RECORD.unpack_from
    while at < stop:
        opcode, length = unpack(content, at)
        begin = at + mcap.RECORD.size
        at = begin + length
        if at > stop:
            raise ValueError("record is longer than the summary")
        yield opcode, begin, at
