"""Goes on with a session that was stopped or crashed: in a new segment, finished ones are never touched."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.record.files import Files, OsFiles
from bench.record.reader import SessionReader
from bench.record.writer import SessionWriter


def resume_session(
    folder: Path, *, t_mono_ns: int, fields: Mapping[str, Any], files: Files | None = None
) -> SessionWriter:
    """Open a session for more messages; the first one is a "resume" event with ``fields``.

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
    writer.event("resume", t_mono_ns, {**fields, "segment": last + 1})
    writer.flush()
    return writer
