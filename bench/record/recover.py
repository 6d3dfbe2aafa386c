"""Lists what a damaged or unfinished session still holds, and lets a run go on with it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.events import Record, Resume, event_of
from bench.record import layout
from bench.record.journal import read_journal
from bench.record.layout import OsFiles
from bench.record.reader import SessionReader
from bench.record.scan import Damage
from bench.record.writer import SessionWriter

SHOWN = 50  # damaged places that a person is shown


@dataclass(frozen=True)
class Survey:
    """Content of a session. ``counts``: good messages by topic; ``lost``: messages known to be missing.

    ``span_s``: monotonic time from the first to the last good message, second. ``records``: numbers of the records
    whose window is known. ``steps``: finished steps in the journal of a run that did not end; ``refused``: why it
    cannot be read, "" if it can.
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
    refused: str

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
            **({"journal_refused": self.refused} if self.refused else {}),
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
        said += [f"damaged: {item}" for item in self.damage[:SHOWN]]
        if len(self.damage) > SHOWN:
            said.append(f"damaged: {len(self.damage) - SHOWN} places more; --json lists them")
        if self.refused:
            said.append(f"journal: {self.refused}")
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
            event = event_of(*message.event())
            if isinstance(event, Record) and "number" not in event.unknown:
                records.add(event.number)
    steps, refused = _steps(folder)
    return Survey(
        str(folder), tuple(path.name for path in reader.segments), tuple(reader.unfinished), tuple(reader.damage),
        reader.counts, tuple(sorted(records)), (last_ns - (first_ns or 0)) / NS, has_manifest,
        steps, refused,
    )  # fmt: skip


def _steps(folder: Path) -> tuple[int, str]:
    """Return how many steps the journal has, and why it cannot be read, "" if it can."""
    try:
        return len(read_journal(folder).entries), ""
    except InputError as error:
        return 0, str(error)


def resume_session(folder: Path, event: Resume, *, t_mono_ns: int) -> SessionWriter:
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
        OsFiles(),
        t_mono_ns=t_mono_ns,
        segment=last + 1,
        chain=bytes.fromhex(reader.sha256),
        sequence=reader.next_sequence,
        topics=topics,
    )
    writer.event(event.kind, t_mono_ns, replace(event, segment=last + 1).document())
    writer.flush()
    return writer
