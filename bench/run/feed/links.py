"""How the links of a living run are, without asking them anything: nothing is read, decoded or locked."""

from __future__ import annotations

import math
from typing import Any

from bench.model.clock import NS, to_ns
from bench.run.context import RunContext
from bench.run.links.reader import LinkReader
from bench.run.links.status import silence_s

DECODED_S = 62.0  # a rehearsal decodes that seldom: what it received since then may be frames


def links_of(context: RunContext, now_ns: int) -> dict[str, dict[str, Any]]:
    """Return all links by name, as in docs/live-protocol.md."""
    stale = context.health.values()
    return {
        name: _link(reader, now_ns, bool(stale.get(f"{name}_stale")), virtual=context.clock.virtual)
        for name, reader in context.acquisition.readers.items()
    }


def _link(reader: LinkReader, now_ns: int, stale: bool, *, virtual: bool) -> dict[str, Any]:
    counts, rate_Hz = reader.decoder.counts, reader.rate_Hz
    newest_ns = reader.last_frame_ns
    undecided = virtual or reader.decoder.pending_bytes
    if newest_ns >= 0 and undecided and now_ns - newest_ns < to_ns(DECODED_S):
        newest_ns = max(newest_ns, reader.last_byte_ns)  # received, and not decoded yet
    return {
        "state": _state(reader, now_ns - newest_ns, stale and not virtual),
        "reason": reader.lost,
        "frames": counts.frames,
        "bad": counts.bad,
        "lost": counts.lost,
        "duplicate": counts.duplicate,
        "rate_Hz": None if math.isnan(rate_Hz) else round(rate_Hz, 3),
        "age_s": None if newest_ns < 0 else round(max(0, now_ns - newest_ns) / NS, 3),
    }


def _state(reader: LinkReader, age_ns: int, stale: bool) -> str:
    if reader.lost:
        return "lost"
    if reader.last_frame_ns < 0:
        return "waiting"
    if age_ns > to_ns(silence_s(reader)):
        return "silent"
    return "stale" if stale else "streaming"
