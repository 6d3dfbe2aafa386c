"""The number of records, and the last ones."""

from __future__ import annotations

from collections import deque
from typing import Any

from bench.model.events import Decision, Event, Record, Retake
from bench.model.quantities import Values
from bench.plan import is_measurement
from bench.run.feed.planned import PlannedRun

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
