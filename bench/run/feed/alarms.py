"""Alarms of a run: what is wrong now, and what was and nobody has seen yet.

Made from events alone, in their order, so that a recording gives the same alarms with the same ids as the run did. An
alarm stays until it is acknowledged and not active. The same trouble again counts as the same alarm while that is not
acknowledged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from bench.run.feed.sentences import sentence

Fields = Mapping[str, Any]
Severity = Literal["warning", "alarm", "fault"]
MOST = 200
LONGEST_TEXT = 500
_INTERLOCKS: Mapping[str, Severity] = {"warn": "warning", "abort": "fault"}
PERSON = "operator"  # who holds a run by a pause


@dataclass
class Alarm:
    """One alarm; ``key`` is the trouble it tells of, ``active``: it lasts."""

    id: str
    key: str
    severity: Severity
    code: str | None
    t_utc_s: float
    text: str
    active: bool
    acknowledged: dict[str, Any] | None = None

    def document(self) -> dict[str, Any]:
        """As part of the state document."""
        return {
            "id": self.id, "severity": self.severity, "code": self.code, "t_utc_s": self.t_utc_s, "text": self.text,
            "active": self.active, "acknowledged": self.acknowledged,
        }  # fmt: skip


class Alarms:
    """At most ``MOST``: the oldest that are over and acknowledged go first, then the oldest that are over."""

    def __init__(self) -> None:
        self._alarms: list[Alarm] = []  # oldest first
        self._count = 0

    def on_event(self, kind: str, t_utc_s: float, fields: Fields) -> None:
        """Take an event; those that are no trouble change nothing."""
        take = getattr(self, f"_on_{kind}", None)
        if take is not None:
            take(t_utc_s, fields)

    def acknowledge(self, alarm: str, by: str, t_utc_s: float) -> bool:
        """Note who has seen an alarm, and forget it if it is over; False if there is none that waits for it."""
        for one in self._alarms:
            if one.id == alarm and one.acknowledged is None:
                one.acknowledged = {"by": by, "t_utc_s": t_utc_s}
                self._forget()
                return True
        return False

    def waits(self, alarm: str) -> bool:
        """Whether there is such an alarm and nobody has acknowledged it."""
        return any(one.id == alarm and one.acknowledged is None for one in self._alarms)

    def documents(self) -> list[dict[str, Any]]:
        """All alarms, newest first."""
        return [one.document() for one in sorted(self._alarms, key=lambda one: -one.t_utc_s)]

    # --- what is trouble -------------------------------------------------------------------------------------------

    def _on_interlock(self, t: float, fields: Fields) -> None:
        key = f"interlock {fields.get('name')}"
        if fields.get("state") == "released":
            self._over(key)
            return
        self._raise(key, _INTERLOCKS.get(str(fields.get("action")), "alarm"), t, "interlock", fields, active=True)

    def _on_link(self, t: float, fields: Fields) -> None:
        key, state = f"link {fields.get('link')}", fields.get("state")
        if state == "back":
            self._over(key)
        elif state in ("lost", "silent"):
            self._raise(key, "alarm", t, "link", fields, active=True)
        elif state in ("kernel errors", "behind"):
            self._raise(f"{key} {state}", "warning", t, "link", fields)

    def _on_hold(self, t: float, fields: Fields) -> None:
        severity: Severity = "warning" if fields.get("by") == PERSON else "alarm"
        self._raise("hold", severity, t, "hold", fields, active=True)

    def _on_release(self, _: float, __: Fields) -> None:
        for one in self._alarms:
            if one.key == "hold" or one.key.startswith("stimulus "):
                one.active = False
        self._forget()

    def _on_alarm(self, t: float, fields: Fields) -> None:
        what = fields.get("what")
        key = f"stimulus {fields.get('role')}" if what == "stimulus" else str(what)
        self._raise(key, "fault" if what == "stimulus" else "alarm", t, "alarm", fields, active=True)

    def _on_prompt(self, _: float, __: Fields) -> None:
        self._over("prompt")

    def _on_guard(self, t: float, fields: Fields) -> None:
        if fields.get("state") == "acted":
            self._raise("guard", "fault", t, "guard", fields)
        elif fields.get("state") in ("lost", "withheld"):
            self._raise(f"guard {fields['state']}", "alarm", t, "guard", fields)

    def _on_error(self, t: float, fields: Fields) -> None:
        """A reading that failed; an error that ends the run is known as one by the event ``end`` behind it."""
        self._raise(_error_key(fields), "warning", t, "error", fields)

    def _on_end(self, t: float, fields: Fields) -> None:
        for one in self._alarms:
            one.active = False
        code = fields.get("error")
        if code is not None:
            last = next((one for one in reversed(self._alarms) if one.code == code), None)
            if last is None:
                self._raise("end", "fault", t, "end", {**fields, "code": code})
            else:
                last.severity = "fault"
        self._forget()

    def _on_safe(self, t: float, fields: Fields) -> None:
        if fields.get("failures"):
            self._raise("safe", "fault", t, "safe", fields)

    def _on_clock_step(self, t: float, fields: Fields) -> None:
        self._raise("clock_step", "warning", t, "clock_step", fields)

    def _on_verdict(self, t: float, fields: Fields) -> None:
        if fields.get("ok") is False:
            self._raise("verdict", "alarm", t, "verdict", fields)

    def _on_notify(self, t: float, fields: Fields) -> None:
        self._raise(f"notify {fields.get('way')}", "warning", t, "notify", fields)

    def _on_disk(self, t: float, fields: Fields) -> None:
        """No event of the session, which cannot be written just then: the run tells it as a message."""
        self._raise("disk", "fault", t, "error", fields)

    def _on_control(self, t: float, fields: Fields) -> None:
        if fields.get("what") == "acknowledge" and fields.get("ok", True):
            self.acknowledge(str(fields.get("alarm")), str(fields.get("by")), t)

    # --- keeping ---------------------------------------------------------------------------------------------------

    def _raise(
        self, key: str, severity: Severity, t_utc_s: float, kind: str, fields: Fields, *, active: bool = False
    ) -> None:
        text = sentence(kind, fields)[:LONGEST_TEXT]
        code = None if fields.get("code") is None else str(fields["code"])
        for one in self._alarms:
            if one.key == key and one.acknowledged is None:
                one.severity, one.code, one.t_utc_s, one.text, one.active = severity, code, t_utc_s, text, active
                return
        self._count += 1
        self._over(key)  # an alarm that was acknowledged while it lasted; this one has taken its place
        self._alarms.append(Alarm(str(self._count), key, severity, code, t_utc_s, text, active))
        self._forget()

    def _over(self, key: str) -> None:
        for one in self._alarms:
            if one.key == key:
                one.active = False
        self._forget()

    def _forget(self) -> None:
        self._alarms = [one for one in self._alarms if one.active or one.acknowledged is None]
        while len(self._alarms) > MOST:
            over = next((one for one in self._alarms if not one.active), self._alarms[0])
            self._alarms.remove(over)


def _error_key(fields: Fields) -> str:
    """Code and place of an error: ``error B-INST-001: GPIB0::16::INSTR: no answer ...`` at another time is the same."""
    place = str(fields.get("text", "")).split(": ")[1:2]
    return f"error {fields.get('code')} {place}"
