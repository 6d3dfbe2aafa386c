"""What a damaged or unfinished session still holds, a clean copy of it, and how a run goes on with it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.events import Resume
from bench.record import layout
from bench.record.files import Files, OsFiles
from bench.record.journal import read_journal
from bench.record.reader import SessionReader
from bench.record.scan import Damage
from bench.record.segment import Channel, ChunkBuffer, SegmentWriter
from bench.record.writer import CHUNK_BYTES, SessionWriter

_SALVAGE_SEGMENT_BYTES = 64_000_000


@dataclass(frozen=True)
class Survey:
    """What a session holds. ``counts``: good messages by topic; ``lost``: messages known to be missing.

    ``span_s``: monotonic time from the first to the last good message, second. ``records``: numbers of the records
    whose window is known. ``steps``: finished steps in the journal of a run that did not end.
    """

    folder: str
    segments: tuple[str, ...]
    unfinished: tuple[str, ...]
    damage: tuple[Damage, ...]
    counts: dict[str, int]
    records: tuple[int, ...]
    span_s: float
    has_manifest: bool
    steps: int

    @property
    def damaged(self) -> bool:
        """True if anything that was recorded is not as it was written."""
        return bool(self.damage)

    @property
    def lost(self) -> int:
        """Messages known to be missing."""
        return sum(item.lost or 0 for item in self.damage)

    def as_json(self) -> dict[str, Any]:
        """Return the survey as JSON values."""
        return {
            "session": self.folder, "damaged": self.damaged, "segments": list(self.segments),
            "unfinished": list(self.unfinished), "messages": self.counts, "lost": self.lost,
            "records": len(self.records), "span_s": self.span_s, "manifest": self.has_manifest,
            "journal_steps": self.steps,
            "damage": [asdict(item) for item in self.damage],
        }  # fmt: skip

    def lines(self) -> list[str]:
        """Return the survey for a person."""
        total = sum(self.counts.values())
        said = [
            f"{self.folder}: {len(self.segments)} segments, {total} good messages over {self.span_s:.0f} s, "
            f"{len(self.records)} records, manifest {'whole' if self.has_manifest else 'LOST'}"
        ]
        said += [f"  {topic}: {count} messages" for topic, count in self.counts.items()]
        said += [f"unfinished: {name} is whole up to its last chunk" for name in self.unfinished]
        said += [f"damaged: {item}" for item in self.damage]
        if self.steps:
            said.append(f"journal: {self.steps} steps were finished; the run did not end")
        said.append(f"{self.lost} messages are known to be lost" if self.damaged else "nothing is damaged")
        return said


def recover_session(folder: Path) -> Survey:
    """Walk a session and say what is whole. Raises: InputError B-REC-010 if there is none."""
    reader = SessionReader(folder)
    first_ns: int | None = None
    last_ns = 0
    records: set[int] = set()
    has_manifest = False
    for message in reader.messages():
        first_ns = message.t_ns if first_ns is None else first_ns
        last_ns = message.t_ns
        has_manifest = has_manifest or message.topic == layout.MANIFEST
        if message.topic == layout.EVENT:
            kind, fields = message.event()
            if kind == "record" and isinstance(fields.get("number"), int):
                records.add(fields["number"])
    return Survey(
        str(folder), tuple(path.name for path in reader.segments), tuple(reader.unfinished), tuple(reader.damage),
        reader.counts, tuple(sorted(records)), (last_ns - (first_ns or 0)) / NS, has_manifest,
        len(read_journal(folder).entries),
    )  # fmt: skip


def salvage(folder: Path, destination: Path, files: Files | None = None) -> int:
    """Copy every good message into new, finished segments; returns how many there were.

    Envelopes stay as they are: running numbers keep their gaps, so what was lost stays visible.
    Raises: InputError B-REC-013 if ``destination`` exists already; B-REC-010 if there is no session.
    """
    reader = SessionReader(folder)
    if destination.exists():
        raise InputError(
            "B-REC-013", "exists already", where=str(destination), next_step="name a folder that does not exist yet"
        )
    destination.mkdir(parents=True)
    copy = _Copy(destination, files or OsFiles())
    count = 0
    for message in reader.messages():
        if message.topic != layout.CHAIN:
            copy.add(message)
            count += 1
    copy.finish()
    return count


class _Copy:
    def __init__(self, folder: Path, files: Files) -> None:
        self._folder = folder
        self._files = files
        self._channels: list[Channel] = []
        self._numbers: dict[str, int] = {}
        self._buffer = ChunkBuffer()
        self._number = 0
        self._chain = layout.CHAIN_START
        self._next = 0
        self._t_ns = 0
        self._segment = self._next_segment()

    def _next_segment(self) -> SegmentWriter:
        self._number += 1
        file = self._files.create(self._folder / layout.segment_name(self._number))
        return SegmentWriter(file, self._number, self._chain)

    def _channel(self, topic: str) -> Channel:
        if topic not in self._numbers:
            self._channels.append(Channel.make(len(self._channels) + 1, topic))
            self._numbers[topic] = len(self._channels)
        return self._channels[self._numbers[topic] - 1]

    def add(self, message: layout.Message) -> None:
        """Copy one message."""
        if self._segment.offset > _SALVAGE_SEGMENT_BYTES:
            self.finish()
            self._segment = self._next_segment()
        channel = self._channel(message.topic)
        self._buffer.add(channel, message.sequence, message.t_ns, message.payload)
        self._next, self._t_ns = message.sequence + 1, message.t_ns
        if self._buffer.size > CHUNK_BYTES:
            self._flush()

    def _flush(self) -> None:
        if self._buffer.parts:
            self._segment.write_chunk(self._buffer, self._channels)
            self._buffer = ChunkBuffer()

    def finish(self) -> None:
        """End the segment."""
        self._flush()
        self._chain = self._segment.chain()
        fields = layout.canonical_json(self._segment.chain_fields())
        self._buffer.add(self._channel(layout.CHAIN), self._next, self._t_ns, fields)
        self._flush()
        self._segment.finish()
        self._segment.file.sync()
        self._segment.file.close()


def resume_session(folder: Path, event: Resume, *, t_mono_ns: int, files: Files | None = None) -> SessionWriter:
    """Open a session for more messages; the first one is ``event`` with the number of the new segment.

    The running number goes on behind the last good message and the hash chain behind the last whole record.
    Counters of the links and monotonic time may start anew behind the event.
    Raises: InputError B-REC-010 (no session there), RecordError B-REC-001.
    """
    reader = SessionReader(folder)
    last = int(reader.segments[-1].name.split(".")[1])
    topics = tuple(reader.topics.values()) if list(reader.topics) == list(range(1, len(reader.topics) + 1)) else ()
    writer = SessionWriter(
        folder,
        files or OsFiles(),
        t_mono_ns=t_mono_ns,
        segment=last + 1,
        chain=bytes.fromhex(reader.sha256),
        sequence=reader.next_sequence,
        topics=topics,
    )
    writer.event(event.kind, t_mono_ns, replace(event, segment=last + 1).document())
    writer.flush()
    return writer
