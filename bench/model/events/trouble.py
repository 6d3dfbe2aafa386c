"""Events of those who watch a run, and of people: alarms, limits, links, the guard, commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

from bench.model.events.event import Event, Severity, event, left_out, number


@event("alarm", severity="alarm")
class Alarm(Event):
    """Somebody should look. Each ``what`` has a class of its own."""

    what: str

    @property
    def topic(self) -> str:
        return self.what

    @property
    def lasts(self) -> bool:
        return True

    def _words(self) -> str:
        return self.what


@event("alarm", at_terminal=True)
class HoldAlarm(Alarm):
    """The run has stood still for long."""

    what: str = "hold"
    step: int
    seconds: float
    reasons: Mapping[str, str]

    def _words(self) -> str:
        reasons = "; ".join(map(str, self.reasons.values()))
        return f"still holding at step {self.step} after {number(self.seconds, '.0f')} s: {reasons}"


@event("alarm", at_terminal=True, severity="fault")
class StimulusAlarm(Alarm):
    """An instrument of the stimulus could not be made safe; it is tried on."""

    what: str = "stimulus"
    step: int
    role: str
    code: str
    text: str

    @property
    def topic(self) -> str:
        return f"stimulus {self.role}"

    @property
    def error_code(self) -> str | None:
        return self.code

    def _words(self) -> str:
        return f"{self.role} is not confirmed safe at step {self.step}: {self.code}: {self.text}"


@event("alarm")
class PromptAlarm(Alarm):
    """A person is asked who does not sit at the terminal."""

    what: str = "prompt"
    id: str
    text: str
    confirm: str
    unit: str
    low: float | None
    high: float | None
    presence: str = left_out("bench")
    arms: bool = left_out(False)

    def _words(self) -> str:
        return f"somebody must answer: {self.text}"


@event("alarm", at_terminal=True)
class Deviation(Alarm):
    """A quantity is not what was set, or is again (``state`` over); nobody declared it, and the run only says so.

    ``name``: what deviates (air, runaway, sensors, voltage, rate); ``of``: the role, with rail or axis; ``by``: the
    sensor that says so; ``door``: whether the door of the chamber is or was open, None if nothing tells.
    """

    what: str = "deviation"
    name: str
    of: str
    state: Literal["begun", "over"]
    value: float | None
    set_point: float | None
    limit: float | None
    unit: str
    by: str
    door: bool | None
    action: str

    @property
    def severity(self) -> Severity:
        if self.state == "over":
            return "none"
        return "alarm" if self.name in ("runaway", "sensors") and not self.door else "warning"

    @property
    def topic(self) -> str:
        return f"deviation {self.name} {self.of}"

    def _words(self) -> str:
        if self.state == "over":
            return f"{self.of}: {_DEVIATES.get(self.name, self.name)} is as it should be again"
        value, limit = f"{_given(self.value)} {self.unit}", f"{_given(self.limit)} {self.unit}"
        set_point = _given(self.set_point)
        said = {
            "air": f"air is {value}, {limit} or more outside its set-point of {set_point} degC",
            "runaway": f"air moves away from its set-point of {set_point} degC at {value}, limit {limit}",
            "sensors": f"its two sensors are {value} apart, limit {limit}",
        }.get(self.name, f"{self.name} is {value}, set to {set_point} {self.unit} within {limit}")
        door = "" if self.door is None else f"; its door {'is or was open' if self.door else 'was not open'}"
        return f"{self.of}: {said} ({self.by}){door}: {self.action}"


_DEVIATES = {"runaway": "the rate of the air", "sensors": "the difference of its sensors"}


def _given(value: float | None) -> str:
    return "none" if value is None else number(value, ".4g")


@event("interlock", at_terminal=True)
class Interlock(Event):
    """A watched value is beyond its limit, or back; ``value`` is None if there was no reading."""

    name: str
    signal: str
    of: str
    value: float | None
    limit: float | None
    unit: str
    action: str
    state: str

    @property
    def severity(self) -> Severity:
        if self.state == "released":
            return "none"
        by_action: dict[str, Severity] = {"warn": "warning", "abort": "fault"}
        return by_action.get(self.action, "alarm")

    @property
    def topic(self) -> str:
        return f"interlock {self.name}"

    @property
    def lasts(self) -> bool:
        return True

    def _words(self) -> str:
        signal = f"{self.signal} of {self.of}" if self.of else self.signal
        if self.state == "released":
            return f"interlock {self.name}: {signal} is back inside its limits"
        if self.value is None:
            return f"interlock {self.name}: no reading of {signal}: {self.action}"
        limit = "none" if self.limit is None else number(self.limit)
        value = f"{number(self.value, '.6g')} {self.unit}, limit {limit} {self.unit}"
        return f"interlock {self.name}: {signal} is {value}: {self.action}"


_AWAY = ("lost", "silent", "shared")


@event("link", severity={**dict.fromkeys(_AWAY, "alarm"), "kernel errors": "warning", "behind": "warning"})
class Link(Event):
    """A link was opened, is lost, silent or shared, is back, or lost bytes; each state has its own fields.

    ``frame`` to ``buf_overrun``: errors that the kernel has counted since the last look.
    """

    link: str
    state: Literal["open", "lost", "silent", "shared", "back", "kernel errors", "behind"]
    kernel_counts: bool | None = left_out()
    reason: str | None = left_out()
    seconds: float | None = left_out()
    how: str | None = left_out()
    frame: int | None = left_out()
    overrun: int | None = left_out()
    parity: int | None = left_out()
    buf_overrun: int | None = left_out()
    times: int | None = left_out()

    @property
    def told(self) -> bool:
        return self.state not in ("open", "behind")

    @property
    def topic(self) -> str:
        passing = self.state in ("kernel errors", "behind")
        return f"link {self.link} {self.state}" if passing else f"link {self.link}"

    @property
    def lasts(self) -> bool:
        return self.state in _AWAY

    def _words(self) -> str:
        if self.state == "back" and self.seconds is not None:
            return f"link {self.link} is back after {self.seconds:.1f} s: {self.how}"
        if self.state == "kernel errors":
            counts = {"frame": self.frame, "overrun": self.overrun, "parity": self.parity, "buffer": self.buf_overrun}
            more = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
            return f"link {self.link}: the kernel counted errors: {more}"
        if self.state == "behind":
            return f"link {self.link}: decoding fell behind {self.times} times"
        return f"link {self.link} is {self.state}{'' if self.reason is None else f': {self.reason}'}"


@event("guard", severity={"acted": "fault", "lost": "alarm", "withheld": "alarm"})
class Guard(Event):
    """The guard is ready or lost, a heartbeat was withheld from it, or it has acted."""

    state: Literal["ready", "withheld", "lost", "acted"]
    pid: int | None = left_out()
    parts: Sequence[str] | None = left_out()
    reason: str | None = left_out()
    text: str | None = left_out()

    @property
    def topic(self) -> str:
        return "guard" if self.state == "acted" else f"guard {self.state}"

    def _words(self) -> str:
        if self.state == "withheld":
            return f"a heartbeat was withheld: no sign of life of {', '.join(map(str, self.parts or ()))}"
        return f"guard {self.state}{f': {self.text}' if self.text else ''}"


@event("verdict", at_terminal=True)
class Verdict(Event):
    """The early judge has judged what is recorded so far; ``ok`` is None if nothing can be judged yet.

    A check has ok, name, value, limit and text.
    """

    ok: bool | None
    records: int | None = left_out()
    checks: Sequence[Mapping[str, Any]] | None = left_out()
    error: str | None = left_out()

    @property
    def severity(self) -> Severity:
        return "alarm" if self.ok is False else "none"

    @property
    def failed(self) -> str:
        """The checks that failed, as a text; "" if none did."""
        return "; ".join(_check(check) for check in self.checks or () if check.get("ok") is False)

    def _words(self) -> str:
        if self.ok is None:
            return f"early verdict: none ({self.error or 'too little is recorded yet'})"
        after = "" if self.records is None else f" after {self.records} records"
        return f"early verdict: {f'all well{after}' if self.ok else self.failed}"


def _check(check: Mapping[str, Any]) -> str:
    value, limit = check.get("value"), check.get("limit")
    if not isinstance(value, int | float) or not isinstance(limit, int | float):
        return str(check.get("text"))
    return f"{check.get('name')} {value:.3g}, limit {limit:.3g} ({check.get('text')})"


@event("notify", at_terminal=True, severity="warning")
class Notify(Event):
    """A message to a person did not get through, or was left out."""

    way: str
    message: str
    sent: bool
    why: str

    @property
    def topic(self) -> str:
        return f"notify {self.way}"

    def _words(self) -> str:
        return f"a notification by {self.way} did not get through ({self.why})"


@event("clock_step", at_terminal=True, severity="warning")
class ClockStep(Event):
    """UTC has moved against the monotonic clock."""

    step_s: float
    t_utc_ns: int

    def _words(self) -> str:
        jump = f"UTC has jumped by {number(self.step_s, '+.3f')} s (clock set, or the machine was asleep)"
        return f"{jump}; durations are not touched"


@event("control")
class Control(Event):
    """A person has given a command from elsewhere; ``text``: what it was answered with.

    ``alarm``: the id of the one that is acknowledged or, ``until_utc_s``, shelved; ``prompt``, ``value``: what is
    answered. ``place``: where it comes from, "bench" or "afar"; None in a session that does not say it.
    """

    what: str
    by: str
    reason: str
    ok: bool | None = None  # of a session that does not say it: it was done
    text: str = ""
    alarm: str | float | None = left_out()
    prompt: str | float | None = left_out()
    value: str | float | None = left_out()
    until_utc_s: float | None = left_out()
    place: str | None = left_out()

    def _words(self) -> str:
        refused = f" (refused: {self.text})" if self.ok is False else ""
        return f"{self.what} by {self.by}{f': {self.reason}' if self.reason else ''}{refused}"


@event("inhibit")
class Inhibit(Event):
    """The machine is kept awake, or is not any more."""

    held: bool
    text: str


@event("disk", at_terminal=True, severity="fault")
class Disk(Event):
    """The disk takes nothing. No event of a session, which cannot be written just then: the run only tells it."""

    recorded: ClassVar[bool] = False
    code: str
    text: str

    @property
    def error_code(self) -> str | None:
        return self.code

    def _words(self) -> str:
        return self.text
