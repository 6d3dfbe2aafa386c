"""Records of a ring laser: blocks of edges by ``struct``, word for word as docs and frames/time_tags.yaml say."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.analysis import Material
from bench.model.arrays import Floats, Integers, Octets
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record import RecordRow, Samples
from sim_instruments.worlds.lock_in.core import AT_ONCE, BEAT, PICK_OFF, RingLaser, levels
from sim_instruments.worlds.lock_in.crossings import Crossings, crossings
from sim_instruments.worlds.lock_in.half_cycles import integrate

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


@dataclass(frozen=True)
class Edges:
    """Edges in order of time, and what nobody can measure.

    ``t_s``: (n,) seconds.   ``channel``: BEAT or PICK_OFF.   ``level``: of that channel behind the edge, 1 = risen; the
    pick-off is high while the dither's angle is positive, so it rises where the rate is most positive.
    ``cosine``: level of the comparator of cos(psi).   ``count``: floor(psi / pi) behind the edge, truth.
    ``phase_rad``: psi at the pick-off's edges and at the end, (halves + 1,), truth.
    ``dither_deg_s``: amplitude of each half cycle, (halves,), truth.
    """

    t_s: Floats
    channel: Octets
    level: Octets
    cosine: Octets
    count: Integers
    phase_rad: Floats
    dither_deg_s: Floats


def simulated_edges(laser: RingLaser, seconds: float, rng: np.random.Generator, psi_rad: float = 0.0) -> Edges:
    """Return the edges of the comparators from a maximum of the velocity on, over whole half cycles of the dither.

    Args: seconds: how long, rounded to half cycles.   rng: of all noise.   psi_rad: phase at t = 0.
    """
    total, parts = round(seconds / laser.half_s), []
    for first in range(0, total, AT_ONCE):
        n = min(AT_ONCE, total - first)
        dither_deg_s = laser.dither_deg_s * (1.0 + laser.dither_noise * rng.standard_normal(n))
        noise = rng.standard_normal((n, laser.steps)) if laser.quantum_deg_rt_h else None
        drive = laser.drive(dither_deg_s, 1 - 2 * (first % 2), noise, laser.beta_rad)
        motion = integrate(drive, psi_rad)
        disturbed = laser.beat_noise * rng.standard_normal((n, laser.steps)) if laser.beat_noise else None
        found = crossings(drive, motion, disturbed)
        parts.append(_edges(laser, first, dither_deg_s, motion.start_rad, found))
        psi_rad = motion.end_rad
    return _joined(parts, psi_rad)


def _edges(laser: RingLaser, first: int, dither_deg_s: Floats, start_rad: Floats, found: Crossings) -> Edges:
    halves = np.arange(len(start_rad))
    half, order = ordered(halves, found)
    t_s = (first + half) * laser.half_s + np.concatenate([np.zeros(len(halves)), found.since_s])[order]
    channel = np.concatenate([np.full(len(halves), PICK_OFF), np.full(len(found.half), BEAT)]).astype(np.uint8)
    level, cosine = levels((first + halves) % 2 == 0, start_rad, found)
    count = np.concatenate([np.floor(start_rad / np.pi).astype(np.int64), found.count])
    return Edges(t_s, channel[order], level[order], cosine[order], count[order], start_rad, dither_deg_s)


def ordered(halves: Integers, found: Crossings) -> tuple[Integers, Integers]:
    """Half cycle of each edge in order of time, and the order: pick-off edges stand before the beat's at first."""
    half = np.concatenate([halves, found.half])
    since_s = np.concatenate([np.zeros(len(halves)), found.since_s])
    order = np.lexsort((since_s, half))
    return half[order], order


def _joined(parts: list[Edges], end_rad: float) -> Edges:
    names = ("t_s", "channel", "level", "cosine", "count")
    whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    phase_rad = np.append(np.concatenate([part.phase_rad for part in parts]), end_rad)
    return Edges(**whole, phase_rad=phase_rad, dither_deg_s=np.concatenate([part.dither_deg_s for part in parts]))
