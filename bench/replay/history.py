"""The history of a session in a window: single readings where there is room, else least and greatest values.

For single readings only the chunks that touch the window are read, and they go through today's decoder.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.frame import (
    BENCH,
    FrameDefinition,
    LinkDecoder,
    MessageBatch,
    Signal,
    columns,
    of_message,
    signal_of,
    trailing_means,
)
from bench.model.clock import NS
from bench.model.events import Resume
from bench.model.segments import segment_files
from bench.record import (
    FOLDER,
    HEAD,
    OPEN_MARKER,
    ChunkPlace,
    FrameTimes,
    Part,
    SegmentChunks,
    TrendReader,
    TrendRows,
    TrendWindow,
    concatenated,
    joined,
    layout,
    read_head,
)
from bench.replay.build_trend import build_trend
from bench.replay.described import session_frames

RAW_S_PER_POINT = 0.02  # 20 s on 1000 points: two readings of 100 Hz on each
STALE_S = 600.0  # a trend made of a session that is still written is made again then
_LOOKED_AT = 30  # chunks of a part in which its first clock pair is looked for
MARGIN_S = 2.0  # before and behind the window: frames cut by a chunk, and stamps that are later than their frames
STANDS_S = 0.5  # how long a reading stands on the way to the next one
PERIODS = 3.0
BENCH_STANDS_S = 2.0
Pieces = dict[tuple[str, str], list[TrendRows]]  # by link and message; times in ns


def history(
    folder: Path, names: Sequence[str], t0_utc_s: float, t1_utc_s: float, n: int, cache: Path | None = None
) -> TrendWindow:
    """Return points of some signals in a window.

    Args:   n: points a figure has room for.   cache: where the trend is made of a session that has none; this takes
            a while, so not in a process that people wait for.
    Raises: InputError B-FRAME-024 (no such signal), B-REC-010 (no session), B-REC-030 (no trend, and no cache);
            SessionDamaged B-REC-012; OSError if the cache cannot be written.
    """
    trend = trend_place(folder, cache)
    if t1_utc_s - t0_utc_s < RAW_S_PER_POINT * n:
        return raw_window(folder, names, t0_utc_s, t1_utc_s, trend)
    if trend is not None and needs_build(folder, trend):
        build_trend(folder, trend)
    return TrendReader(trend or folder).window(names, t0_utc_s, t1_utc_s, n)


def trend_place(folder: Path, cache: Path | None = None) -> Path | None:
    """Return the session itself if it has its trend, else its folder in the cache."""
    if read_head(folder / FOLDER) is not None:
        return folder
    return None if cache is None else cache / folder.name


def needs_build(folder: Path, trend: Path) -> bool:
    """Return whether a trend outside its session is not there, or older than the session."""
    if trend == folder:
        return False
    if read_head(trend / FOLDER) is None:
        return True
    newest_s = max((path.stat().st_mtime for path in segment_files(folder)), default=0.0)
    patience_s = STALE_S if (folder / OPEN_MARKER).exists() else 0.0
    return newest_s - (trend / FOLDER / HEAD).stat().st_mtime > patience_s


@dataclass(frozen=True)
class Stretch:
    """Chunks of one segment in a window. ``part``: number of the part of the session they belong to."""

    part: int
    offset_ns: int
    chunks: SegmentChunks
    places: list[ChunkPlace]


def stretches(
    folder: Path, trend: Path, t0_utc_s: float, t1_utc_s: float, margin_s: float, offsets_ns: Sequence[int] = ()
) -> Iterator[Stretch]:
    """Yield chunks with messages in a window, ``margin_s`` more on both sides, segment by segment.

    ``trend``: where the trend of the session lies; it knows best what UTC each part of the session is, unless
    ``offsets_ns`` says it (UTC minus monotonic time of each part).
    Other software may resume inside a segment; the bench begins a new one, and that is what is looked for here.
    """
    head = read_head(trend / FOLDER)
    known = offsets_ns or (() if head is None else head.offsets_ns)
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
        following = next((start for start in starts[index + 1 :] if start is not None), None)
        until_ns = following[0] if following is not None and not following[1] else None
        low_ns, high_ns = (round((t - offset_ns / NS) * NS) for t in (t0_utc_s - margin_s, t1_utc_s + margin_s))
        if start_ns > high_ns or (until_ns is not None and until_ns < low_ns):
            continue
        chunks = SegmentChunks(path)
        places = [place for place in chunks.places if place.end_ns >= low_ns and place.start_ns <= high_ns]
        if places:
            yield Stretch(part, offset_ns, chunks, places)


def _first_chunk(path: Path) -> tuple[int, bool] | None:
    """Return monotonic time of a segment's first message, and whether a part of the session begins with it."""
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
    return chunks.places[0].start_ns, first is not None and first.event()[0] == Resume.kind


def _offset_ns(path: Path) -> int:
    """Return UTC minus monotonic time by the first clock pair of a segment; 0 if it has none near its begin."""
    chunks = SegmentChunks(path)
    for message in chunks.messages(list(islice(chunks.places, _LOOKED_AT)), frozenset({layout.CLOCK})):
        pair = message.document()
        return int(pair["t_utc_ns"]) - int(pair["t_mono_ns"])
    return 0


def raw_window(
    folder: Path, names: Sequence[str], t0_utc_s: float, t1_utc_s: float, trend: Path | None = None
) -> TrendWindow:
    """Return every reading of some signals in a window; ``bucket_s`` is 0, least and greatest value are the same.

    Receive stamps are those of a chunk of bytes: frames of one stamp are laid back from it by the frame period, so
    that a curve is a curve. A row of NaN stands where the counter misses frames. Temperatures of the bench, which are
    read once a minute, stand as the trend has them, second by second.

    Args:   folder: the session.   trend: where its trend lies, if not with it.
    Raises: InputError B-FRAME-024 (no such signal), B-REC-010 (no session); SessionDamaged B-REC-012.
    """
    frames = session_frames(folder)
    signals = [signal_of(name, frames) for name in names]
    links = sorted({signal.link for signal in signals} - {BENCH})
    periods_s = {link: 1.0 / (frames[link].rate_Hz or 1.0) for link in links}
    margin_s = max([MARGIN_S, *(1.5 * period_s for period_s in periods_s.values())])
    pieces: Pieces = {}
    for stretch in stretches(folder, trend or folder, t0_utc_s, t1_utc_s, margin_s) if links else ():
        _decode(stretch, {link: frames[link] for link in links}, signals, pieces)
    span_ns = round(t0_utc_s * NS), round(t1_utc_s * NS)
    parts = []
    for (link, message), batches in pieces.items():
        rows = concatenated(batches)
        inside = slice(*np.searchsorted(rows.start_s, (span_ns[0], span_ns[1] + 1)))
        rows = TrendRows(rows.start_s[inside], rows.low[inside], rows.high[inside]).merged(1)
        chosen = of_message(signals, link, message)
        places = [place for place, signal in enumerate(signals) if signal in chosen]
        parts.append(Part(places, rows, max(STANDS_S, PERIODS * periods_s[link])))
    parts += _of_bench(trend or folder, signals, t0_utc_s, t1_utc_s)
    gap_s = max(STANDS_S, PERIODS * min(periods_s.values(), default=1.0))
    return joined(parts, len(signals), 0.0, gap_s, NS)


def _decode(stretch: Stretch, frames: Mapping[str, FrameDefinition], signals: Sequence[Signal], pieces: Pieces) -> None:
    """Append the rows of every message of every link."""
    decoders = {f"{layout.LINK}{link}/rx": (link, LinkDecoder(definition)) for link, definition in frames.items()}
    for message in stretch.chunks.messages(stretch.places, frozenset(decoders)):
        decoders[message.topic][1].push(message.t_ns, message.payload)
    for link, decoder in decoders.values():
        times = FrameTimes(frames[link])
        for name, batch in decoder.flush().messages.items():
            if len(batch) and batch.t_ns is not None and of_message(signals, link, name):
                t_utc_ns = times.of(name, batch.t_ns) + stretch.offset_ns
                values = columns(signals, link, batch)
                values = trailing_means(t_utc_ns, of_message(signals, link, name), values)
                rows = _with_gaps(batch, t_utc_ns, values)
                pieces.setdefault((link, name), []).append(rows)


def _with_gaps(batch: MessageBatch, t_ns: NDArray[np.int64], values: NDArray[np.float64]) -> TrendRows:
    """Return readings as rows; one of NaN in front of each frame before which the counter misses some."""
    missing = np.empty(0, np.intp)
    if batch.counter is not None and batch.message.counter is not None:
        missing = np.flatnonzero(np.diff(batch.counter) > 1) + 1
    blank_ns = (t_ns[missing - 1] + t_ns[missing]) // 2
    low = np.insert(values, missing, np.nan, axis=0).astype(np.float32)
    return TrendRows(np.insert(t_ns, missing, blank_ns), low, low)


def _of_bench(trend: Path, signals: Sequence[Signal], t0_utc_s: float, t1_utc_s: float) -> list[Part]:
    """Return temperatures of the bench as the trend has them."""
    places = [place for place, signal in enumerate(signals) if signal.link == BENCH]
    if not places or read_head(trend / FOLDER) is None:
        return []
    names = [signals[place].name for place in places]
    window = TrendReader(trend).window(names, t0_utc_s, t1_utc_s, max(1, round(t1_utc_s - t0_utc_s) + 2))
    start_ns = np.round(np.maximum(window.t_utc_s, t0_utc_s) * NS).astype(np.int64)
    return [Part(places, TrendRows(start_ns, window.low, window.high), BENCH_STANDS_S)]
