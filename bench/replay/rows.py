"""Decodes the raw bytes of a session again and cuts its records anew: nothing but the session is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.frame import FrameDefinition, LinkCounts, LinkDecoder, parse_frame, signal_of
from bench.model.errors import InputError, SessionDamaged
from bench.model.events import Event, Resume, event_of
from bench.model.quantities import Values
from bench.plan import is_measurement
from bench.record import Block, Damage, RecordCutter, RecordedReadings, RecordRow, SessionReader, layout
from bench.replay.parts import Part, RecordedWindow, Splice, moved_rows, recorded_windows, splices_of, time_shifts_ns

BATCH_BYTES = 4_000_000
_BESIDE = frozenset({layout.EVENT, layout.CLOCK})


@dataclass(frozen=True)
class Replayed:
    """A session whose bytes were decoded again.

    ``rows``: all records that count, by number; ``counts``: totals by link; ``events``: (t_mono_ns, event) in
    order; ``damage``: what could not be read; ``notes``: sentences about anything that differs from the recording.
    ``splices``: where the run was gone on with after a stop; times and counters behind them are those of the first part
    (bench.replay.parts). ``utc_offset_ns``: UTC minus the time of that part, None without a clock pair.
    """

    manifest: Values
    texts: Mapping[str, str]
    rows: tuple[RecordRow, ...]
    counts: Mapping[str, LinkCounts]
    events: list[tuple[int, Event]]
    session_sha256: str
    damage: tuple[Damage, ...]
    unfinished: tuple[str, ...]
    notes: tuple[str, ...]
    splices: tuple[Splice, ...] = ()
    utc_offset_ns: int | None = None

    @property
    def measurement_rows(self) -> list[RecordRow]:
        """The records an analysis sees: those without a purpose of their own, such as a wiring check."""
        return [row for row in self.rows if is_measurement(row.window.conditions)]

    @property
    def totals(self) -> dict[str, int]:
        """Frames of all links: good, bad, lost; and jumps of unknown size of their counters."""
        return sum(self.counts.values(), LinkCounts()).totals


def replay_rows(folder: Path, *, strict: bool = False, of_several: bool = False) -> Replayed:
    """Decode a session again.

    Args:   folder: the session. strict: refuse a damaged one instead of using what is whole. of_several: read one that
            several units share, too: its events, without a record.
    Raises: InputError B-REC-010 (no session), B-RPL-001 (a record on a link without a frame definition),
            B-RPL-007 (several units share it, and ``of_several`` is false);
            SessionDamaged B-REC-011 (strict and damaged), B-REC-012 (no manifest), B-RPL-002 (frame text missing),
            B-RPL-003 (incomplete record event).
    """
    reader = SessionReader(folder, strict=strict)
    manifest, texts = reader.manifest, reader.texts
    events_alone = of_several and bool(manifest.get("units"))
    if not events_alone:
        refuse_several(manifest, folder)
    definitions = {} if events_alone else _definitions(folder, manifest, texts)
    windows = [] if events_alone else recorded_windows(reader.select(frozenset({"/event"})))
    for item in windows:
        if item.window.link and item.window.link not in definitions:
            raise InputError(
                "B-RPL-001",
                f"record {item.window.number} is on the link {item.window.link!r}, which has no frame",
                where=str(folder),
                next_step="name the link and its frame file in the manifest under 'links'",
            )
    replay = _Replay(definitions, windows)
    for block in reader.blocks(frozenset({*_BESIDE, *replay.topics})):
        replay.take(block)
    replay.end_part()
    replay.keep_readings()
    shifts_ns = time_shifts_ns(replay.parts)
    events = [(t_ns + shifts_ns[part], event) for part, t_ns, event in replay.events]
    notes = _notes(manifest, definitions, replay.counts)
    return Replayed(
        manifest, texts, tuple(moved_rows(replay.rows.values(), shifts_ns)), replay.counts, events,
        reader.sha256, tuple(reader.damage), tuple(reader.unfinished), tuple(notes),
        splices_of(events, replay.parts), replay.parts[0].offset_ns,
    )  # fmt: skip


def refuse_several(manifest: Values, folder: Path) -> None:
    """Raise InputError B-RPL-007 for a session that several units share: whatever is computed is of one unit."""
    serials = [str(unit["serial"]) for unit in manifest.get("units", ())]
    if serials:
        raise InputError(
            "B-RPL-007",
            f"the session is of {len(serials)} units ({', '.join(serials)}), and this is done for one",
            where=str(folder),
            next_step=f"'bench export {folder} --unit {serials[0]} --to session' writes the session of one unit",
        )


def _definitions(folder: Path, manifest: Values, texts: Mapping[str, str]) -> dict[str, FrameDefinition]:
    definitions = {}
    for link, name in sorted(manifest.get("links", {}).items()):
        if name not in texts:
            raise SessionDamaged(
                "B-RPL-002",
                f"the frame definition {name!r} of link {link!r} is not in the session",
                where=str(folder),
                next_step="'bench recover' lists what the session still holds",
            )
        definitions[link] = parse_frame(texts[name], name)
    return definitions


def _notes(manifest: Values, definitions: Mapping[str, FrameDefinition], counts: Mapping[str, LinkCounts]) -> list[str]:
    recorded = manifest.get("frame_sha256", {})
    jumps = [
        f"The counter of {link} jumped by more than it can tell, {count.jumps} times: how many frames are missing "
        "there is not known; they are not among the lost."
        for link, count in counts.items()
        if count.jumps
    ]
    return jumps + [
        f"The frame definition of {link} is understood differently today: recorded {recorded[link][:12]}, "
        f"now {definition.sha256[:12]}."
        for link, definition in definitions.items()
        if link in recorded and recorded[link] != definition.sha256
    ]


def _inside(at: NDArray[np.intp], begin: int, stop: int) -> NDArray[np.intp]:
    """Return those of some places that lie in [begin, stop)."""
    return at[np.searchsorted(at, begin) : np.searchsorted(at, stop)]


@dataclass
class _Replay:
    """Links and cutters of one part of a session; a resume starts a new part with fresh decoders.

    ``rows`` by number and ``events`` with their times in order, each with the part it belongs to.
    """

    definitions: Mapping[str, FrameDefinition]
    windows: list[RecordedWindow]
    rows: dict[int, tuple[int, RecordRow]] = field(default_factory=dict)
    counts: dict[str, LinkCounts] = field(default_factory=dict)
    events: list[tuple[int, int, Event]] = field(default_factory=list)
    parts: list[Part] = field(default_factory=lambda: [Part()])

    def __post_init__(self) -> None:
        self.topics = {f"{layout.LINK}{link}/rx": link for link in self.definitions}
        self._begin()

    def _begin(self) -> None:
        self._decoders = {link: LinkDecoder(definition) for link, definition in self.definitions.items()}
        self._cutters: dict[str, RecordCutter] = {}
        for item in self.windows:
            link = item.window.link
            if item.part == len(self.parts) - 1 and link:
                if link not in self._cutters:
                    self._cutters[link] = RecordCutter(self.definitions[link])
                self._cutters[link].open(
                    item.window, until_ns=item.until_ns, timed=item.timed, sampled=item.sampled,
                    chained=item.chained, signals=[signal_of(name, self.definitions) for name in item.signals],
                )  # fmt: skip

    def take(self, block: Block) -> None:
        """Take the next messages of the session."""
        begin = 0
        for place, message in block.placed(_BESIDE):
            if message.topic == layout.CLOCK:
                self.parts[-1].pair(message)
                continue
            event = event_of(*message.event())
            if isinstance(event, Resume):
                self._push(block, begin, place)
                begin = place
                self.end_part()
                self.parts.append(Part())
                self._begin()
            self.events.append((len(self.parts) - 1, message.t_ns, event))
        self._push(block, begin, len(block))

    def _push(self, block: Block, begin: int, stop: int) -> None:
        """Queue what the links said in some of the messages of a block."""
        self.parts[-1].see(block.t_ns[_inside(block.among(frozenset({*_BESIDE, *self.topics})), begin, stop)])
        for topic, link in self.topics.items():
            at = _inside(block.among(frozenset({topic})), begin, stop)
            self._decoders[link].push_all(block.payloads(at))
        if sum(decoder.pending_bytes for decoder in self._decoders.values()) >= BATCH_BYTES:
            self._decode()

    def _decode(self) -> None:
        """Decode what is queued, links without records first: their frames are the context of the others."""
        for link in sorted(self._decoders, key=lambda name: (name in self._cutters, name)):
            batch = self._decoders[link].flush()
            for other, cutter in self._cutters.items():
                if other == link:
                    cutter.feed(batch)
                    self._keep(cutter.finished())
                else:
                    cutter.feed_context(batch, link)

    def keep_readings(self) -> None:
        """Keep the records that are made of readings; every event is known by now."""
        for part in {item.part for item in self.windows if not item.window.link}:
            recorded = RecordedReadings((t_ns, event) for of_part, t_ns, event in self.events if of_part == part)
            self.rows |= {
                item.window.number: (part, recorded.row(item.window))
                for item in self.windows
                if item.part == part and not item.window.link
            }

    def _keep(self, rows: list[RecordRow]) -> None:
        self.rows.update({row.window.number: (len(self.parts) - 1, row) for row in rows})

    def end_part(self) -> None:
        """Decode what is left; records that are still open end here, complete or not."""
        self._decode()
        for cutter in self._cutters.values():
            self._keep(cutter.close_all())
        for link, decoder in self._decoders.items():
            self.counts[link] = self.counts.get(link, LinkCounts()) + decoder.counts
