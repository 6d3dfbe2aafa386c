"""Events of a time tagger out of the blocks of a record: ticks, levels and channels, in stretches without a gap.

The wire format is that of ``frames/time_tags.yaml``: an event is a u32, bit 0 the level of its channel behind the edge,
bit 1 the level of the cosine comparator, bit 2 the channel (0 beat, 1 pick-off), bits 3 to 31 ticks since the beginning
of the block.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.model.errors import FitError

if TYPE_CHECKING:
    from bench.record import RecordRow, Samples

Int64 = NDArray[np.int64]
Bools = NDArray[np.bool_]
COLUMNS = ("tick", "clock", "dropped", "edges", "events")
_LEVEL, _COSINE, _CHANNEL, _SHIFT = np.uint32(1), np.uint32(2), np.uint32(4), np.uint32(3)
_BYTES = 4  # of an event


@dataclass(frozen=True)
class Stretch:
    """Events between two gaps, in order of time.

    ``ticks``: of the beat's edges, (n,), of the tagger's clock, from its beginning.   ``rising``, ``cosine``: level of
    the beat behind the edge and of the cosine comparator, (n,).   ``pickoff_ticks``, ``pickoff_rising``: of the dither
    pick-off, (m,).   ``begin_tick``: of the first block; all ticks count from it.
    """

    begin_tick: int
    ticks: Int64
    rising: Bools
    cosine: Bools
    pickoff_ticks: Int64
    pickoff_rising: Bools


@dataclass(frozen=True)
class Events:
    """Stretches of one record and what was lost between them.

    ``clock_Hz``: of the tagger, nominal.   ``lost_blocks``: that never arrived or arrived damaged.   ``lost_edges``:
    that the tagger itself dropped.   ``torn``: blocks left out because edges are missing in them.   ``dark``: blocks
    without any edge: there was no beat.
    """

    clock_Hz: float
    stretches: tuple[Stretch, ...]
    lost_blocks: int
    lost_edges: int
    torn: int
    dark: int = 0


def record_events(row: RecordRow) -> Events:
    """Decode every event of one record.

    A missing block, one in which the tagger dropped edges, and one without any edge (a dithered laser that beats has
    hundreds in each) ends a stretch: nothing is bridged, because the number of edges in between is not known.

    Raises: FitError B-RLG-001 (no samples), B-RLG-002 (another frame), B-RLG-003 (the clock changes inside the record).
    """
    samples, where = row.samples, f"record {row.window.number}"
    if samples is None or not len(samples):
        raise FitError(
            "B-RLG-001",
            "it holds no block of events",
            where=where,
            next_step="give the record 'samples: true' on the link of the time tagger, and start the tagger before it",
        )
    unknown = [name for name in COLUMNS if name not in samples.columns]
    if unknown:
        raise FitError(
            "B-RLG-002",
            f"its frames carry no {', '.join(unknown)}: they are not blocks of a time tagger",
            where=where,
            next_step="record the link whose frame is 'time_tags'",
        )
    clocks = np.unique(samples.columns["clock"].astype(np.int64))
    if clocks.size > 1:
        raise FitError(
            "B-RLG-003",
            f"the clock of the tagger changes inside it: {', '.join(str(one) for one in clocks)} Hz",
            where=where,
            next_step="configure the tagger before the record begins, not while it runs",
        )
    return _events(samples, float(clocks[0]), row.lost)


def _events(samples: Samples, clock_Hz: float, lost_blocks: int) -> Events:
    tick = samples.columns["tick"].astype(np.int64)
    dropped = samples.columns["dropped"].astype(np.int64)
    edges = samples.columns["edges"].astype(np.int64)
    blobs = samples.columns["events"]
    more = np.diff(dropped, prepend=dropped[:1])
    sizes = np.array([len(one) for one in blobs], np.int64)
    whole = (more == 0) & (sizes == _BYTES * edges)
    whole[0] &= bool(dropped[0] == 0)  # nobody knows in which block the earlier ones were lost
    dark = whole & (edges == 0)
    torn, whole = ~whole, whole & ~dark
    joint = (np.diff(samples.counter) == 1) & (np.diff(tick) > 0) & whole[1:] & whole[:-1]
    starts = np.flatnonzero(np.concatenate(([True], ~joint)))
    ends = np.concatenate((starts[1:], [tick.size]))
    found = tuple(
        _stretch(tick[a:b], edges[a:b], b"".join(blobs[a:b].tolist()))
        for a, b in zip(starts.tolist(), ends.tolist(), strict=True)
        if whole[a]
    )
    return Events(clock_Hz, found, lost_blocks, int(more[more > 0].sum()), int(torn.sum()), int(dark.sum()))


def _stretch(tick: Int64, edges: Int64, joined: bytes) -> Stretch:
    words = np.frombuffer(joined, "<u4")
    ticks = np.repeat(tick - tick[0], edges) + (words >> _SHIFT).astype(np.int64)
    pickoff = (words & _CHANNEL) != 0
    rising = (words & _LEVEL) != 0
    beat = ~pickoff
    return Stretch(
        int(tick[0]), ticks[beat], rising[beat], (words[beat] & _COSINE) != 0, ticks[pickoff], rising[pickoff]
    )
