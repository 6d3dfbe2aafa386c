"""Records of a simulated ring laser for tests of the analysis: edges to ticks to blocks by ``struct``, word for word as
docs and frames/time_tags.yaml say, and nothing of bench.fit.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from laser_edges import Edges

from bench.analysis import Material
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import RecordRow, Samples
from sim_instruments.worlds.lock_in.core import RingLaser, quantum_deg_rt_h

SITE = {"latitude_deg": 37.0}
BLOCK_s = 0.01
COLUMNS = {"tick": np.uint64, "clock": np.uint32, "dropped": np.uint32, "edges": np.uint16}


def laser(path_m: float, beta_deg: float = 90.0, **other: Any) -> RingLaser:
    """With quantum noise, as the simulated bench has it."""
    return RingLaser(path_m=path_m, beta_rad=np.radians(beta_deg), quantum_deg_rt_h=quantum_deg_rt_h(path_m), **other)


def block_bytes(ticks: Any, level: Any, cosine: Any, channel: Any) -> bytes:
    """Events of one block, ticks since its beginning."""
    words = [int(level[k]) | int(cosine[k]) << 1 | int(channel[k]) << 2 | int(ticks[k]) << 3 for k in range(len(ticks))]
    return struct.pack(f"<{len(words)}I", *words)


def row_of(edges: Edges, clock_Hz: int, number: int = 1, first_counter: int = 7, **conditions: Any) -> RecordRow:
    """A record of these edges."""
    ticks = np.floor(edges.t_s * clock_Hz).astype(np.int64)
    per_block = round(BLOCK_s * clock_Hz)
    begin_tick = 123 * per_block
    blocks = int(ticks[-1]) // per_block + 1
    at = np.searchsorted(ticks, np.arange(blocks + 1) * per_block)
    events = np.empty(blocks, object)
    for k in range(blocks):
        part = slice(at[k], at[k + 1])
        since = ticks[part] - k * per_block
        words = edges.level[part] | edges.cosine[part] << 1 | edges.channel[part].astype(np.int64) << 2 | since << 3
        events[k] = words.astype("<u4").tobytes()
    columns: dict[str, Any] = {
        "tick": (begin_tick + np.arange(blocks) * per_block).astype(np.uint64),
        "clock": np.full(blocks, clock_Hz, np.uint32),
        "dropped": np.zeros(blocks, np.uint32),
        "edges": np.diff(at).astype(np.uint16),
        "events": events,
    }
    counter = first_counter + np.arange(blocks, dtype=np.int64)
    return as_row(columns, counter, number, {"clock_Hz": clock_Hz, "item": "lock_in"} | conditions)


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
