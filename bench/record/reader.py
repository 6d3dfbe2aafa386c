"""Reads a session: all of it, verified, with damage reported instead of dying of it; or parts of it by time."""

from __future__ import annotations

import json
import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import SEEK_END
from pathlib import Path
from typing import Any

from bench.model.errors import NEXT_FORM, InputError, SessionDamaged, unknown_form
from bench.model.events import Closed
from bench.model.segments import session_segments
from bench.record import layout
from bench.record import mcap_format as mcap
from bench.record.block import Block
from bench.record.layout import Message
from bench.record.mcap_format import Summary, channel_of, chunk_spans, chunks_with, read_summary, segment_bytes
from bench.record.scan import Damage, SegmentScan, Span, note
from bench.record.walk import Walk

RESULTS = "results.json"
SHORTER = "ends here, shorter than the recording that results.json was computed from"
_FIRST_BYTES = (16_384, 1_000_000)
_TAIL = mcap.FOOTER_RECORD.size + len(mcap.MAGIC)


class SessionReader:
    """A recorded session.

    Args: folder: the session's folder.
          strict: raise SessionDamaged B-REC-011 at the first damaged segment instead of going on.
    Raises: InputError B-REC-010 if the folder holds no segment.

    A session is walked once, when one of ``damage``, ``sha256``, ``counts`` or ``unfinished`` is asked for, or when
    ``messages`` has been iterated to its end.
    """

    def __init__(self, folder: Path, *, strict: bool = False) -> None:
        self.folder = folder
        self._strict = strict
        self._walk: Walk | None = None
        self.segments = session_segments(folder)

    def messages(self, topics: frozenset[str] | None = None) -> Iterator[Message]:
        """Every message in the order of recording, or those of ``topics`` (a topic ending in "/" means all below it).

        The whole session is walked and verified, whatever is selected.
        """
        for block in self.blocks(topics):
            yield from block.messages(topics)

    def blocks(self, topics: frozenset[str] | None = None) -> Iterator[Block]:
        """Yield every good message in the order of recording, many at once.

        ``topics``: others are left out where it saves work. The whole session is walked and verified.
        """
        walk = Walk(topics)
        self._missing_segments(walk)
        for path in self.segments:
            yield from walk.blocks(path.name, segment_bytes(path))
            if path == self.segments[-1] and self._is_shorter(walk):
                note(walk.damage, Damage(path.name, path.stat().st_size, SHORTER))
            if self._strict and walk.damage:
                raise damaged(self.folder, walk.damage)
        self._walk = walk

    def select(self, topics: frozenset[str]) -> Iterator[Message]:
        """Yield messages of a few topics, through the chunk indexes: fast, and nothing else is read or verified."""
        walk = Walk(topics)
        for path in self.segments:
            content, summary = _summary_of(path)
            channels = summary.channels if summary else {}
            wanted = frozenset(number for number, topic in channels.items() if layout.matches(topic, topics))
            places = chunks_with(content, summary, wanted) if summary else None
            if summary is None or places is None:
                yield from walk.segment(path.name, segment_bytes(path))
                continue
            with path.open("rb") as stream:
                for offset, length in places:
                    stream.seek(offset)
                    yield from walk.chunks(path.name, stream.read(length), summary, [0])

    def events(self, kind: str | None = None) -> Iterator[tuple[str, int, dict[str, Any]]]:
        """Yield events (kind, t_mono_ns, fields) in order, all or of one kind."""
        for message in self.select(frozenset({layout.EVENT})):
            found, fields = message.event()
            if kind is None or found == kind:
                yield found, message.t_ns, fields

    @cached_property
    def _head(self) -> tuple[dict[str, Any] | None, dict[str, str]]:
        manifest: dict[str, Any] | None = None
        texts: dict[str, str] = {}
        for message in Walk(None).segment(self.segments[0].name, segment_bytes(self.segments[0])):
            if message.topic == layout.MANIFEST:
                manifest = message.document() if manifest is None else manifest
            elif message.topic.startswith(layout.TEXT):
                texts.setdefault(message.topic.removeprefix(layout.TEXT), message.text())
            else:
                break
        return manifest, texts

    @property
    def manifest(self) -> dict[str, Any]:
        """The manifest. Raises SessionDamaged B-REC-012 (lost), B-REC-014; InputError B-REC-007 (unknown form)."""
        manifest = self._head[0]
        if manifest is None:
            raise SessionDamaged(
                "B-REC-012",
                "the manifest is missing or damaged",
                where=str(self.segments[0]),
                next_step="'bench recover' lists what the session still holds",
            )
        if why := unknown_form(manifest, "schema"):
            where = str(self.segments[0])
            raise InputError("B-REC-007", f"the manifest is {why}", where=where, next_step=NEXT_FORM)
        return manifest

    @property
    def texts(self) -> dict[str, str]:
        """Text of the compiled plan and of every YAML, by file name."""
        return self._head[1]

    def _walked(self) -> Walk:
        if self._walk is None:
            for _ in self.blocks(frozenset()):
                pass
        assert self._walk is not None
        return self._walk

    @property
    def damage(self) -> list[Damage]:
        """Every damaged place, in file order; empty if all of the session is as it was written."""
        return self._walked().damage

    @property
    def unfinished(self) -> list[str]:
        """Segments without an end (crash, or still being written): whole up to their last chunk."""
        return self._walked().unfinished

    @property
    def sha256(self) -> str:
        """Chain value of the last segment: covers all segments in order."""
        return self._walked().chain.hex()

    @property
    def counts(self) -> dict[str, int]:
        """Number of good messages by topic."""
        return self._walked().counts

    @property
    def next_sequence(self) -> int:
        """Running number that follows the last good message."""
        return self._walked().expected

    @property
    def topics(self) -> dict[int, str]:
        """Channel numbers and topics of the last segment."""
        return self._walked().topics

    def _missing_segments(self, walk: Walk) -> None:
        present = {int(path.name.split(".")[1]) for path in self.segments}
        for number in sorted(set(range(1, max(present) + 1)) - present):
            walk.damage.append(Damage(layout.segment_name(number), 0, "segment is missing"))

    def _is_shorter(self, walk: Walk) -> bool:
        """Return whether results.json has the hash of a recording that goes on behind the end of this one."""
        try:
            whole = json.loads((self.folder / RESULTS).read_bytes())["provenance"]["session_sha256"]
        except (OSError, ValueError, LookupError, TypeError):
            return False
        if whole in map(bytes.hex, walk.ends):  # a run that was gone on with
            return False
        return bool(walk.unfinished) or [kind for kind, _, _ in self.events()][-1:] != [Closed.kind]


def damaged(folder: Path, damage: Sequence[Damage], more: str = "") -> SessionDamaged:
    """Return the error of a session that is not as it was written; ``more``: what follows from that."""
    others = f" and {len(damage) - 1} more" if len(damage) > 1 else ""
    return SessionDamaged(
        "B-REC-011",
        f"{damage[0]}{others}{more}",
        where=str(folder),
        next_step="'bench recover' lists what the session still holds",
    )


def _summary_of(path: Path) -> tuple[bytes, Summary | None]:
    """Return the end of a segment from its summary on, and the summary; None if there is none that can be believed."""
    with path.open("rb") as stream:
        size = stream.seek(0, SEEK_END)
        if size < _TAIL + len(mcap.MAGIC):
            return b"", None
        stream.seek(size - _TAIL)
        _, _, start, _, _ = mcap.FOOTER_RECORD.unpack_from(tail := stream.read(_TAIL))
        if not tail.endswith(mcap.MAGIC) or not 0 < start < size:
            return b"", None
        stream.seek(start)
        content = stream.read()
    return content, read_summary(content, start)


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
        content, summary = _summary_of(self._path)
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
