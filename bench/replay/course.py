"""What happened in a session, on one time axis, and the frames of a link with their times; no record is cut.

The axis is that of ``replay_rows``: monotonic time of the first part, behind which the later parts are laid.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame import FrameDefinition, LinkDecoder, MessageBatch
from bench.model.events import Resume
from bench.record import FrameTimes, SessionReader, layout
from bench.replay.history import MARGIN_S, PERIODS, stretches
from bench.replay.parts import Part, time_shifts_ns

BLOCK_BYTES = 1_000_000
LATEST_S = 4e9  # later than any clock of a bench


@dataclass(frozen=True)
class Course:
    """Events of a session, (t_mono_ns, kind, fields) in order, and what is added to the times of each of its parts.

    ``utc_offset_ns``: UTC minus monotonic time; 0 for a session without a clock pair, whose UTC nobody knows.
    """

    events: list[tuple[int, str, Mapping[str, Any]]]
    shifts_ns: list[int]
    utc_offset_ns: int


def read_course(folder: Path) -> Course:
    """Return what happened in a session; no frame is decoded.

    Raises: InputError B-REC-010 (no session); SessionDamaged B-REC-013, B-REC-014.
    """
    reader = SessionReader(folder)
    events = [(message.t_ns, *message.event()) for message in reader.select(frozenset({layout.EVENT}))]
    parts = _parts(reader, any(kind == Resume.kind for _, kind, _ in events))
    shifts_ns = time_shifts_ns(parts)
    part, placed = 0, list[tuple[int, str, Mapping[str, Any]]]()
    for t_ns, kind, fields in events:
        part += kind == Resume.kind
        placed.append((t_ns + shifts_ns[part], kind, fields))
    return Course(placed, shifts_ns, parts[0].offset_ns or 0)


def _parts(reader: SessionReader, resumed: bool) -> list[Part]:
    """Return the parts of a session; of one that was never resumed only its first clock pair is looked for."""
    parts = [Part()]
    for message in reader.select(frozenset({layout.CLOCK, layout.EVENT} if resumed else {layout.CLOCK})):
        if message.topic == layout.EVENT:
            if message.event()[0] == Resume.kind:
                parts.append(Part())
        else:
            parts[-1].pair(message)
            if not resumed:
                break
        parts[-1].see(np.array([message.t_ns], np.uint64))
    return parts


@dataclass(frozen=True)
class DecodedFrames:
    """Frames of one message, (n,), and their times, (n,) ns on the axis of the session: they may come twice."""

    batch: MessageBatch
    t_mono_ns: NDArray[np.int64]


def decoded_frames(
    folder: Path, link: str, definition: FrameDefinition, course: Course, window_s: tuple[float, float] | None = None
) -> Iterator[DecodedFrames]:
    """Yield the frames of a link by the block, each message for itself; memory does not grow with the session.

    Frames of one receive stamp are laid back from it by the frame period. Only chunks that touch the window are read.

    Args:   window_s: UTC of the first and last frame, s; what lies a little outside of it is yielded too. None: all.
    Raises: InputError B-REC-010 (no session); SessionDamaged B-REC-013.
    """
    first_s, last_s = window_s or (0.0, LATEST_S)
    margin_s = MARGIN_S + PERIODS / (definition.rate_Hz or 1.0)
    offsets_ns = [course.utc_offset_ns + shift_ns for shift_ns in course.shifts_ns]
    decoder, times, part = LinkDecoder(definition), FrameTimes(definition), -1
    topics = frozenset({f"{layout.LINK}{link}/rx"})
    for stretch in stretches(folder, folder, first_s, last_s, margin_s, offsets_ns):
        if stretch.part != part:
            yield from _flushed(decoder, times, course, part, last=True)
            decoder, times, part = LinkDecoder(definition), FrameTimes(definition), stretch.part
        for message in stretch.chunks.messages(stretch.places, topics):
            decoder.push(message.t_ns, message.payload)
            if decoder.pending_bytes >= BLOCK_BYTES:
                yield from _flushed(decoder, times, course, part)
    yield from _flushed(decoder, times, course, part, last=True)


def _flushed(
    decoder: LinkDecoder, times: FrameTimes, course: Course, part: int, last: bool = False
) -> Iterator[DecodedFrames]:
    for name, batch in (decoder.finish() if last else decoder.flush()).messages.items():
        if len(batch) and batch.t_ns is not None:
            yield DecodedFrames(batch, times.of(name, batch.t_ns) + course.shifts_ns[part])
