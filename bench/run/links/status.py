"""How a link is: what others show of it."""

from __future__ import annotations

import math
from typing import Any, Literal

from bench.model.clock import NS, to_ns
from bench.model.units import finite
from bench.run.links.port import InstrumentLink
from bench.run.links.reader import LinkReader

SILENCE_S = 2.0  # without a good frame: the unit is silent
STALE_PERIODS = 2  # frame periods without a good frame: what is known of it is old
BUFFERED_S = 0.5  # as old may a frame be that an instrument had buffered, without being old

State = Literal["waiting", "streaming", "stale", "silent", "lost"]


def silence_s(reader: LinkReader) -> float:
    """Time without a good frame that makes a link silent, second."""
    return max(SILENCE_S, STALE_PERIODS * reader.period_s)


def age_s(reader: LinkReader, now_ns: int) -> float:
    """Time without a good frame up to the newest byte that is decoded, second; NaN before the first frame."""
    return math.nan if reader.last_frame_ns < 0 else max(0, reader.known_ns(now_ns) - reader.last_frame_ns) / NS


def is_silent(reader: LinkReader, now_ns: int, awake_ns: int = 0) -> bool:
    """Frames came, and what is decoded has had none for too long, nor since this machine is awake."""
    newest_ns = max(reader.last_frame_ns, awake_ns)
    return reader.last_frame_ns >= 0 and reader.known_ns(now_ns) - newest_ns > to_ns(silence_s(reader))


def is_stale(reader: LinkReader, now_ns: int) -> bool:
    """What is decoded has had no good frame for two frame periods, or for longer than a buffer is left alone."""
    limit_s = STALE_PERIODS * reader.period_s if reader.period_s else SILENCE_S
    if isinstance(reader.link, InstrumentLink):
        limit_s = max(BUFFERED_S, limit_s)
    return reader.last_frame_ns >= 0 and reader.known_ns(now_ns) - reader.last_frame_ns > to_ns(limit_s)


def status_of(reader: LinkReader, now_ns: int) -> dict[str, Any]:
    """Return state and totals of a link whose bytes are decoded up to now, as JSON values.

    waiting (no good frame yet), streaming, stale (none for 2 frame periods), silent (for 2 s) or lost; ``age_s``: of
    the newest good frame, None before the first.
    """
    counts = reader.decoder.counts
    return {
        "state": state_of(reader, now_ns, stale=is_stale(reader, now_ns)),
        "frames": counts.frames,
        "lost": counts.lost,
        "bad": counts.bad,
        "age_s": finite(round(age_s(reader, now_ns), 3)),
    }


def state_of(reader: LinkReader, now_ns: int, *, stale: bool) -> State:
    """Return the state of a link that is ``stale`` unless something worse is true of it."""
    if reader.lost:
        return "lost"
    if reader.last_frame_ns < 0:
        return "waiting"
    if is_silent(reader, now_ns):
        return "silent"
    return "stale" if stale else "streaming"
