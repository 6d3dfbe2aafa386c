"""Reads the events of a session back into their classes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.model.events.course import (
    Armed,
    Closed,
    Config,
    End,
    Error,
    Gap,
    Hold,
    Late,
    Overrun,
    Phase,
    Reentry,
    Release,
    Resume,
    Retake,
    Safe,
    Settled,
    Skip,
    Slip,
    Suspend,
    UnitLeftOut,
)
from bench.model.events.event import Event
from bench.model.events.taken import (
    Answer,
    Decision,
    Environment,
    Exchange,
    Preflight,
    Prompt,
    Reading,
    Record,
    Surroundings,
    ThermalLag,
)
from bench.model.events.trouble import (
    Alarm,
    ClockStep,
    Control,
    Deviation,
    Disk,
    Guard,
    HoldAlarm,
    Inhibit,
    Interlock,
    Link,
    Notify,
    PromptAlarm,
    StimulusAlarm,
    Verdict,
)

_CLASSES: Mapping[str, type[Event]] = {
    model.kind: model
    for model in (
        Alarm, Answer, Armed, ClockStep, Closed, Config, Control, Decision, Disk, End, Environment, Error, Exchange,
        Gap, Guard, Hold, Inhibit, Interlock, Late, Link, Notify, Overrun, Phase, Preflight, Prompt, Reading, Record,
        Reentry, Release, Resume, Retake, Safe, Settled, Skip, Slip, Surroundings, Suspend, ThermalLag,
        UnitLeftOut, Verdict,
    )
}  # fmt: skip
_ALARMS: Mapping[object, type[Alarm]] = {
    "hold": HoldAlarm, "stimulus": StimulusAlarm, "prompt": PromptAlarm, "deviation": Deviation,
}  # fmt: skip


def event_of(kind: str, document: Mapping[str, Any]) -> Event:
    """Return the event that a session holds. An event of a kind that is not known is an ``Event`` with its fields."""
    if kind == Alarm.kind:
        return _ALARMS.get(str(document.get("what")), Alarm).read(document)
    model = _CLASSES.get(kind)
    return Event(raw=document) if model is None else model.read(document)
