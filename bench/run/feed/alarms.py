"""Alarms of a run: what is wrong now, and what was and nobody has seen yet.

Made from events in their order, and ended by a reply where one confirms what an event doubts, so that a recording gives
the same alarms with the same ids as the run did. An alarm stays until it is acknowledged and not active. The same
trouble again counts as the same alarm while that is not acknowledged.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from bench.model.events import (
    Armed,
    Control,
    Deviation,
    End,
    Event,
    Hold,
    Interlock,
    Link,
    Prompt,
    Release,
    Severity,
    StimulusAlarm,
)

MOST = 200
LONGEST_TEXT = 500


@dataclass
class Alarm:
    """One alarm; ``key`` is the trouble it tells of, ``of`` its sort; ``active``: it lasts."""

    id: str
    key: str
    of: type[Event]
    severity: Severity
    code: str | None
    t_utc_s: float
    text: str
    active: bool
    acknowledged: dict[str, Any] | None = None

    def document(self, shelved: Shelf | None) -> dict[str, Any]:
        """Return the entry of the state document."""
        entry = {name: value for name, value in vars(self).items() if name not in ("key", "of")}
        return {**entry, "shelved": None if shelved is None else asdict(shelved)}


@dataclass(frozen=True)
class Shelf:
    """Who has shelved a trouble, why and until when: it is shown, and nobody is called because of it."""

    by: str
    reason: str
    until_utc_s: float


class Alarms:
    """At most ``MOST``: the oldest that are over and acknowledged go first, then the oldest that are over."""

    def __init__(self) -> None:
        self._alarms: list[Alarm] = []  # oldest first
        self._count = 0
        self._shelves: dict[str, Shelf] = {}  # by key of the trouble: the same again is shelved too

    def on_event(self, event: Event, t_utc_s: float) -> None:
        """Take an event; those that are no trouble change nothing."""
        match event:
            case Release():
                self.over(Hold.kind, *self._unsafe)
            case Prompt() | Armed():
                self.over("prompt")
            case Interlock(state="released") | Link(state="back") | Deviation(state="over"):
                self.over(event.topic)
            case End():
                self._end(event, t_utc_s)
            case Control(what="acknowledge") if event.ok is not False:
                self.acknowledge(str(event.alarm), event.by, t_utc_s)
            case Control(what="shelve", until_utc_s=float(until_utc_s)) if event.ok is not False:
                if (alarm := self.known(str(event.alarm))) is not None:
                    self._shelves[alarm.key] = Shelf(event.by, event.reason, until_utc_s)
            case _ if event.severity != "none":
                self._raise(event, t_utc_s)

    def acknowledge(self, alarm: str, by: str, t_utc_s: float) -> bool:
        """Note who has seen an alarm, and forget it if it is over; False if there is none that waits for it."""
        known = self.known(alarm)
        if known is None or known.acknowledged is not None:
            return False
        known.acknowledged = {"by": by, "t_utc_s": t_utc_s}
        self._forget()
        return True

    def waits(self, alarm: str) -> bool:
        """Return whether there is such an alarm and nobody has acknowledged it."""
        known = self.known(alarm)
        return known is not None and known.acknowledged is None

    def known(self, alarm: str) -> Alarm | None:
        """Return the alarm of this id, None if there is none."""
        return next((known for known in self._alarms if known.id == alarm), None)

    def shelf(self, key: str, t_utc_s: float) -> Shelf | None:
        """Return how a trouble is shelved at a moment, None if it is not or not any more."""
        shelf = self._shelves.get(key)
        return shelf if shelf is not None and t_utc_s < shelf.until_utc_s else None

    def documents(self, t_utc_s: float) -> list[dict[str, Any]]:
        """Return all alarms at a moment, newest first."""
        newest_first = sorted(self._alarms, key=lambda alarm: -alarm.t_utc_s)
        return [alarm.document(self.shelf(alarm.key, t_utc_s)) for alarm in newest_first]

    def over(self, *keys: str) -> None:
        """Take that troubles, by their topics, do not last any more."""
        for alarm in self._alarms:
            if alarm.key in keys:
                alarm.active = False
        self._forget()

    def _end(self, event: End, t_utc_s: float) -> None:
        for alarm in self._alarms:
            alarm.active = False
        if event.error is not None:
            last = next((alarm for alarm in reversed(self._alarms) if alarm.code == event.error), None)
            if last is None:
                self._raise(event, t_utc_s)
            else:
                last.severity = "fault"
        self._forget()

    @property
    def _unsafe(self) -> list[str]:
        return [alarm.key for alarm in self._alarms if alarm.of is StimulusAlarm]

    def _raise(self, event: Event, t_utc_s: float) -> None:
        key, text, active = event.topic, event.sentence[:LONGEST_TEXT], event.lasts
        severity, code = event.severity, event.error_code
        for alarm in self._alarms:
            if alarm.key == key and alarm.acknowledged is None:
                alarm.severity, alarm.code, alarm.t_utc_s = severity, code, t_utc_s
                alarm.text, alarm.active = text, active
                return
        self._count += 1
        self.over(key)  # an alarm that was acknowledged while it lasted; this one has taken its place
        self._alarms.append(Alarm(str(self._count), key, type(event), severity, code, t_utc_s, text, active))
        self._forget()

    def _forget(self) -> None:
        self._alarms = [alarm for alarm in self._alarms if alarm.active or alarm.acknowledged is None]
        while len(self._alarms) > MOST:
            over = next((alarm for alarm in self._alarms if not alarm.active), self._alarms[0])
            self._alarms.remove(over)
