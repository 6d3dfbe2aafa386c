"""The last minute of every signal in points of 0.1 s: the least and the greatest value, never one sample out of many.

A rate is the mean over the second that ends with its point.

A run only leaves its decoded frames here, which costs it nothing; they are made into points when somebody asks. The
memory is of fixed size: frames of about a minute, and a ring of points.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.frame import (
    BENCH,
    MEAN_S,
    LinkBatch,
    MessageBatch,
    Signal,
    columns,
    means,
    of_message,
    rates_among,
    rates_Hz,
)
from bench.model.clock import NS
from bench.model.events import Decision, Event, Record, Retake
from bench.model.quantities import Values
from bench.plan import is_measurement
from bench.record import HELD_S
from bench.run.feed.place import PlannedRun

LAST = 10
REMEMBERED = 64  # records that may still be taken back
_UNKNOWN = {"lost": None, "bad": None, "flags": None}  # a recording says only what was asked for


class Records:
    """Records of the campaign (not those of the wiring check), as part of the state document."""

    def __init__(self, plan: PlannedRun) -> None:
        self._plan = plan
        self._planned = plan.measured_before(len(plan.steps))
        self._done = self._retaken = self._flagged = 0
        self._begun = False
        self._last: deque[dict[str, Any]] = deque(maxlen=REMEMBERED)  # newest first

    def at_step(self, number: int) -> None:
        """The first step of a run that was gone on with: the records before it are done."""
        if not self._begun:
            self._begun, self._done = True, self._plan.measured_before(number)

    def on_event(self, event: Event, t_utc_s: float) -> None:
        """Count what is taken, and taken back."""
        if isinstance(event, Record) and is_measurement(event.conditions):
            self._begun = True
            self._take(event.number, t_utc_s, event.conditions, _recorded(event))
        elif isinstance(event, Decision):
            self._planned = self._plan.measured_before(len(self._plan.steps))
        elif isinstance(event, Retake):
            self._retaken += 1
            self._withdraw(event.record)

    def on_record(self, number: int, t_utc_s: float, conditions: Values, counts: Values) -> None:
        """Note what became of a record; its event came before."""
        if is_measurement(conditions):
            self._take(number, t_utc_s, conditions, counts)

    def document(self) -> dict[str, Any]:
        """Return the entry of the state document."""
        return {
            "done": self._done, "planned": self._planned, "retaken": self._retaken, "flagged": self._flagged,
            "last": list(self._last)[:LAST],
        }  # fmt: skip

    def _take(self, number: int, t: float, conditions: Values, counts: Values) -> None:
        self._withdraw(number)
        self._done += 1
        self._flagged += bool(counts.get("flags"))
        line = {"number": number, "t_utc_s": t, "conditions": dict(conditions), "frames": None}
        self._last.appendleft(line | _UNKNOWN | dict(counts))

    def _withdraw(self, number: int) -> None:
        for line in self._last:
            if line["number"] == number:
                self._done -= 1
                self._flagged -= bool(line["flags"])
                self._last.remove(line)
                return


def _recorded(event: Record) -> dict[str, Any]:
    """Return what the event of a record says it is made of: frames, or readings of instruments."""
    if event.readings is not None:
        return {"frames": None, "readings": event.readings, "lost": event.unread}
    return {"frames": event.frames}


POINT_NS = NS // 10
KEPT = 600
SPARE = 100
MEAN_POINTS = round(MEAN_S * NS) // POINT_NS
PATIENCE_NS = 1 * NS  # a link whose frames are older than that holds up no point
PATIENCE_VIRTUAL_NS = 61 * NS  # a rehearsal decodes once a minute of bench time
_CHANGES = 64  # of each temperature of the bench


@dataclass(frozen=True)
class PointBatch:
    """Points ``first`` to ``first + n - 1`` of those before ``seq``, as bytes of the live protocol."""

    seq: int
    first: int
    n: int
    packed: bytes


class Points:
    """Points of one part of a run, numbered from 0 at ``origin_ns`` of its clock. Thread-safe.

    Args: signals: the columns.   periods_ns: time between two frames, by link; 0 if it is not known.
          origin_utc_s: UTC of ``origin_ns``.   patience_ns: how long a link may be behind.
    Temperatures of the bench stand until the next reading, at most ``HELD_S``; a set-point until the next one.
    """

    def __init__(
        self,
        signals: Sequence[Signal],
        periods_ns: Mapping[str, int],
        origin_ns: int,
        origin_utc_s: float,
        patience_ns: int,
    ) -> None:
        self.signals, self._periods_ns = tuple(signals), dict(periods_ns)
        self._origin_ns, self._origin_utc_s, self._patience_ns = origin_ns, origin_utc_s, patience_ns
        self._waiting_lock, self._ring_lock = threading.Lock(), threading.Lock()
        self._waiting: deque[tuple[str, int, MessageBatch]] = deque()
        self._newest_ns: dict[str, int] = {}
        places: dict[tuple[str, str], list[int]] = {}
        for place, signal in enumerate(self.signals):
            places.setdefault((signal.link, signal.message), []).append(place)
        self._places = {source: np.array(columns) for source, columns in places.items()}
        self._bench = {signal.field: place for place, signal in enumerate(self.signals) if signal.link == BENCH}
        self._changes: dict[str, deque[tuple[int, float]]] = {field: deque(maxlen=_CHANGES) for field in self._bench}
        self._size = KEPT + patience_ns // POINT_NS + SPARE
        self._low = np.full((self._size, len(self.signals)), np.nan, np.float32)
        self._high = self._low.copy()
        self._rates = rates_among(self.signals)
        self._sums = np.zeros((self._size, len(self._rates)))
        self._counts = np.zeros(self._sums.shape, np.intp)  # frames in each sum
        self._stop = 0  # the ring holds points before this one
        self._seq = 0  # points before this one are complete

    # --- on the threads of the run: nothing but appending ------------------------------------------------------

    def on_batch(self, link: str, batch: LinkBatch) -> None:
        """Frames of a link were decoded."""
        with self._waiting_lock:
            for message, frames in batch.messages.items():
                if (link, message) in self._places and frames.t_ns is not None and len(frames.t_ns):
                    newest = int(frames.t_ns[-1])
                    self._waiting.append((link, newest, frames))
                    self._newest_ns[link] = max(newest, self._newest_ns.get(link, newest))
            too_old_ns = max(self._newest_ns.values(), default=0) - KEPT * POINT_NS - self._patience_ns
            while self._waiting and self._waiting[0][1] < too_old_ns:
                self._waiting.popleft()

    def on_reading(self, t_ns: int, values: Mapping[str, float]) -> None:
        """Temperatures of the bench: "air", "unit", "setpoint", degC."""
        with self._waiting_lock:
            for field, value in values.items():
                if field in self._changes:
                    self._changes[field].append((t_ns, value))

    # --- on the thread of whoever asks -------------------------------------------------------------------------

    def since(self, since: int, now_ns: int) -> PointBatch:
        """Return complete points from number ``since`` on, as far as they are kept; from 0 if they are fewer."""
        with self._ring_lock:
            self._fold(now_ns)
            first = max(since if 0 <= since <= self._seq else 0, self._seq - KEPT)
            rows = np.arange(first, self._seq)
            places = rows % self._size
            times = self._origin_utc_s + rows * (POINT_NS / NS)
            spans = np.stack([self._low[places], self._high[places]], axis=-1)
            packed = times.astype("<f8").tobytes() + spans.astype("<f4").tobytes()
            return PointBatch(self._seq, first, len(rows), packed)

    def _fold(self, now_ns: int) -> None:
        with self._waiting_lock:
            waiting, newest = list(self._waiting), dict(self._newest_ns)
            self._waiting.clear()
        groups: dict[tuple[str, str], list[MessageBatch]] = {}
        for link, _, frames in waiting:
            groups.setdefault((link, frames.message.name), []).append(frames)
        patient = self._number(now_ns - self._patience_ns)
        streaming = [self._number(t_ns) for t_ns in newest.values() if self._number(t_ns) > patient]
        last = max([*(self._number(t_ns) for t_ns in newest.values()), patient])
        self._make_room(last + 1)
        for (link, _), batches in groups.items():
            self._take(link, MessageBatch.join(batches))
        self._publish(max(self._seq, patient, min(streaming, default=0)))

    def _number(self, t_ns: int) -> int:
        return (t_ns - self._origin_ns) // POINT_NS

    def _make_room(self, stop: int) -> None:
        if stop > self._stop:
            fresh = np.arange(max(self._stop, stop - self._size), stop) % self._size
            self._low[fresh] = self._high[fresh] = np.nan
            self._sums[fresh] = self._counts[fresh] = 0
            self._stop = stop

    def _take(self, link: str, frames: MessageBatch) -> None:
        assert frames.t_ns is not None
        numbers = (moments_ns(frames.t_ns, self._periods_ns.get(link, 0)) - self._origin_ns) // POINT_NS
        values = columns(of_message(self.signals, link, frames.message.name), link, frames)
        good = numbers >= max(self._seq, self._stop - self._size)
        numbers, values = numbers[good], values[good]
        if not len(numbers):
            return
        starts = _starts(numbers)
        rows, places = numbers[starts] % self._size, self._places[link, frames.message.name]
        at = np.ix_(rows, places)
        self._low[at] = np.fmin(self._low[at], np.fmin.reduceat(values, starts))
        self._high[at] = np.fmax(self._high[at], np.fmax.reduceat(values, starts))
        _, mine, theirs = np.intersect1d(places, self._rates, return_indices=True)
        self._sums[np.ix_(rows, theirs)] += np.add.reduceat(values[:, mine], starts)
        self._counts[np.ix_(rows, theirs)] += np.diff(starts, append=len(numbers))[:, None]

    def _publish(self, seq: int) -> None:
        rows = np.arange(max(self._seq, seq - self._size), seq)
        self._seq = seq
        if not len(rows):
            return
        ends_ns = self._origin_ns + (rows + 1) * POINT_NS
        for field, place in self._bench.items():
            held = self._held(field, ends_ns)
            self._low[rows % self._size, place] = self._high[rows % self._size, place] = held
        if len(self._rates):
            at = np.ix_(rows % self._size, self._rates)
            self._low[at] = self._high[at] = self._means(rows)

    def _means(self, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        """Rates at points in a row, (n, rates); NaN where nothing came in the point itself."""
        window = np.arange(rows[0] - MEAN_POINTS, rows[-1] + 1)
        known = (window >= max(0, self._stop - self._size))[:, None]
        sums, counts = (np.cumsum(known * kept[window % self._size], axis=0) for kept in (self._sums, self._counts))
        found = means(
            sums[MEAN_POINTS:] - sums[:-MEAN_POINTS], counts[MEAN_POINTS:] - counts[:-MEAN_POINTS],
            rates_Hz(self.signals)[self._rates],
        )  # fmt: skip
        found[self._counts[rows % self._size] == 0] = np.nan
        return found

    def _held(self, field: str, t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        with self._waiting_lock:
            changes = list(self._changes[field])
        if not changes:
            return np.full(len(t_ns), np.nan)
        moments = np.array([moment for moment, _ in changes])
        values = np.array([value for _, value in changes])
        index = np.searchsorted(moments, t_ns, side="right") - 1
        fresh = index >= 0
        if field != "setpoint":
            fresh &= t_ns - moments[index] <= HELD_S * NS
        return np.where(fresh, values[index], np.nan)


def moments_ns(stamps_ns: NDArray[np.int64], period_ns: int) -> NDArray[np.int64]:
    """Return times of frames received together, under one stamp: a period after each other, the last at the stamp.

    Never before the stamp of the frames in front of them; without a period they share the time since then.
    """
    starts = _starts(stamps_ns)
    counts = np.diff(starts, append=len(stamps_ns))
    since_ns = np.diff(stamps_ns[starts], prepend=stamps_ns[0] - counts[0] * period_ns)
    steps_ns = since_ns // counts
    if period_ns:
        steps_ns = np.minimum(steps_ns, period_ns)
    behind = np.repeat(starts + counts, counts) - 1 - np.arange(len(stamps_ns))
    return np.asarray(stamps_ns - behind * np.repeat(steps_ns, counts))


def _starts(numbers: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return where runs of equal numbers begin; there is at least one number."""
    return np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
