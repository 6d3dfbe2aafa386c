"""Writes a session: raw bytes of the links, instrument traffic, events and clock pairs, in hourly MCAP segments."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from bench.model.clock import NS, utc_text
from bench.model.errors import RunError
from bench.model.events import Closed, Error
from bench.model.segments import OPEN_MARKER
from bench.record import layout
from bench.record.layout import Channel, ChunkBuffer, Files, OsFiles, SegmentWriter

SEGMENT_S = 3600
CHUNK_BYTES = 1_000_000  # a chunk is closed before its second when it gets this large
HELD_BYTES = 64_000_000  # kept in memory while the disk refuses
REFUSED_S = 1800  # for so long, as a run waits for anything else: what is held is lost with the process or the power
RETIRED_FILES = 4  # finished segments kept open for the next sync; a virtual run never syncs
FOLDER_MODE = 0o750  # what a unit is and how it behaves is for its owner and the group
HEAD_COPIES = 2  # of manifest and texts


class RecordError(RunError):
    """The recorder cannot store what it was given; the run must hold. Codes B-REC-001 to B-REC-003."""


class SessionWriter:
    """Implements bench.model.ports.SessionSink. Thread-safe; only ``sync`` waits for the disk.

    Create one with ``SessionWriter.create`` (new session) or bench.record.recover.resume_session (a stopped one).
    After a RecordError nothing is lost: what was given is held in memory (64 MB and half an hour at most) and the next
    ``tick`` tries again in a new segment.
    """

    def __init__(
        self,
        folder: Path,
        files: Files,
        *,
        t_mono_ns: int,
        segment: int = 1,
        chain: bytes = layout.CHAIN_START,
        sequence: int = 0,
        topics: tuple[str, ...] = (),
    ) -> None:
        self.folder = folder
        self._files = files
        self._lock = threading.RLock()
        self._channels: list[Channel] = [Channel.make(number, topic) for number, topic in enumerate(topics, 1)]
        self._by_topic = {channel.topic: channel for channel in self._channels}
        self._sequence = sequence
        self._next_number = segment
        self._chain = chain
        self._buffer = ChunkBuffer()
        self._waiting: list[ChunkBuffer] = []  # closed, to be written with the next one
        self._waiting_bytes = 0
        self._segment: SegmentWriter | None = None
        self._retired: list[SegmentWriter] = []
        self._t_ns = t_mono_ns
        self._utc_ns: int | None = None  # minus monotonic time
        self._refused_ns: int | None = None  # since when the disk refuses
        self._rotate_ns = t_mono_ns + SEGMENT_S * NS
        self._closed = False
        self._files.append(folder / OPEN_MARKER).close()

    @classmethod
    def create(
        cls,
        folder: Path,
        manifest: Mapping[str, Any],
        texts: Mapping[str, str],
        *,
        t_mono_ns: int,
        files: Files | None = None,
    ) -> SessionWriter:
        """Start a new session in ``folder`` (created if needed, must hold no segment).

        Manifest and texts (file name -> text of the compiled plan and of every YAML) go in front of everything else,
        twice: without them nothing else can be understood, and a damaged chunk is lost as a whole.
        Raises: RecordError B-REC-001 if the first segment cannot be created or written.
        """
        try:
            folder.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
            writer = cls(folder, files or OsFiles(), t_mono_ns=t_mono_ns)
        except OSError as error:
            raise _cannot_write(folder, error) from error
        for _ in range(HEAD_COPIES):
            writer._add(layout.MANIFEST, t_mono_ns, manifest)
            for name in sorted(texts):
                writer._add(layout.TEXT + name, t_mono_ns, texts[name].encode())
            writer.flush()
        return writer

    def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        """Raw bytes of a link as they were received ("rx") or sent ("tx")."""
        self._add(f"/link/{link}/{direction}", t_mono_ns, chunk)

    def command(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        """One command to ("tx") or reply of ("rx") an instrument."""
        self._add(layout.INSTRUMENT + role, t_mono_ns, {"direction": direction, "text": text})

    def event(self, kind: str, t_mono_ns: int, fields: Mapping[str, Any]) -> None:
        """Anything that happened; ``fields`` must be JSON values, numpy scalars or arrays."""
        self._add(layout.EVENT, t_mono_ns, {"fields": fields, "kind": kind})

    def clock_pair(self, t_mono_ns: int, t_utc_ns: int) -> None:
        """UTC that belongs to a monotonic time."""
        self._utc_ns = t_utc_ns - t_mono_ns
        self._add(layout.CLOCK, t_mono_ns, {"t_mono_ns": t_mono_ns, "t_utc_ns": t_utc_ns})

    def _add(self, topic: str, t_ns: int, payload: bytes | Mapping[str, Any]) -> None:
        with self._lock:
            self._append(topic, t_ns, payload)
            if self._buffer.size > CHUNK_BYTES:
                with suppress(RecordError):  # kept in memory; the next tick says so
                    self.flush()

    def _append(self, topic: str, t_ns: int, payload: bytes | Mapping[str, Any]) -> None:
        channel = self._by_topic.get(topic) or self._new_channel(topic)
        late = self._refused_ns is not None and t_ns - self._refused_ns > REFUSED_S * NS
        if self._closed or late or self._buffer.size > HELD_BYTES:
            raise self._refusal(late=late)
        content = payload if isinstance(payload, bytes) else layout.canonical_json(payload)
        self._buffer.add(channel, self._sequence, t_ns, content)
        self._sequence += 1
        self._t_ns = t_ns

    def _new_channel(self, topic: str) -> Channel:
        channel = Channel.make(len(self._channels) + 1, topic)
        self._channels.append(channel)
        self._by_topic[topic] = channel
        return channel

    def _refusal(self, *, late: bool) -> RecordError:
        if self._closed:
            return RecordError("B-REC-002", "the session is closed", where=str(self.folder))
        what = f"for {REFUSED_S // 60} min" if late else f"and more than {HELD_BYTES // 1_000_000} MB wait"
        return RecordError(
            "B-REC-003",
            f"the disk takes nothing {what}: no more is held in memory",
            where=str(self.folder),
            next_step="free space or change the disk, then start again",
        )

    def tick(self, t_mono_ns: int) -> None:
        """Close the chunk (call at each second of the bench clock); start a new segment each hour."""
        with self._lock:
            self._t_ns = max(self._t_ns, t_mono_ns)
            self.flush()
            if t_mono_ns >= self._rotate_ns:
                self._rotate_ns += ((t_mono_ns - self._rotate_ns) // (SEGMENT_S * NS) + 1) * SEGMENT_S * NS
                self._finish_segment()

    def close_chunk(self, t_mono_ns: int) -> None:
        """Close the chunk as ``tick`` does, at a second of the bench clock that others follow at once.

        It is written with the next one that is ticked, in one call; a fault is said then.
        """
        with self._lock:
            if t_mono_ns >= self._rotate_ns or self._waiting_bytes > CHUNK_BYTES:
                with suppress(RecordError):
                    self.tick(t_mono_ns)
                return
            self._t_ns = max(self._t_ns, t_mono_ns)
            if self._buffer.parts:
                self._waiting.append(self._buffer)
                self._waiting_bytes += self._buffer.size
                self._buffer = ChunkBuffer()

    def flush(self) -> None:
        """Hand everything to the operating system. Raises RecordError B-REC-001 if a new segment fails as well."""
        with self._lock:
            if not (self._waiting or self._buffer.parts):
                return
            if self._segment is not None:
                try:
                    self._segment.write_chunks(self._chunks(), self._channels)
                except OSError as error:
                    self._abandon(error)
                else:
                    self._written()
                    return
            self._write_in_new_segment()

    def _chunks(self) -> list[ChunkBuffer]:
        """Return what is to be written."""
        return [*self._waiting, self._buffer] if self._buffer.parts else self._waiting

    def _written(self) -> None:
        self._refused_ns = None
        self._begin_chunk()

    def _begin_chunk(self) -> None:
        self._waiting, self._waiting_bytes, self._buffer = [], 0, ChunkBuffer()

    def _write_in_new_segment(self) -> None:
        path = self.folder / layout.segment_name(self._next_number)
        try:
            file = self._files.create(path)
            try:
                segment = SegmentWriter(file, self._next_number, self._chain)
                segment.write_chunks(self._chunks(), self._channels)
            except OSError:
                file.close()
                self._files.remove(path)
                raise
        except OSError as error:
            self._hold()
            raise _cannot_write(path, error, self._until()) from error
        self._segment = segment
        self._next_number += 1
        self._written()

    def _hold(self) -> None:
        """Keep what the disk refuses as one chunk, which grows until it takes it."""
        self._refused_ns = self._t_ns if self._refused_ns is None else self._refused_ns
        held, *later = self._chunks()
        for chunk in later:
            held.append(chunk)
        self._begin_chunk()
        self._buffer = held

    def _until(self) -> str:
        """Return how long a run waits for the disk, in words."""
        if self._utc_ns is None or self._refused_ns is None:
            return f"{REFUSED_S // 60} min"
        return f"until {utc_text(self._refused_ns + self._utc_ns + REFUSED_S * NS)}"

    def _abandon(self, error: OSError) -> None:
        """Leave a segment that failed as it is (whole up to its last chunk) and say so in the next one."""
        segment = self._segment
        assert segment is not None
        self._segment = None
        self._chain = segment.chain()
        segment.file.close()
        self._report_fault(segment.number, error, "write fault, new segment begun")

    def _report_fault(self, number: int, error: OSError, text: str) -> None:
        fault = Error(code="B-REC-004", segment=number, errno=error.errno, text=text)
        with self._lock:
            self._append(layout.EVENT, self._t_ns, {"fields": fault.document(), "kind": fault.kind})

    def _finish_segment(self) -> None:
        """Close the segment with its hash-chain message; it is synced later, off this thread."""
        segment = self._segment
        if segment is None:
            return
        chain = segment.chain()
        channel = self._by_topic.get(layout.CHAIN) or self._new_channel(layout.CHAIN)
        self._buffer.add(channel, self._sequence, self._t_ns, layout.canonical_json(segment.chain_fields()))
        try:
            segment.write_chunks([self._buffer], self._channels)
        except OSError as error:
            self._buffer = ChunkBuffer()
            self._abandon(error)
            return
        self._buffer = ChunkBuffer()
        try:
            segment.finish()
        except OSError as error:
            self._report_fault(segment.number, error, "no summary could be written, new segment begun")
        self._chain = chain
        self._segment = None
        self._retired.append(segment)
        if len(self._retired) > RETIRED_FILES:
            self._retired.pop(0).file.close()

    def sync(self) -> None:
        """Wait until everything flushed is on the disk (call each second of wall time, on a thread of its own).

        After a failed sync the segment is left and a new one begun: its last chunks may not be on the disk.
        """
        with self._lock:
            retired, self._retired = self._retired, []
            segment = self._segment
        for old in retired:
            try:
                old.file.sync()
            except OSError as error:
                self._report_fault(old.number, error, "finished segment may not be on the disk")
            finally:
                old.file.close()
        try:
            if segment is not None:
                segment.file.sync()
        except OSError as error:
            with self._lock:
                if self._segment is segment:
                    self._abandon(error)
                    self.flush()

    @property
    def chain(self) -> str:
        """Chain value of the newest finished segment, hex; after ``close`` this is the session's SHA-256."""
        return self._chain.hex()

    @property
    def sequence(self) -> int:
        """Number of messages given so far, in the whole session."""
        return self._sequence

    def close(self, reason: str) -> str:
        """Write the "closed" event, finish the segment, sync; returns the session's SHA-256. Idempotent."""
        with self._lock:
            if self._closed:
                return self.chain
            self.flush()
            self.event(Closed.kind, self._t_ns, Closed(reason=reason).document())
            for _ in range(2):  # a fault while the segment is finished begins another one, which says so
                self.flush()
                self._finish_segment()
            self._closed = True
            self.sync()
            self._files.remove(self.folder / OPEN_MARKER)
            self._files.sync_folder(self.folder)
            return self.chain


def _cannot_write(path: Path, error: OSError, until: str = f"{REFUSED_S // 60} min") -> RecordError:
    return RecordError(
        "B-REC-001",
        f"cannot be written: {error.strerror or error}",
        where=str(path),
        next_step=f"free space or repair the disk; what comes meanwhile is held in memory, {until} and 64 MB at most; "
        "then the run ends",
    )
