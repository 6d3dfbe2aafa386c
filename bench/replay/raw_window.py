"""Single readings of a short window: only the chunks that touch it are read, through today's decoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.frame import BENCH, FrameDefinition, LinkDecoder, MessageBatch, Signal, columns, of_message, signal_of
from bench.model.clock import NS
from bench.record import (
    FOLDER,
    FrameTimes,
    Part,
    TrendReader,
    TrendRows,
    TrendWindow,
    concatenated,
    joined,
    layout,
    read_head,
)
from bench.replay.raw_segments import Stretch, stretches
from bench.replay.session_head import session_frames

MARGIN_S = 2.0  # before and behind the window: frames cut by a chunk, and stamps that are later than their frames
STANDS_S = 0.5  # how long a reading stands on the way to the next one
PERIODS = 3.0
BENCH_STANDS_S = 2.0

Pieces = dict[tuple[str, str], list[TrendRows]]  # by link and message; times in ns


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
    for (link, message), found in pieces.items():
        rows = concatenated(found)
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
                rows = _with_gaps(batch, t_utc_ns, columns(signals, link, batch))
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
    """Temperatures of the bench as the trend has them."""
    places = [place for place, signal in enumerate(signals) if signal.link == BENCH]
    if not places or read_head(trend / FOLDER) is None:
        return []
    names = [signals[place].name for place in places]
    window = TrendReader(trend).window(names, t0_utc_s, t1_utc_s, max(1, round(t1_utc_s - t0_utc_s) + 2))
    start_ns = np.round(np.maximum(window.t_utc_s, t0_utc_s) * NS).astype(np.int64)
    return [Part(places, TrendRows(start_ns, window.low, window.high), BENCH_STANDS_S)]
