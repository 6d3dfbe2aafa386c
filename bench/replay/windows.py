"""The records of a session, as its events tell: where each one was cut, and which attempts were given up."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from bench.model.errors import SessionDamaged
from bench.model.ports import RecordWindow
from bench.record import Message

RESUME = "resume"


@dataclass(frozen=True)
class RecordedWindow:
    """A record window and the time after which the run no longer waited for frames.

    ``part`` counts the "resume" events before it: counters start anew with each. ``timed``: its pulses were timed;
    ``sampled``: its samples were kept; ``chained``: it follows the record before it without a gap.
    """

    window: RecordWindow
    until_ns: int
    part: int
    timed: bool = False
    sampled: bool = False
    chained: bool = False


def recorded_windows(events: Iterable[Message]) -> list[RecordedWindow]:
    """Windows of all records that count, in the order they were taken.

    A "retake" event takes back the record of its number taken before it; of two with one number the later counts.
    Raises: SessionDamaged B-RPL-003 if a record event lacks a field.
    """
    found: dict[int, RecordedWindow] = {}
    part = 0
    for message in events:
        kind, fields = message.event()
        if kind == RESUME:
            part += 1
        elif kind == "retake":
            found.pop(fields.get("record", -1), None)
        elif kind == "record":
            window = _window(fields, message)
            found.pop(window.number, None)
            timed, sampled = fields.get("pulse_timing") is True, fields.get("samples") is True
            chained = _follows(window, part, found.get(window.number - 1))
            found[window.number] = RecordedWindow(window, message.t_ns, part, timed, sampled, chained)
    return list(found.values())


def _follows(window: RecordWindow, part: int, before: RecordedWindow | None) -> bool:
    """Return whether a record begins with the frame behind the one before it."""
    if before is None or not window.link or (before.part, before.window.link) != (part, window.link):
        return False
    return before.window.first_counter + before.window.frames == window.first_counter


def _window(fields: dict[str, Any], message: Message) -> RecordWindow:
    try:
        return RecordWindow(
            int(fields["number"]), str(fields["link"]), int(fields["first_counter"]), int(fields["frames"]),
            int(fields["t_start_ns"]), int(fields["t_end_ns"]), dict(fields["conditions"]), int(fields.get("step", -1)),
        )  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise SessionDamaged(
            "B-RPL-003",
            f"a record event is not complete: {type(error).__name__} {error}",
            where=f"message {message.sequence}",
            next_step="docs/session-format.md lists the fields of a record event",
        ) from error
