"""Walks one segment and never gives up: damaged records are reported and skipped, the next whole chunk is searched."""

from __future__ import annotations

import hashlib
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import reduce
from typing import NamedTuple

import lz4.frame

from bench.record import mcap_format as mcap
from bench.record.mcap_format import Content, let_go, pieces

_CHUNK_LIKE = re.compile(rb"\x06[\s\S]{5}\x00{3}")  # opcode and a length below 2^40
_COMPRESSIONS = (b"", b"lz4", b"zstd")
_CHUNK_TAIL = 8  # length field in front of the compressed records
_DATA_END_BYTES = 4
_INDEX_ARRAY_AT, _INDEX_HEAD = 2, 6  # channel u16, then u32 length of the entries
MAX_CHUNK_BYTES = 1 << 26  # unpacked; what is recorded has some 10 kB, and the stock writer 1 MB
MOST_DAMAGE = 10_000  # places that are listed
_SEARCHED_BYTES = 16_000_000
_LONGEST_MATCH = 9


class Span(NamedTuple):
    """Records of one chunk, unpacked; ``sound`` is True if the chunk's CRC proves them."""

    offset: int
    records: bytes
    sound: bool


@dataclass
class Damage:
    """One damaged place: segment file, byte in it, what is wrong, and how many messages are missing (None: unknown)."""

    segment: str
    byte: int
    what: str
    lost: int | None = None

    @property
    def inside(self) -> str:
        """Where in its segment, and what is wrong."""
        lost = "" if self.lost is None else f" ({self.lost} messages lost)"
        return f"byte {self.byte}: {self.what}{lost}"

    def __str__(self) -> str:
        return f"{self.segment} {self.inside}"


@dataclass
class SegmentScan:
    """One walk through the bytes of a segment.

    After the walk: ``finished`` (data end, footer and closing magic are there), ``data_stop`` (end of the last whole
    record in front of the data end), ``damage``.
    """

    name: str
    content: Content
    has_summary: bool
    damage: list[Damage] = field(default_factory=list)
    finished: bool = False
    data_stop: int = 0

    def spans(self, at: int = 0) -> Iterator[Span]:
        """Yield every readable chunk in file order, from the record at ``at`` on if that is not 0.

        A message outside a chunk is a span of its own (not proved).
        """
        view = memoryview(self.content)
        if not at:
            if view[: len(mcap.MAGIC)] != mcap.MAGIC and len(view) > 0:
                self._report(0, "is not an MCAP file: wrong magic")
            at = min(len(mcap.MAGIC), len(view))
        self.data_stop = at
        while at < len(view):
            record = self._record(view, at)
            if record is None:
                at = self._resynchronise(view, at)
                continue
            opcode, end = record
            if opcode == mcap.CHUNK:
                extent = _chunk_extent(view, at)
                if extent is None:
                    at = self._skip_chunk(view, at, end)
                    continue
                span = self._chunk(view, at, extent)
                if span is not None:
                    yield span
            elif opcode in (mcap.MESSAGE, mcap.CHANNEL):
                yield Span(at, bytes(view[at:end]), False)
            elif opcode == mcap.DATA_END:
                self.data_stop = at
                self._close(end)
                return
            self.data_stop = end
            at = end

    def chunk_at(self, at: int) -> list[Span]:
        """The chunk at one offset, if it is readable."""
        view = memoryview(self.content)
        record = self._record(view, at)
        if record is None or record[0] != mcap.CHUNK:
            return []
        extent = _chunk_extent(view, at)
        span = None if extent is None else self._chunk(view, at, extent)
        return [] if span is None else [span]

    def _record(self, view: memoryview, at: int) -> tuple[int, int] | None:
        if at + mcap.RECORD.size > len(view):
            return None
        opcode, length = mcap.RECORD.unpack_from(view, at)
        end = at + mcap.RECORD.size + length
        if opcode not in mcap.KNOWN or end > len(view) or not consistent(view, at, opcode, length):
            return None
        return opcode, end

    def _resynchronise(self, view: memoryview, at: int) -> int:
        """Next plausible chunk behind ``at``; without one the rest of an unfinished segment is no damage but a tail."""
        following = self._plausible_chunk(view, at, len(view))
        if following is not None:
            self._report(at, f"damaged record, {following - at} bytes skipped")
            return following
        if bytes(view[-len(mcap.MAGIC) :]) == mcap.MAGIC and at >= len(mcap.MAGIC):
            self._report(at, "damaged record, the end of the segment cannot be read")
        return len(view)

    def _plausible_chunk(self, view: memoryview, at: int, stop: int) -> int | None:
        """Return where the first chunk begins behind ``at`` and before ``stop``, None if none does."""
        for begin in range(at + 1, stop, _SEARCHED_BYTES):
            last = min(begin + _SEARCHED_BYTES, stop) + _LONGEST_MATCH - 1
            for match in _CHUNK_LIKE.finditer(self.content, begin, last):
                if _chunk_extent(view, match.start()) is not None:
                    return match.start()
            let_go(self.content)
        return None

    def _chunk(self, view: memoryview, at: int, extent: tuple[int, int]) -> Span | None:
        _, _, _, _, size, crc, name_length = mcap.CHUNK_HEAD.unpack_from(view, at)
        packed = view[extent[0] : extent[1]]
        if name_length == len("zstd"):
            self._report(at, "chunk is packed with zstd; write sessions with lz4 or without compression")
            return None
        try:
            records = unpack(packed, size) if name_length else bytes(packed)
        except (RuntimeError, ValueError, MemoryError, OverflowError):
            self._report(at, "chunk cannot be unpacked")
            return None
        sound = crc != 0 and zlib.crc32(records) == crc
        if not sound and crc != 0:
            self._report(at, "chunk CRC is wrong")
        elif len(records) != size:
            self._report(at, f"chunk holds {len(records)} bytes, its header says {size}")
        return Span(at, records, sound)

    def _skip_chunk(self, view: memoryview, at: int, end: int) -> int:
        """Behind a chunk whose header contradicts itself: to the next record if there is one, else search.

        The length that it claims may be what is wrong, and lead into the middle of a chunk behind it.
        """
        claims_others = self._plausible_chunk(view, at, min(end, len(view))) is not None
        if not claims_others and end < len(view) and self._record(view, end) is not None:
            self._report(at, "damaged chunk header, chunk skipped")
            return end
        return self._resynchronise(view, at)

    def _close(self, at: int) -> None:
        self.finished = True
        if not self.has_summary:
            self._report(at, "summary or footer is damaged or cut; the messages are not affected")

    def check_data_crc(self) -> None:
        """Compare the CRC of the data section, where the writer gave one: it also covers the hash-chain message."""
        size = mcap.RECORD.size
        _, length = mcap.RECORD.unpack_from(self.content, self.data_stop)
        stored = int.from_bytes(self.content[self.data_stop + size : self.data_stop + size + length], "little")
        if length != _DATA_END_BYTES:
            self._report(self.data_stop, "data end record is damaged")
            return
        crc = reduce(lambda crc, piece: zlib.crc32(piece, crc), pieces(self.content, self.data_stop), 0)
        if stored and crc != stored:
            self._report(self.data_stop, "CRC of the data section is wrong")

    def _report(self, at: int, what: str) -> None:
        note(self.damage, Damage(self.name, at, what))


def note(damage: list[Damage], item: Damage) -> None:
    """Append a damaged place, up to as many as anybody reads."""
    if len(damage) < MOST_DAMAGE:
        damage.append(item)
    elif len(damage) == MOST_DAMAGE:
        damage.append(Damage(item.segment, item.byte, "and everything behind: too much is damaged to be listed"))


def unpack(packed: memoryview, size: int) -> bytes:
    """Return the records of a chunk. Raises: RuntimeError, ValueError if they are not ``size`` bytes."""
    unpacker = lz4.frame.LZ4FrameDecompressor()
    records: bytes = unpacker.decompress(packed, max_length=size + 1)
    if len(records) != size or not unpacker.eof:
        raise ValueError("the chunk does not hold what its header says")
    return records


def consistent(view: memoryview, at: int, opcode: int, length: int) -> bool:
    """False if a record contradicts itself: one flipped bit of a length must not swallow the chunks behind it."""
    begin = at + mcap.RECORD.size
    if opcode == mcap.HEADER:
        profile = int.from_bytes(view[begin : begin + 4], "little")
        library = int.from_bytes(view[begin + 4 + profile : begin + 8 + profile], "little")
        return length == 8 + profile + library
    if opcode == mcap.MESSAGE_INDEX:
        array = begin + _INDEX_ARRAY_AT
        return length >= _INDEX_HEAD and length == _INDEX_HEAD + int.from_bytes(view[array : array + 4], "little")
    return opcode != mcap.DATA_END or length == _DATA_END_BYTES


def _chunk_extent(view: memoryview, at: int) -> tuple[int, int] | None:
    """Begin and end of the packed records of the chunk at ``at``, or None if its lengths contradict each other."""
    if at + mcap.CHUNK_HEAD.size + _CHUNK_TAIL > len(view):
        return None
    opcode, length, start, end, size, _, name_length = mcap.CHUNK_HEAD.unpack_from(view, at)
    begin = at + mcap.CHUNK_HEAD.size + name_length + _CHUNK_TAIL
    if opcode != mcap.CHUNK or name_length > 8 or begin > len(view) or start > end or size > MAX_CHUNK_BYTES:
        return None
    name = bytes(view[at + mcap.CHUNK_HEAD.size : begin - _CHUNK_TAIL])
    packed = int.from_bytes(view[begin - _CHUNK_TAIL : begin], "little")
    if name not in _COMPRESSIONS or begin + packed > len(view) or length != mcap.CHUNK_FIXED + name_length + packed:
        return None
    return begin, begin + packed


def chain_value(previous: bytes, content: Content, stop: int) -> bytes:
    """SHA-256 over the chain value of the segment before and the first ``stop`` bytes of this one."""
    digest = hashlib.sha256(previous)
    for piece in pieces(content, stop):
        digest.update(piece)
    return digest.digest()
