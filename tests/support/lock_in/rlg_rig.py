"""Records of a ring laser for tests of the analysis: blocks of edges by ``struct``, word for word as docs and
frames/time_tags.yaml say.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.analysis import Material
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import RecordRow, Samples

SITE = {"latitude_deg": 37.0}


def block_bytes(ticks: Any, level: Any, cosine: Any, channel: Any) -> bytes:
    """Events of one block, ticks since its beginning."""
    words = [int(level[k]) | int(cosine[k]) << 1 | int(channel[k]) << 2 | int(ticks[k]) << 3 for k in range(len(ticks))]
    return struct.pack(f"<{len(words)}I", *words)


def as_row(
    columns: Mapping[str, Any], counter: Any, number: int, conditions: Mapping[str, Any], dither_deg_s: float = 100.0
) -> RecordRow:
    """A record with these samples."""
    span = int(counter[-1] - counter[0]) + 1 if len(counter) else 0
    t_ns = (counter - counter[0] if len(counter) else counter) * 10_000_000 + 10**12
    window = RecordWindow(
        number=number, link="edges", first_counter=int(counter[0]) if len(counter) else 0, frames=span,
        t_start_ns=10**12, t_end_ns=10**12 + span * 10_000_000, conditions=conditions,
    )  # fmt: skip
    samples = Samples(dict(columns), np.asarray(counter, np.int64), t_ns, dict.fromkeys(columns, (1.0, 0.0, "")))
    context = {"dither_amplitude_deg/s": dither_deg_s, "temperature_degC": 24.0}
    return RecordRow(window, {}, len(counter), span - len(counter), 0, Quality.GOOD, context, samples=samples)


def without(row: RecordRow, *blocks: int) -> RecordRow:
    """The same record with blocks that never arrived."""
    assert row.samples is not None
    kept = np.setdiff1d(np.arange(len(row.samples)), blocks)
    columns = {name: column[kept] for name, column in row.samples.columns.items()}
    return as_row(columns, row.samples.counter[kept], row.window.number, row.window.conditions)


def material(*rows: RecordRow, **campaign: Any) -> Material:
    """What an analysis sees of a session of these records."""
    stated: dict[str, Any] = {"analysis": "rlg_lock_in", "uut": {"model": "RLG", "serial": "RLG-28"}, "site": SITE}
    return Material(rows=rows, campaign=stated | campaign, standards={})
