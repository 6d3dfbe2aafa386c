"""Messages of many chunks at once: unpacked, verified and taken apart together, as long as nothing is wrong with them.

A block is all or nothing: whatever is not exactly as a session is written is left to the walk (bench.record.walk),
which looks at one message after the other and names what is damaged.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bench.model.arrays import Array, Flags, Indices, Integers
from bench.record import layout
from bench.record import mcap_format as mcap
from bench.record.layout import Message
from bench.record.mcap_format import Content, channel_of
from bench.record.scan import MAX_CHUNK_BYTES, consistent, unpack

FIRST_BYTES = 100_000  # whoever reads the head of a session only needs no more
BLOCK_BYTES = 2_000_000  # unpacked
_LZ4 = b"lz4"
_INDEXED = struct.Struct("<BQHI")  # of a message index: opcode, length, channel, bytes of its entries
_INDEX_HEAD = 6
_PACKED = struct.Struct(mcap.CHUNK_HEAD.format + "3sQ")  # of a chunk: its head, how it is packed, packed bytes
_STAMP_BYTES = 16  # in front of a payload; the envelope's CRC covers both
_HEAD = np.dtype(
    [
        ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("low", "<u4"), ("log_ns", "<u8"),
        ("publish_ns", "<u8"), ("crc", "<u4"), ("sequence", "<u8"), ("t_ns", "<u8"),
    ]
)  # fmt: skip
_SHORTEST = _HEAD.itemsize - mcap.RECORD.size


@dataclass(frozen=True)
class Block:
    """Messages that follow each other, every one proved by its CRC.

    ``records``: bytes in which the payload of message k is [begin[k], stop[k]). ``topics``: names by channel number.
    ``channel``, ``sequence``, ``t_ns``, ``begin``, ``stop``: (n,), in the order of recording.
    """

    records: bytes
    topics: Mapping[int, str]
    channel: NDArray[np.uint16]
    sequence: NDArray[np.uint64]
    t_ns: NDArray[np.uint64]
    begin: Integers
    stop: Integers

    def __len__(self) -> int:
        return len(self.channel)

    @classmethod
    def of(cls, messages: Sequence[Message]) -> Block:
        """Return messages that were looked at one by one as a block."""
        numbers = {topic: number for number, topic in enumerate(dict.fromkeys(message.topic for message in messages))}
        sizes = np.array([len(message.payload) for message in messages], np.int64)
        stop = np.cumsum(sizes)
        return cls(
            b"".join(message.payload for message in messages),
            {number: topic for topic, number in numbers.items()},
            np.array([numbers[message.topic] for message in messages], np.uint16),
            np.array([message.sequence for message in messages], np.uint64),
            np.array([message.t_ns for message in messages], np.uint64),
            stop - sizes,
            stop,
        )

    def among(self, topics: frozenset[str] | None) -> Indices:
        """Return places of the messages of some topics, None: of all."""
        if topics is None:
            return np.arange(len(self))
        return np.flatnonzero(_chosen(tuple(self.topics.items()), topics)[self.channel])

    def messages(self, topics: frozenset[str] | None) -> Iterator[Message]:
        """Yield the messages of some topics, None: of all."""
        for _, message in self.placed(topics):
            yield message

    def placed(self, topics: frozenset[str] | None) -> Iterator[tuple[int, Message]]:
        """Yield the messages of some topics, each with its place in the block."""
        at = self.among(topics)
        columns = (self.channel[at], self.sequence[at], self.t_ns[at], self.begin[at], self.stop[at])
        for place, number, sequence, t_ns, begin, stop in zip(
            at.tolist(), *(column.tolist() for column in columns), strict=True
        ):
            yield place, Message(self.topics[number], sequence, t_ns, self.records[begin:stop])

    def payloads(self, at: Indices) -> list[tuple[int, bytes]]:
        """Return time and payload of the messages at some places."""
        records = self.records
        places = zip(self.t_ns[at].tolist(), self.begin[at].tolist(), self.stop[at].tolist(), strict=True)
        return [(t_ns, records[begin:stop]) for t_ns, begin, stop in places]


@lru_cache(maxsize=64)
def _chosen(names: tuple[tuple[int, str], ...], topics: frozenset[str]) -> Flags:
    """Return by channel number whether it is one of some topics."""
    chosen = np.zeros(1 + max((number for number, _ in names), default=0), np.bool_)
    chosen[[number for number, name in names if layout.matches(name, topics)]] = True
    return chosen


@dataclass(frozen=True)
class Stretch:
    """Chunks that follow each other: begin, stop of the packed records, size and CRC of the records; next record."""

    chunks: list[tuple[int, int, int, int]]
    next_at: int


def stretches(content: Content) -> Iterator[Stretch]:
    """Yield chunks by the block from the beginning of a segment, all but the last, up to the first unusual record."""
    if content[: len(mcap.MAGIC)] != mcap.MAGIC:
        return
    chunks: list[tuple[int, int, int, int]] = []
    size, limit = 0, FIRST_BYTES
    for at, chunk in _chunks(content):
        if size >= limit:
            yield Stretch(chunks, at)
            chunks, size, limit = [], 0, BLOCK_BYTES
        chunks.append(chunk)
        size += chunk[2]
        last_at = at
    if len(chunks) > 1:
        yield Stretch(chunks[:-1], last_at)


def _chunks(content: Content) -> Iterator[tuple[int, tuple[int, int, int, int]]]:
    """Yield offset and extent of the chunks in the beginning of a segment that holds nothing unusual."""
    unpack_index, unpack_chunk = _INDEXED.unpack_from, _PACKED.unpack_from
    at, room = len(mcap.MAGIC), len(content) - _PACKED.size
    while at <= room:
        opcode = content[at]
        if opcode == mcap.CHUNK:
            _, length, start_ns, end_ns, size, crc, letters, name, packed = unpack_chunk(content, at)
            begin = at + _PACKED.size
            end = begin + packed
            usual = letters == len(_LZ4) and name == _LZ4 and end == at + mcap.RECORD.size + length
            if not usual or not crc or start_ns > end_ns or end > len(content) or size > MAX_CHUNK_BYTES:
                return
            yield at, (begin, end, size, crc)
        else:
            _, length, _, entries = unpack_index(content, at)
            end = at + mcap.RECORD.size + length
            if opcode == mcap.MESSAGE_INDEX:
                if length != _INDEX_HEAD + entries:
                    return
            elif opcode != mcap.HEADER or end > room or not consistent(memoryview(content), at, opcode, length):
                return
        at = end


def unpacked(content: Content, stretch: Stretch) -> tuple[bytes, Integers] | None:
    """Return the records of all chunks and where those of each one end; None if one is not as it was written."""
    view, crc32 = memoryview(content), zlib.crc32
    parts = []
    try:
        for begin, stop, size, crc in stretch.chunks:
            records = unpack(view[begin:stop], size)
            if crc32(records) != crc:
                return None
            parts.append(records)
    except (RuntimeError, ValueError, MemoryError, OverflowError):
        return None
    return b"".join(parts), np.cumsum(np.array([len(records) for records in parts], np.int64))


@dataclass(frozen=True)
class Records:
    """Heads of the messages of a block, where each begins and ends, and channels that begin: place, number, topic."""

    heads: Array
    at: Integers
    end: Integers
    channels: list[tuple[int, int, str]]


def taken_apart(records: bytes, ends: Integers) -> Records | None:
    """Return the records of chunks that end at ``ends``; None if there is one that is no message and no channel."""
    unpack, size = mcap.RECORD.unpack_from, len(records)
    starts, channels, at = [], [], 0
    while at + _HEAD.itemsize <= size:
        opcode, length = unpack(records, at)
        end = at + mcap.RECORD.size + length
        if opcode == mcap.MESSAGE:
            starts.append(at)
        elif opcode != mcap.CHANNEL:
            return None
        else:
            try:
                channels.append((at, *channel_of(records[at + mcap.RECORD.size : end])))
            except (ValueError, struct.error):
                return None
        at = end
    if at != size or not starts:
        return None
    place = np.array(starts, np.int64)
    heads = sliding_window_view(np.frombuffer(records, np.uint8), _HEAD.itemsize)[place].view(_HEAD).reshape(-1)
    end_at = place + mcap.RECORD.size + heads["length"].astype(np.int64)
    last = np.searchsorted(end_at, ends)
    whole = int(end_at[-1]) == size and bool((end_at[last] == ends).all())
    return Records(heads, place, end_at, channels) if whole else None


def proved(records: bytes, found: Records, seeds: Integers) -> bool:
    """Return whether every message is long enough and its envelope's CRC is right; ``seeds``: (n,), by its topic."""
    if (found.end - found.at < mcap.RECORD.size + _SHORTEST).any():
        return False
    view, crc32 = memoryview(records), zlib.crc32
    begin = found.at + (_HEAD.itemsize - _STAMP_BYTES)
    places = zip(begin.tolist(), found.end.tolist(), seeds.tolist(), strict=True)
    computed = [crc32(view[first:stop], seed) for first, stop, seed in places]
    return bool(computed == found.heads["crc"].tolist())


def block_of(records: bytes, found: Records, topics: Mapping[int, str]) -> Block:
    """Return messages that are proved as a block."""
    heads = found.heads
    return Block(records, topics, heads["channel"], heads["sequence"], heads["t_ns"],
                 found.at + _HEAD.itemsize, found.end)  # fmt: skip
