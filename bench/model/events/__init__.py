"""Everything that can happen in a run: one frozen class per kind of event."""

from __future__ import annotations

from bench.model.events.course import (
    DECISION,
    LEFT_OUT,
    OPERATOR,
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
    by_instrument,
)
from bench.model.events.event import Event, Severity, event_of
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

__all__ = [
    "DECISION", "LEFT_OUT", "OPERATOR", "Alarm", "Answer", "Armed", "ClockStep", "Closed", "Config", "Control",
    "Decision", "Deviation", "Disk", "End", "Environment", "Error", "Event", "Exchange", "Gap", "Guard", "Hold",
    "HoldAlarm", "Inhibit", "Interlock", "Late", "Link", "Notify", "Overrun", "Phase", "Preflight", "Prompt",
    "PromptAlarm", "Reading", "Record", "Reentry", "Release", "Resume", "Retake", "Safe", "Settled", "Severity",
    "Skip", "Slip", "StimulusAlarm", "Surroundings", "Suspend", "ThermalLag", "UnitLeftOut", "Verdict", "by_instrument",
    "event_of",
]  # fmt: skip
