"""Parts of a session by time: which chunks of which segments, found without reading the rest."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bench.record import mcap_format as mcap
from bench.record.layout import Message
from bench.record.scan import SegmentScan, Span
from bench.record.summary import Summary, channel_of, chunk_spans, read_summary
from bench.record.walk import Walk

_FIRST_BYTES = (16_384, 1_000_000)
_TAIL = mcap.FOOTER_RECORD.size + len(mcap.MAGIC)


@dataclass(frozen=True)
class ChunkPlace:
    """Where a chunk lies in its file, and the monotonic times of its first and last message, ns."""

    offset: int
    length: int
    start_ns: int
    end_ns: int


@dataclass
class _HeadsOnly(SegmentScan):
    """A walk that unpacks no chunk and notes where they are."""

    places: list[ChunkPlace] = field(default_factory=list)

    def _chunk(self, view: memoryview, at: int, extent: tuple[int, int]) -> Span | None:
        _, _, start_ns, end_ns, _, _, _ = mcap.CHUNK_HEAD.unpack_from(view, at)
        self.places.append(ChunkPlace(at, extent[1] - at, start_ns, end_ns))
        return None


class SegmentChunks:
    """The chunks of one segment by time. Of a finished segment only its summary is read, else its bytes once."""

    def __init__(self, path: Path, only_bytes: int | None = None) -> None:
        self._path = path
        self._content = b""
        tail = self._finished() if only_bytes is None else None
        if tail is not None:
            self._channels, self.places = tail
            return
        with path.open("rb") as stream:
            self._content = stream.read() if only_bytes is None else stream.read(only_bytes)
        scan = _HeadsOnly(path.name, self._content, True)
        for _ in scan.spans():
            pass
        self.places = scan.places
        self._channels = {}

    @classmethod
    def beginning(cls, path: Path) -> SegmentChunks:
        """The first chunks of a segment, no more than are needed to have one."""
        for size in _FIRST_BYTES:
            found = cls(path, size)
            if found.places:
                return found
        return cls(path)

    def messages(self, places: Collection[ChunkPlace], topics: frozenset[str]) -> Iterator[Message]:
        """Yield messages of some topics in some of the chunks, in order."""
        if self._content:
            self._learn(topics)
        walk = Walk(topics)
        summary = Summary(self._channels, 0, 0)
        with self._path.open("rb") as stream:
            for place in places:
                if not self._content:
                    stream.seek(place.offset)
                content = self._content[place.offset :][: place.length] if self._content else stream.read(place.length)
                yield from walk.chunks(self._path.name, content, summary, [0])

    def _finished(self) -> tuple[dict[int, str], list[ChunkPlace]] | None:
        """Return channels and chunks as the summary lists them; None if there is none or it does not list them."""
        size = self._path.stat().st_size
        if size < _TAIL + len(mcap.MAGIC):
            return None
        with self._path.open("rb") as stream:
            stream.seek(size - _TAIL)
            _, _, start, _, _ = mcap.FOOTER_RECORD.unpack_from(tail := stream.read(_TAIL))
            if not tail.endswith(mcap.MAGIC) or not 0 < start < size:
                return None
            stream.seek(start)
            content = stream.read()
        summary = read_summary(content, start)
        spans = [] if summary is None else chunk_spans(content, summary)
        if summary is None or not spans:
            return None
        return summary.channels, [ChunkPlace(offset, length, first, last) for first, last, offset, length in spans]

    def _learn(self, topics: frozenset[str]) -> None:
        """Channels stand in front of the chunk in which they are used first: look until all are known."""
        scan = SegmentScan(self._path.name, self._content, True)
        for place in self.places:
            if topics <= set(self._channels.values()):
                return
            for span in scan.chunk_at(place.offset):
                self._channels.update(_channels_in_front(span.records))


def _channels_in_front(records: bytes) -> Iterator[tuple[int, str]]:
    at = 0
    while at + mcap.RECORD.size <= len(records):
        opcode, length = mcap.RECORD.unpack_from(records, at)
        if opcode != mcap.CHANNEL:
            return
        begin = at + mcap.RECORD.size
        at = begin + length
        try:
            yield channel_of(records[begin:at])
        except (ValueError, struct.error):
            continue
