"""The parts of a session that was resumed: one time axis for all of them, and what happened in between.

The monotonic clock may start anew with each part (a reboot), and so do the counters of the links. Times of a later
part are moved onto the clock of the first one by the UTC of both, so that the gap is as long as it was. Where UTC
cannot say that (it went back, or is not known) the later part lies right behind, in order, and the gap is of unknown
length. Counters are moved by the frames that would have come in the gap, and never follow those before without one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bench.model.clock import NS
from bench.model.errors import SessionDamaged
from bench.model.events import Event, Record, Reentry, Resume, Retake, event_of
from bench.model.ports import RecordWindow
from bench.record import Message, RecordRow

STEPPED_NS = 5 * NS  # UTC that differs by less from one boot's clock was set right, not restarted
_NEEDED = {"number", "link", "first_counter", "frames", "t_start_ns", "t_end_ns", "conditions", "step"}


@dataclass(frozen=True)
class RecordedWindow:
    """A record window and the time after which the run no longer waited for frames.

    ``part`` counts the "resume" events before it: counters start anew with each. ``timed``: its pulses were timed;
    ``sampled``: its samples were kept; ``chained``: it follows the record before it without a gap; ``signals``: names
    of those that were kept.
    """

    window: RecordWindow
    until_ns: int
    part: int
    timed: bool = False
    sampled: bool = False
    chained: bool = False
    signals: tuple[str, ...] = ()


def recorded_windows(events: Iterable[Message]) -> list[RecordedWindow]:
    """Return windows of all records that count, in the order they were taken.

    A "retake" event takes back the record of its number taken before it; of two with one number the later counts.
    Raises: SessionDamaged B-RPL-003 if a record event lacks a field.
    """
    windows: dict[int, RecordedWindow] = {}
    part = 0
    for message in events:
        event = event_of(*message.event())
        if isinstance(event, Resume):
            part += 1
        elif isinstance(event, Retake):
            windows.pop(event.record, None)
        elif isinstance(event, Record):
            window = _window(event, message)
            windows.pop(window.number, None)
            chained = _follows(window, part, windows.get(window.number - 1))
            signals = tuple(map(str, event.signals))
            windows[window.number] = RecordedWindow(
                window, message.t_ns, part, event.pulse_timing, event.samples, chained, signals
            )
    return list(windows.values())


def _follows(window: RecordWindow, part: int, before: RecordedWindow | None) -> bool:
    """Return whether a record begins with the frame behind the one before it."""
    if before is None or not window.link or (before.part, before.window.link) != (part, window.link):
        return False
    return before.window.first_counter + before.window.frames == window.first_counter


def _window(event: Record, message: Message) -> RecordWindow:
    if unknown := _NEEDED.intersection(event.unknown):
        raise SessionDamaged(
            "B-RPL-003",
            f"a record event is not complete: {', '.join(sorted(unknown))}",
            where=f"message {message.sequence}",
            next_step="docs/session-format.md lists the fields of a record event",
        )
    return RecordWindow(
        event.number, event.link, event.first_counter, event.frames, event.t_start_ns, event.t_end_ns,
        dict(event.conditions), event.step, event.uut,
    )  # fmt: skip


@dataclass
class Part:
    """Times of one part: first and last message, and UTC minus monotonic time, None without a clock pair; ns.

    ``offset_ns`` is by the first clock pair, ``last_offset_ns`` by the last one: a clock that is set right meanwhile
    leaves no trace in the gap behind the part.
    """

    first_ns: int | None = None
    last_ns: int = 0
    offset_ns: int | None = None
    last_offset_ns: int | None = None

    def pair(self, message: Message) -> None:
        """Take a clock pair of the part."""
        pair = message.document()
        self.last_offset_ns = int(pair["t_utc_ns"]) - int(pair["t_mono_ns"])
        self.offset_ns = self.last_offset_ns if self.offset_ns is None else self.offset_ns

    def see(self, t_ns: NDArray[np.uint64]) -> None:
        """Messages of these times belong to the part, in this order."""
        if len(t_ns):
            self.first_ns = int(t_ns[0]) if self.first_ns is None else self.first_ns
            self.last_ns = max(self.last_ns, int(t_ns.max()))


@dataclass(frozen=True)
class Splice:
    """A place where a run was gone on with. UTC in ns, None if unknown; unit temperatures before and after, degC.

    ``at_ns``: monotonic time on the session's axis; ``away_s``: how long nothing was recorded, None if not recorded.
    ``placed``: the times behind it are as much later as they were; False where nobody knows how much that is.
    ``soaked``: the unit was brought to its temperature again.
    """

    at_ns: int
    stopped_utc_ns: int | None
    started_utc_ns: int | None
    away_s: float | None
    step: int
    reason: str
    unit_before_degC: float | None
    unit_after_degC: float | None
    soaked: bool
    placed: bool = True

    @property
    def drift_degC(self) -> float | None:
        """Change of the unit's temperature while nothing was recorded, degC."""
        if self.unit_before_degC is None or self.unit_after_degC is None:
            return None
        return self.unit_after_degC - self.unit_before_degC


def intervals_ns(parts: Sequence[Part]) -> list[int | None]:
    """Return how long nothing was recorded before each part but the first, ns; None where the clocks cannot say.

    By the monotonic clock where both parts are of one boot, else by UTC, which must not have gone back meanwhile.
    """
    intervals: list[int | None] = []
    for before, part in pairwise(parts):
        ended_ns = before.offset_ns if before.last_offset_ns is None else before.last_offset_ns
        running_ns = 0 if part.first_ns is None else part.first_ns - before.last_ns
        if ended_ns is None or part.offset_ns is None:
            intervals.append(None)
            continue
        jump_ns = part.offset_ns - ended_ns
        interval_ns = running_ns if running_ns >= 0 and abs(jump_ns) <= STEPPED_NS else running_ns + jump_ns
        intervals.append(interval_ns if interval_ns >= 0 else None)
    return intervals


def time_shifts_ns(parts: Sequence[Part]) -> list[int]:
    """Return what is added to the times of each part, ns; 0 for the first, and for one on the same running clock."""
    shifts = [0]
    for (before, part), interval_ns in zip(pairwise(parts), intervals_ns(parts), strict=True):
        first_ns = before.last_ns if part.first_ns is None else part.first_ns
        shifts.append(shifts[-1] + before.last_ns - first_ns + (interval_ns or 0))
    return shifts


def moved_rows(rows: Iterable[tuple[int, RecordRow]], shifts_ns: Sequence[int]) -> list[RecordRow]:
    """Return rows, each with the part it was taken in, on one axis of times and counters, by number."""
    ordered = sorted(rows, key=lambda pair: pair[1].window.number)
    moved: list[RecordRow] = []
    counters = {0: 0}
    for part, row in ordered:
        window = row.window
        shift_ns = shifts_ns[part]
        if part not in counters:
            counters[part] = _first_counter(moved, window.t_start_ns + shift_ns) - window.first_counter
        moved.append(_moved(row, shift_ns, counters[part]) if part else row)
    return moved


def _first_counter(before: Sequence[RecordRow], t_ns: int) -> int:
    """Return counter of a frame at a time, by the record before; never the one right behind it."""
    if not before:
        return 1
    last = before[-1].window
    stop = last.first_counter + last.frames
    length_ns = max(1, last.t_end_ns - last.t_start_ns)
    return stop + 1 + max(0, round((t_ns - last.t_end_ns) / length_ns * last.frames))


def _moved(row: RecordRow, shift_ns: int, counters: int) -> RecordRow:
    window = row.window
    there = replace(
        window, first_counter=window.first_counter + counters, t_start_ns=window.t_start_ns + shift_ns,
        t_end_ns=window.t_end_ns + shift_ns,
    )  # fmt: skip
    timing = {
        name: np.where(value >= 0, value + counters, value) if name.endswith((".first", ".last")) else value
        for name, value in row.timing.items()
    }
    signals = {name: replace(signal, t_ns=signal.t_ns + shift_ns) for name, signal in row.signals.items()}
    return replace(row, window=there, timing=timing, signals=signals)


def splices_of(events: Iterable[tuple[int, Event]], parts: Sequence[Part]) -> tuple[Splice, ...]:
    """Return splices of a session, from its events on one time axis and the clocks of its parts."""
    intervals = iter(intervals_ns(parts))
    splices: list[Splice] = []
    for t_ns, event in events:
        if isinstance(event, Resume):
            splices.append(_begun(t_ns, event, next(intervals)))
        elif isinstance(event, Reentry) and splices and splices[-1].step == event.step >= 0:
            splices[-1] = replace(splices[-1], unit_after_degC=event.unit_degC, soaked=event.soaked)
    return tuple(splices)


def _begun(t_ns: int, event: Resume, interval_ns: int | None) -> Splice:
    """Return a splice; a time away below zero is none, whatever the event says."""
    away_s = event.away_s
    if interval_ns is None:
        away_s = None
    elif away_s is not None and away_s < 0.0:
        away_s = interval_ns / NS
    return Splice(
        at_ns=t_ns,
        stopped_utc_ns=event.stopped_utc_ns,
        started_utc_ns=event.utc_ns,
        away_s=away_s,
        step=-1 if event.start is None else event.start,
        reason=event.reason or "unknown",
        unit_before_degC=event.unit_degC,
        unit_after_degC=None,
        soaked=False,
        placed=interval_ns is not None,
    )
