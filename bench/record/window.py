"""Records: one while it is being cut out of frames, a finished one, and one that is made of readings of instruments.

A record of readings has no frames: its readings are events of the session.

Which frames cannot be true: a 16-bit check passes about one in 65,536 garbled frames, and the physics of a
charge-balance converter behind a gate of fixed length finds those. At each edge of its clock it gives at most one
pulse, so N plus P pulses never exceed the clock's own count; and the counts of the two clocks that make the gate agree
within 1 % over a record (real clocks do within 0.01 %, and an edge of the gate is worth one count). When pulses came is
what estimators of a rate need of the frames, without keeping the frames.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.model.arrays import Array, Flags, Floats, Integers
from bench.model.clock import NS
from bench.model.events import Event, Reading
from bench.model.ports import RecordWindow
from bench.model.quantities import Quality
from bench.record.samples import BesideKeeper, SampleKeeper, Samples, SignalKeeper, SignalValues

Columns = Mapping[str, Array]
STEADY = ("master_count", "af_clock")
CLOCK = "af_clock"
PULSES = ("npp", "ppp")
TOLERANCE = 0.01
EDGE_COUNTS = 2
TIMED = ("npp", "ppp")
_EXACT = 1 << 53  # float64 holds every whole number below


def implausible(pieces: Sequence[Columns]) -> Flags | None:
    """Return which frames of a record cannot be true; None if all can.

    Args: pieces: consecutive parts of the record, each with its count fields by name, (n,) or (n, channels).
    Returns: (frames,) bool over all parts in order, or None. Fields a frame format does not have are not judged.
    """
    if not pieces or _all_plausible(pieces):
        return None
    columns = {name: np.concatenate([piece[name] for piece in pieces]).astype(np.int64) for name in pieces[0]}
    wrong = np.zeros(len(next(iter(columns.values()))), np.bool_)
    for name in _present(pieces, STEADY):
        middle = np.median(columns[name])
        wrong |= np.abs(columns[name] - middle) > TOLERANCE * middle + EDGE_COUNTS
    if _has_clock(pieces):
        pulses = sum(columns[name] for name in PULSES)
        limit = columns[CLOCK] + EDGE_COUNTS
        over = pulses > (limit if np.ndim(pulses) == 1 else limit[:, None])
        wrong |= over if over.ndim == 1 else over.any(axis=1)
    return wrong if wrong.any() else None


def _all_plausible(pieces: Sequence[Columns]) -> bool:
    """Cheap and sufficient: extremes of the whole record."""
    for name in _present(pieces, STEADY):
        low = min(int(piece[name].min()) for piece in pieces)
        high = max(int(piece[name].max()) for piece in pieces)
        if high - low > TOLERANCE * low:
            return False
    if not _has_clock(pieces):
        return True
    highest = sum(max(int(piece[name].max()) for piece in pieces) for name in PULSES)
    return highest <= min(int(piece[CLOCK].min()) for piece in pieces)


def _present(pieces: Sequence[Columns], names: Sequence[str]) -> list[str]:
    return [name for name in names if name in pieces[0]]


def _has_clock(pieces: Sequence[Columns]) -> bool:
    return all(name in pieces[0] for name in (CLOCK, *PULSES))


def pulse_timing(pieces: Sequence[Mapping[str, Array]], first_counter: int) -> dict[str, Integers]:
    """Moments of the pulses of a record in which no frame is missing, and its first and last frame with a pulse.

    Args: pieces: consecutive parts of the record, each with its count fields by name, (n,) or (n, channels).
          first_counter: unwrapped counter of the first frame.
    Returns: int64 arrays (channels,) by "<field>.<key>" for "npp" and "ppp", with x_j pulses in frame j = 1, 2, ...:
        "moment1" = sum of j x_j, "moment2" = sum of j^2 x_j; "first" and "last" = unwrapped counter of the first and
        last frame with a pulse (-1: there is none), "at_first" and "at_last" = pulses in that frame (0: none).
        Fields that a frame format does not have are left out.
    """
    timing: dict[str, Integers] = {}
    for name in (name for name in TIMED if pieces and name in pieces[0]):
        counts = np.concatenate([piece[name] for piece in pieces])
        counts = counts[:, None] if counts.ndim == 1 else counts
        found = {**_moments(counts), **_ends(counts, first_counter)}
        timing |= {f"{name}.{key}": value for key, value in found.items()}
    return timing


def _moments(counts: Array) -> dict[str, Integers]:
    """Exact weighted sums of (n, channels): in float64, three times as fast, as long as that holds every digit."""
    place = np.arange(1, len(counts) + 1, dtype=np.int64)
    weights = np.stack((place, place * place))
    if len(counts) ** 3 * int(counts.max(initial=0)) < _EXACT:
        sums = (weights.astype(np.float64) @ counts.astype(np.float64)).astype(np.int64)
    else:
        sums = weights @ counts.astype(np.int64)
    return {"moment1": sums[0], "moment2": sums[1]}


def _ends(counts: Array, first_counter: int) -> dict[str, Integers]:
    """Return first and last frame with a pulse, by channel."""
    channels = np.ascontiguousarray(counts.T)
    pulsed = channels != 0
    first, last = pulsed.argmax(axis=1), len(counts) - 1 - pulsed[:, ::-1].argmax(axis=1)
    none = ~pulsed.any(axis=1)
    each = np.arange(len(channels))
    return {
        "first": np.where(none, -1, first_counter + first),
        "last": np.where(none, -1, first_counter + last),
        "at_first": channels[each, first].astype(np.int64),
        "at_last": np.where(none, 0, channels[each, last].astype(np.int64)),
    }


Rows = slice | Integers
UNIT_TEMPERATURE = "unit_temperature_degC"
_TARGET, _BAND = "temperature_degC", "settle_band_degC"
_FOLD = 100
OVERLAP_NS = NS // 5
_LATE_NS = 10 * NS  # how much later than due the last frame of a record may come


def kept_ns(window: RecordWindow, chained: bool) -> tuple[int, int]:
    """Return (begin, end] of what is kept beside a record; ``chained``: it follows another one without a gap."""
    return window.t_start_ns - (OVERLAP_NS if chained else 0) - 1, window.t_end_ns + _LATE_NS


def is_off_target(conditions: Mapping[str, Any], unit_degC: float) -> bool:
    """True if a unit temperature is farther from the record's ``temperature_degC`` than its ``settle_band_degC``.

    False where the conditions do not state both: there is nothing to judge by.
    """
    target_degC, band_degC = conditions.get(_TARGET), conditions.get(_BAND)
    if not isinstance(target_degC, int | float) or not isinstance(band_degC, int | float):
        return False
    return not abs(unit_degC - target_degC) <= band_degC


def column_sums(column: Array) -> Integers:
    """Exact int64 sums over the first axis of (n,) or (n, channels).

    numpy adds narrow rows one by one; a hundred frames side by side make it eight times faster.
    """
    whole = len(column) // _FOLD * _FOLD
    if column.ndim == 1 or not whole:
        return np.asarray(column.sum(axis=0, dtype=np.int64))
    wide = column[:whole].reshape(-1, _FOLD * column.shape[1]).sum(axis=0, dtype=np.int64)
    rest = column[whole:].sum(axis=0, dtype=np.int64)
    return np.asarray(wide.reshape(_FOLD, -1).sum(axis=0) + rest)


@dataclass(frozen=True)
class RecordRow:
    """One finished record.

    Attributes:
        window: what was asked for.
        sums: int64 sums of every per-frame count field over the good frames: "npp", "ppp" (channels,), clocks ().
        frames: good frames in the sums; ``frames + lost`` = frames asked for.
        lost: frames that are missing or not good. bad: those of which damaged bytes arrived.
        quality: GOOD or why not. STALE: the conditions name a temperature, but no housekeeping with a unit temperature
            came inside the record. NOT_SETTLED: the mean unit temperature is off its target (``is_off_target``), or
            the soak before it ended unstable (condition ``settled`` false).
        context: means of the housekeeping received from one frame before the first to the last good frame (and inside
            t_start_ns to t_end_ns), by "<field>_<unit>" over all elements of a field and "<field>_<k>_<unit>" (k from
            1) for each element of an array.
        duplicate: frames received twice (counted once). suspect: frames left out because they cannot be true.
        first_half: the sums over the frames of the first half of the record, by the counter.
        timing: when in the record the pulses came (bench.record.window); empty if it was not asked for or a frame is
            missing or suspect.
        samples: every sample of the record, if that was asked for and the frames carry samples.
        beside: samples that other links sent until the last good frame of the record was received, by link; where the
            record follows another one they begin ``OVERLAP_NS`` early, so that none is missing at the joint.
        signals: single numbers of frames that the sequence names, by name: of the record's own frames, and of others
            that came in the time for which ``context`` is a mean.
        readings, unread: of a record without frames how many readings of instruments it holds, and how many gave no
            value; they are events of the session between the start and the end of its window.
    """

    window: RecordWindow
    sums: Mapping[str, Integers]
    frames: int
    lost: int
    bad: int
    quality: Quality
    context: Mapping[str, float] = field(default_factory=dict)
    duplicate: int = 0
    suspect: int = 0
    timing: Mapping[str, Integers] = field(default_factory=dict)
    first_half: Mapping[str, Integers] = field(default_factory=dict)
    samples: Samples | None = None
    beside: Mapping[str, Samples] = field(default_factory=dict)
    signals: Mapping[str, SignalValues] = field(default_factory=dict)
    readings: int = 0
    unread: int = 0


@dataclass
class OpenWindow:
    """A record being cut. ``until_ns``: frames received later do not belong to it, whatever their counter.

    ``timed``: keep when the pulses came. ``period_ns``: how long the counts of one frame take, 1 if nobody knows.
    ``keeper``: takes the samples, if they are kept; ``beside``: those of other links; ``signals``: the named signals.
    """

    window: RecordWindow
    until_ns: int | None
    shapes: Mapping[str, tuple[int, ...]]
    timed: bool = False
    period_ns: int = 1
    keeper: SampleKeeper | None = None
    beside: BesideKeeper | None = None
    signals: SignalKeeper | None = None
    complete: bool = False
    duplicate: int = 0
    over_range: bool = False
    first_stamp_ns: int = -1
    last_stamp_ns: int = -1
    bad_counters: set[int] = field(default_factory=set)
    _pieces: list[Mapping[str, Array]] = field(default_factory=list)
    _counts: list[int] = field(default_factory=list)  # frames of each piece
    _context: list[tuple[Integers, Mapping[str, Floats]]] = field(default_factory=list)
    _early: int = 0  # frames of the first half
    _sums: dict[str, Integers] = field(default_factory=dict)
    _first_half: dict[str, Integers] = field(default_factory=dict)
    _timing: dict[str, Integers] = field(default_factory=dict)
    _frames: int = 0
    _suspect: int = 0

    @property
    def first(self) -> int:
        """First counter of the record."""
        return self.window.first_counter

    @property
    def stop(self) -> int:
        """Counter behind the last frame of the record."""
        return self.window.first_counter + self.window.frames

    @property
    def middle(self) -> int:
        """First counter of the second half of the record."""
        return self.first + self.window.frames // 2

    def add(self, columns: Mapping[str, Array], rows: Rows, t_ns: Integers, early: int, over_range: bool) -> None:
        """Take the frames ``rows`` of a batch, all inside the window, none of them twice; ``early``: how many of them
        are of the first half.
        """
        piece = {name: column[rows] for name, column in columns.items()}
        if not self._pieces:
            self.first_stamp_ns = int(t_ns[rows][0])
        self._pieces.append(piece)
        self._counts.append(len(t_ns[rows]))
        self._early += early
        self.last_stamp_ns = int(t_ns[rows][-1])
        self.over_range = self.over_range or over_range

    def add_context(self, t_ns: Integers, values: Mapping[str, Floats]) -> None:
        """Keep the housekeeping that was received during the window."""
        first = int(np.searchsorted(t_ns, self.window.t_start_ns, side="left"))
        stop = int(np.searchsorted(t_ns, self.window.t_end_ns, side="right"))
        if first < stop:
            self._context.append((t_ns[first:stop], {name: value[first:stop] for name, value in values.items()}))

    def settle(self) -> None:
        """No more frames will come: sum up and let go of them."""
        self.complete = True
        wrong = implausible(self._pieces)
        halves = [{name: np.zeros(shape, np.int64) for name, shape in self.shapes.items()} for _ in range(2)]
        at = 0
        for piece, count in zip(self._pieces, self._counts, strict=True):
            keep = None if wrong is None else ~wrong[at : at + count]
            early = min(max(self._early - at, 0), count)
            for half, part in zip(halves, (slice(0, early), slice(early, count)), strict=True):
                for name, column in piece.items():
                    half[name] += column_sums(column[part] if keep is None else column[part][keep[part]])
            at += count
        self._suspect = 0 if wrong is None else int(wrong.sum())
        self._frames = at - self._suspect
        self._first_half = halves[0]
        self._sums = {name: early + halves[1][name] for name, early in halves[0].items()}
        if self.timed and self._frames == self.window.frames:
            self._timing = pulse_timing(self._pieces, self.first)
        self._pieces = []

    def row(self) -> RecordRow:
        """The record as it stands."""
        if not self.complete:
            self.settle()
        lost = self.window.frames - self._frames
        bad = len(self.bad_counters)
        means = self._means()
        quality = self._thermal_quality(means.get(UNIT_TEMPERATURE))
        for wrong, flag in (
            (lost, Quality.LOST), (bad, Quality.BAD_FRAMES), (self.duplicate, Quality.DUPLICATE),
            (self._suspect, Quality.SUSPECT), (self.over_range, Quality.OVER_RANGE),
        ):  # fmt: skip
            quality |= flag if wrong else Quality.GOOD
        return RecordRow(
            self.window, self._sums, self._frames, lost, bad, quality, means, self.duplicate, self._suspect,
            self._timing, self._first_half, None if self.keeper is None else self.keeper.samples(),
            {} if self.beside is None else self.beside.samples(self.last_stamp_ns),
            {} if self.signals is None else self.signals.between(self._from_ns, self.last_stamp_ns),
        )  # fmt: skip

    def _thermal_quality(self, unit_degC: float | None) -> Quality:
        """Flags of the temperature, from the record alone: the same in the run and in a replay."""
        conditions = self.window.conditions
        quality = Quality.NOT_SETTLED if conditions.get("settled") is False else Quality.GOOD
        if unit_degC is None:
            return quality | (Quality.STALE if _TARGET in conditions else Quality.GOOD)
        return quality | (Quality.NOT_SETTLED if is_off_target(conditions, unit_degC) else Quality.GOOD)

    @property
    def _from_ns(self) -> int:
        """Time behind which its frames counted: one frame before the first one was received."""
        return self.first_stamp_ns - self.period_ns

    def _means(self) -> dict[str, float]:
        """Means over the time its frames counted, to the last one; other housekeeping may not have been decoded yet."""
        t_ns = np.concatenate([stamps for stamps, _ in self._context]) if self._context else np.empty(0, np.int64)
        first = int(np.searchsorted(t_ns, self._from_ns, side="right"))
        stop = int(np.searchsorted(t_ns, self.last_stamp_ns, side="right"))
        if stop <= first:
            return {}
        means: dict[str, float] = {}
        for name in self._context[0][1]:
            column = np.concatenate([values[name] for _, values in self._context])[first:stop]
            base, _, unit = name.rpartition(" ")
            means[f"{base}_{unit}"] = float(np.mean(column))
            if column.ndim > 1:
                for k, value in enumerate(column.mean(axis=0).tolist(), 1):
                    means[f"{base}_{k}_{unit}"] = value
        return means


def row_of_readings(window: RecordWindow, flags: Sequence[Quality]) -> RecordRow:
    """Return the record of a window from the flags of its readings, each GOOD or why it gave no value.

    A record counts as flagged only by what concerns all of it: that nothing was read, or an unstable soak before it.
    """
    unread = [flag for flag in flags if flag]
    quality = Quality.NOT_SETTLED if window.conditions.get("settled") is False else Quality.GOOD
    if len(unread) == len(flags):
        for flag in unread or (Quality.LOST,):
            quality |= flag
    return RecordRow(window, {}, 0, 0, 0, quality, readings=len(flags) - len(unread), unread=len(unread))


class RecordedReadings:
    """The readings of one part of a session, in order of time, as its records find theirs."""

    def __init__(self, events: Iterable[tuple[int, Event]]) -> None:
        readings = [(t_ns, event.quality) for t_ns, event in events if isinstance(event, Reading)]
        self._t_ns = [t_ns for t_ns, _ in readings]
        self._flags = [Quality(quality or 0) for _, quality in readings]

    def row(self, window: RecordWindow) -> RecordRow:
        """Return the record of a window: its readings came behind its start, and not behind its end."""
        first, stop = (bisect_right(self._t_ns, t_ns) for t_ns in (window.t_start_ns, window.t_end_ns))
        return row_of_readings(window, self._flags[first:stop])
