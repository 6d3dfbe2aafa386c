"""Which chunks of a session touch a window of UTC, and what UTC the times of their part are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path

from bench.model.clock import NS
from bench.model.segments import segment_files
from bench.record import FOLDER, ChunkPlace, SegmentChunks, layout, read_head
from bench.replay.windows import RESUME

_LOOKED_AT = 30  # chunks of a part in which its first clock pair is looked for


@dataclass(frozen=True)
class Stretch:
    """Chunks of one segment in a window. ``part``: number of the part of the session they belong to."""

    part: int
    offset_ns: int
    chunks: SegmentChunks
    places: list[ChunkPlace]


def stretches(folder: Path, trend: Path, t0_utc_s: float, t1_utc_s: float, margin_s: float) -> Iterator[Stretch]:
    """Chunks with messages in a window, ``margin_s`` more on both sides, segment by segment.

    ``trend``: where the trend of the session lies; it knows best what UTC each part of the session is.
    Other software may resume inside a segment; the bench begins a new one, and that is what is looked for here.
    """
    head = read_head(trend / FOLDER)
    known = () if head is None else head.offsets_ns
    segments = segment_files(folder)
    starts = [_first_chunk(path) for path in segments]
    part, offset_ns = -1, 0
    for index, (path, start) in enumerate(zip(segments, starts, strict=True)):
        if start is None:
            continue
        start_ns, resumes = start
        if part < 0 or resumes:
            part += 1
            offset_ns = known[part] if part < len(known) else _offset_ns(path)
        following = next((one for one in starts[index + 1 :] if one is not None), None)
        until_ns = following[0] if following is not None and not following[1] else None
        low_ns, high_ns = (round((t - offset_ns / NS) * NS) for t in (t0_utc_s - margin_s, t1_utc_s + margin_s))
        if start_ns > high_ns or (until_ns is not None and until_ns < low_ns):
            continue
        chunks = SegmentChunks(path)
        places = [one for one in chunks.places if one.end_ns >= low_ns and one.start_ns <= high_ns]
        if places:
            yield Stretch(part, offset_ns, chunks, places)


def _first_chunk(path: Path) -> tuple[int, bool] | None:
    """Monotonic time of a segment's first message, and whether a part of the session begins with it."""
    try:
        return _begin_of(path, path.stat().st_ino)
    except LookupError:
        return None


@lru_cache(maxsize=4096)
def _begin_of(path: Path, file: int) -> tuple[int, bool]:
    """Raises: LookupError while the segment holds no chunk; its first one never changes."""
    del file  # another file at the same place is another segment
    chunks = SegmentChunks.beginning(path)
    if not chunks.places:
        raise LookupError(path)
    messages = chunks.messages(chunks.places[:1], frozenset({layout.EVENT}))
    first = next(messages, None)
    return chunks.places[0].start_ns, first is not None and first.event()[0] == RESUME


def _offset_ns(path: Path) -> int:
    """Return UTC minus monotonic time by the first clock pair of a segment; 0 if it has none near its begin."""
    chunks = SegmentChunks(path)
    for message in chunks.messages(list(islice(chunks.places, _LOOKED_AT)), frozenset({layout.CLOCK})):
        pair = message.document()
        return int(pair["t_utc_ns"]) - int(pair["t_mono_ns"])
    return 0
