"""Records of a ring laser: which are meant for the analysis, what their conditions say, and the events in them.

The wire format is that of ``frames/time_tags.yaml``: an event is a u32, bit 0 the level of its channel behind the edge,
bit 1 the level of the cosine comparator, bit 2 the channel (0 beat, 1 pick-off), bits 3 to 31 ticks since the beginning
of the block.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Material
from bench.maths.arrays import Flags, Integers
from bench.maths.samples import seen_before
from bench.model.errors import FitError
from bench.model.quantities import Quality
from bench.systems.lock_in.wording import say

if TYPE_CHECKING:
    from bench.record import RecordRow, Samples


PATH, CLOCK, PHASE = "path_length_m", "clock_Hz", "phase_setting_deg"
_BACKSCATTER = "backscatter_phase_deg"  # as PHASE, of a campaign that does not vary it
_HARMLESS = Quality.LOST | Quality.BAD_FRAMES | Quality.DUPLICATE | Quality.STALE | Quality.SPLICE
_DITHER = "dither_amplitude_deg/s"
COLUMNS = ("tick", "clock", "dropped", "edges", "events")
_LEVEL, _COSINE, _CHANNEL, _SHIFT = np.uint32(1), np.uint32(2), np.uint32(4), np.uint32(3)
_BYTES = 4  # of an event
_STAMPS = 10_000  # of each stretch that tell the step of the time stamps
_UNLIKE = 100  # edges of a block that never come the same way twice
_BLOCKS = 100  # of the tagger that are decoded at once


@dataclass(frozen=True)
class LaserRecord:
    """A record and the laser it is of. ``several``: another record has the same path, clock and phase setting.

    ``events``: decodes them. Raises: FitError B-RLG-001 to -003.
    """

    row: RecordRow
    events: Callable[[], Events]
    path_length_m: float
    phase_setting_deg: float | None
    several: bool = False

    @property
    def number(self) -> int:
        """Of the record in its session."""
        return self.row.window.number

    @property
    def blocks(self) -> int:
        """Blocks of the tagger."""
        return self.row.frames

    def sensed(self, name: str) -> float | None:
        """Return the mean of the housekeeping over the record, None if the record has no housekeeping."""
        value = self.row.context.get(name)
        return None if value is None else float(value)

    @property
    def backscatter_deg(self) -> float | None:
        """Backscatter phase that the mirrors are set to, None if the conditions do not say it."""
        value = self.row.window.conditions.get(_BACKSCATTER)
        return self.phase_setting_deg if value is None else float(value)

    @property
    def dither_deg_s(self) -> float | None:
        """Mean amplitude of the dither rate by the sensor of the unit."""
        return self.sensed(_DITHER)

    def place(self, clock_Hz: float) -> dict[str, Any]:
        """Return conditions that tell its estimates from those of the others."""
        conditions: dict[str, Any] = {PATH: self.path_length_m, CLOCK: clock_Hz}
        if self.phase_setting_deg is not None:
            conditions[PHASE] = self.phase_setting_deg
        return conditions | ({"record": self.number} if self.several else {})


def laser_records(material: Material) -> list[LaserRecord]:
    """Return the records with a path length, in their order; without those that were taken again.

    Raises: FitError B-RLG-001 if there is no such record; B-RLG-006 for a path length that is not usable.
    """
    rows = [row for row in material.rows if PATH in row.window.conditions and not row.quality & Quality.RETAKEN]
    if not rows:
        raise FitError(
            "B-RLG-001",
            f"the session holds no record with the condition {PATH!r}",
            next_step=f"look at the session with 'bench recover'; records need 'samples: true', {PATH} and {CLOCK}",
        )
    times = Counter(_key(row) for row in rows)
    return [
        LaserRecord(row, partial(record_events, row), _path_m(row), _phase_deg(row), times[_key(row)] > 1)
        for row in rows
    ]


def flagged(records: Sequence[LaserRecord]) -> dict[int, str]:
    """Records that must not be used, by number, with what they are flagged for; losses of the link are no reason."""
    flags = {record.number: Quality(record.row.quality) & ~_HARMLESS for record in records}
    return {number: str(flag.name).replace("|", ", ") for number, flag in flags.items() if flag}


def not_recorded(records: Sequence[LaserRecord]) -> list[str]:
    """Combinations of path and clock that the others promise and that no record is of."""
    there = {(record.path_length_m, record.row.window.conditions.get(CLOCK)) for record in records}
    paths, clocks = ([*dict.fromkeys(column)] for column in zip(*sorted(there, key=str), strict=True))
    return [
        say("missing.no_record", path=100 * path, clock=float(clock) / 1e6)
        for path, clock in product(paths, clocks)
        if (path, clock) not in there and clock is not None
    ]


def none_usable(bad: Mapping[int, str]) -> FitError:
    """The error of a session whose records are all flagged."""
    why = ", ".join(f"record {number} {flags}" for number, flags in bad.items())
    return FitError(
        "B-RLG-008", f"every record is flagged: {why}", next_step="see what happened during them, run again"
    )


def _key(row: RecordRow) -> tuple[Any, ...]:
    return tuple(row.window.conditions.get(name) for name in (PATH, CLOCK, PHASE))


def _path_m(row: RecordRow) -> float:
    stated = row.window.conditions[PATH]
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not stated > 0:
        raise FitError(
            "B-RLG-006",
            f"its path length is {stated!r}",
            where=f"record {row.window.number}",
            next_step=f"state the optical path as a condition, for example {PATH}: 0.28 m",
        )
    return float(stated)


def _phase_deg(row: RecordRow) -> float | None:
    stated = row.window.conditions.get(PHASE)
    return None if stated is None else float(stated)


@dataclass(frozen=True)
class Stretch:
    """Events between two gaps, in order of time.

    ``ticks``: of the beat's edges, (n,), of the tagger's clock, from its beginning.   ``rising``, ``cosine``: level of
    the beat behind the edge and of the cosine comparator, (n,).   ``pickoff_ticks``, ``pickoff_rising``: of the dither
    pick-off, (m,).   ``begin_tick``: of the first block; all ticks count from it.
    """

    begin_tick: int
    ticks: Integers
    rising: Flags
    cosine: Flags
    pickoff_ticks: Integers
    pickoff_rising: Flags


@dataclass(frozen=True)
class Events:
    """Stretches of one record and what was lost between them.

    ``clock_Hz``: of the tagger, nominal.   ``lost_blocks``: that never arrived or arrived damaged.   ``lost_edges``:
    that the tagger itself dropped.   ``torn``: blocks left out because edges are missing in them.   ``dark``: blocks
    without any edge: there was no beat.   ``repeated``: blocks left out because they are those of another one, edge by
    edge.   ``step_ticks``: of which all time stamps are multiples.
    """

    clock_Hz: float
    stretches: tuple[Stretch, ...]
    lost_blocks: int
    lost_edges: int
    torn: int
    dark: int = 0
    repeated: int = 0
    step_ticks: int = 1


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
            f"the clock of the tagger changes inside it: {', '.join(str(clock) for clock in clocks)} Hz",
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
    sizes = np.array([len(blob) for blob in blobs], np.int64)
    whole = (more == 0) & (sizes == _BYTES * edges)
    whole[0] &= bool(dropped[0] == 0)  # nobody knows in which block the earlier ones were lost
    dark = whole & (edges == 0)
    again = seen_before(blobs) & whole & (edges >= _UNLIKE)
    torn, whole = ~whole, whole & ~dark & ~again
    joint = (np.diff(samples.counter) == 1) & (np.diff(tick) > 0) & whole[1:] & whole[:-1]
    starts = np.flatnonzero(np.concatenate(([True], ~joint)))
    ends = np.concatenate((starts[1:], [tick.size]))
    stretches = tuple(
        _stretch(tick[a:b], edges[a:b], blobs[a:b].tolist())
        for a, b in zip(starts.tolist(), ends.tolist(), strict=True)
        if whole[a]
    )
    return Events(
        clock_Hz, stretches, lost_blocks, int(more[more > 0].sum()), int(torn.sum()), int(dark.sum()),
        int(again.sum()), step_ticks(stretches),
    )  # fmt: skip


def step_ticks(stretches: Sequence[Stretch]) -> int:
    """Return the largest number of ticks that all time stamps are multiples of, from their first."""
    steps = [int(np.gcd.reduce(np.diff(stretch.ticks[:_STAMPS]))) for stretch in stretches if stretch.ticks.size > 1]
    return max(1, int(np.gcd.reduce(steps))) if steps else 1


def _stretch(tick: Integers, edges: Integers, blobs: list[bytes]) -> Stretch:
    """Decode some blocks at a time: a record of 20 s has 6 million edges."""
    parts = [slice(at, at + _BLOCKS) for at in range(0, len(blobs), _BLOCKS)]
    beats = sum(int(np.count_nonzero((_words(blobs[part]) & _CHANNEL) == 0)) for part in parts)
    ticks, rising, cosine = np.empty(beats, np.int64), np.empty(beats, np.bool_), np.empty(beats, np.bool_)
    pickoffs: list[tuple[Integers, Flags]] = []
    at = 0
    for part in parts:
        words = _words(blobs[part])
        when = np.repeat(tick[part] - tick[0], edges[part]) + (words >> _SHIFT).astype(np.int64)
        up, pickoff = (words & _LEVEL) != 0, (words & _CHANNEL) != 0
        beat = ~pickoff
        here = slice(at, at + int(np.count_nonzero(beat)))
        ticks[here], rising[here], cosine[here] = when[beat], up[beat], (words[beat] & _COSINE) != 0
        pickoffs.append((when[pickoff], up[pickoff]))
        at = here.stop
    pickoff_ticks, pickoff_rising = (np.concatenate(column) for column in zip(*pickoffs, strict=True))
    return Stretch(int(tick[0]), ticks, rising, cosine, pickoff_ticks, pickoff_rising)


def _words(blobs: list[bytes]) -> NDArray[np.uint32]:
    return np.frombuffer(b"".join(blobs), "<u4")
