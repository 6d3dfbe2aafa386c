"""Records that are made of readings of instruments: they have no frames, their readings are events of the session."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record.window import RecordRow

READING = "reading"


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

    def __init__(self, events: Iterable[tuple[str, int, Mapping[str, Any]]]) -> None:
        readings = [(t_ns, fields) for kind, t_ns, fields in events if kind == READING]
        self._t_ns = [t_ns for t_ns, _ in readings]
        self._flags = [Quality(int(fields.get("quality", 0))) for _, fields in readings]

    def row(self, window: RecordWindow) -> RecordRow:
        """Return the record of a window: its readings came behind its start, and not behind its end."""
        first, stop = (bisect_right(self._t_ns, t_ns) for t_ns in (window.t_start_ns, window.t_end_ns))
        return row_of_readings(window, self._flags[first:stop])
