"""Events of the course of a run: how it goes through its plan, where it stands still, and how it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from bench.model.errors import BenchError
from bench.model.events.event import Event, Severity, event, left_out, number

OPERATOR = "operator"  # who holds a run by a pause
LEFT_OUT = "unit left out"  # who leaves out the steps of a unit
UNDECLARED = "undeclared effect"  # who holds a run in which something is on that no step switches on
DECISION = "decision"  # who leaves out steps of a branch, or holds a run that has nothing to decide by


def by_instrument(role: str) -> str:
    """Return who holds a run that waits for an instrument."""
    return f"instrument {role}"


@event("phase")
class Phase(Event):
    """A phase of the plan begins."""

    name: str
    t_start_ns: int

    def _words(self) -> str:
        return f"phase {self.name} begins"


@event("resume")
class Resume(Event):
    """A session is gone on with at step ``start``, in a new segment; monotonic time may begin anew behind it.

    ``reason``: how the part before it ended. ``away_s``: how long nothing was recorded, None if unknown;
    ``utc_back_s``: how far UTC is behind the last that was recorded, which is why.
    """

    reason: str
    start: int | None = left_out()
    stopped_mono_ns: int | None = left_out()
    stopped_utc_ns: int | None = None
    utc_ns: int | None = left_out()
    away_s: float | None = None
    unit_degC: float | None = None
    identities: Mapping[str, Any] | None = left_out()
    differences: Sequence[str] | None = left_out()
    segment: int | None = left_out()
    utc_back_s: float | None = left_out()

    def _words(self) -> str:
        back = "" if self.utc_back_s is None else f"; UTC is {self.utc_back_s:.0f} s behind what was recorded"
        return f"gone on with after: {self.reason}{back}"


@event("suspend", at_terminal=True, severity="alarm")
class Suspend(Event):
    """Nothing of the run went on for a while: the machine was asleep, or its processes were stopped."""

    seconds: float
    seen: Literal["boottime", "late beat"]

    def _words(self) -> str:
        what = "the machine was asleep" if self.seen == "boottime" else "this process was stopped"
        return f"{what} for {number(self.seconds, '.1f')} s ({self.seen}), and nobody watched the bench"


@event("hold", at_terminal=True)
class Hold(Event):
    """The run begins to stand still; ``by``: who wishes it. That its stimulus is off is confirmed by nobody yet."""

    step: int
    by: str
    reason: str

    @property
    def severity(self) -> Severity:
        return "warning" if self.by == OPERATOR else "alarm"

    @property
    def lasts(self) -> bool:
        return True

    def _words(self) -> str:
        return f"holding at step {self.step}: {self.reason} ({self.by})"


@event("release", at_terminal=True)
class Release(Event):
    """The run goes on after it stood still at a step."""

    step: int
    seconds: float

    def _words(self) -> str:
        return f"going on after {number(self.seconds, '.0f')} s"


@event("armed", at_terminal=True)
class Armed(Event):
    """Somebody at the bench lets it be energised again after a hold; or nobody is asked, for a declared ``reason``."""

    step: int
    by: str = left_out("")
    reason: str = left_out("")

    def _words(self) -> str:
        return f"armed at the bench by {self.by}" if self.by else f"nobody is asked to arm the bench: {self.reason}"


@event("skip", at_terminal=True)
class Skip(Event):
    """The steps from ``first`` up to ``stop`` are left out."""

    by: str
    reason: str
    first: int
    stop: int

    @property
    def told(self) -> bool:
        return self.by not in (DECISION, LEFT_OUT)  # the decision, or that the unit is left out, has been told

    def _words(self) -> str:
        return f"steps {self.first} to {self.stop - 1} left out: {self.reason} ({self.by})"


@event("unit_left_out", at_terminal=True, severity="alarm")
class UnitLeftOut(Event):
    """A unit of several is left out from ``step`` on; ``confirmed``: the instruments that were confirmed off for it."""

    slot: str
    step: int
    code: str
    reason: str
    confirmed: Sequence[str]

    @property
    def error_code(self) -> str | None:
        return self.code

    def _words(self) -> str:
        unit, off = f"unit {self.uut} in slot {self.slot}", ", ".join(self.confirmed)
        return f"{unit} is left out from step {self.step} on: {self.reason}; confirmed off: {off}"


@event("slip")
class Slip(Event):
    """The steps after this one are later than planned."""

    step: int
    seconds: float
    reason: str

    def _words(self) -> str:
        return f"step {self.step}: {number(self.seconds, '.3g')} s later than planned ({self.reason})"


@event("late", at_terminal=True)
class Late(Event):
    """A soak of the chamber ``role`` is not stable at the end of its slot; ``policy``: hold, skip or abort."""

    step: int
    policy: str
    last_degC: float
    slope_degC_min: float
    role: str = left_out("")
    target_degC: float | None = left_out()

    def _words(self) -> str:
        last, slope = number(self.last_degC, ".2f"), number(self.slope_degC_min, "+.3f")
        target = "" if self.target_degC is None else f" {self.target_degC:g} degC"
        soak = f"{self.role}{target} not stable at the end of its slot".strip()
        return f"step {self.step}: {soak}, last {last} degC, {slope} degC/min: {self.policy}"


@event("overrun")
class Overrun(Event):
    """The steps before this one took longer than the plan leaves for them."""

    step: int
    seconds: float

    def _words(self) -> str:
        late = number(self.seconds, ".2g")
        return f"step {self.step}: began {late} s late, what was before it took longer"


@event("retake")
class Retake(Event):
    """A record is taken back; its number is given again."""

    record: int
    reason: str

    def _words(self) -> str:
        return f"record {self.record} is taken again: {self.reason}"


@event("gap", at_terminal=True)
class Gap(Event):
    """A record that should follow another one without a gap begins anew."""

    step: int
    record: int
    first_counter: int

    def _words(self) -> str:
        return f"record {self.record} is begun anew, frames between it and the record before are lost"


@event("settled")
class Settled(Event):
    """How settled the temperature was at the end of a soak of the chamber ``role``: every sample of the last ``for_s``.

    ``chance``: that it leaves its band within as long again, as the samples have it; null if too few tell. Null for
    what no sample says.
    """

    step: int
    role: str
    target_degC: float
    within_degC: float
    for_s: float
    stable: bool
    samples: int
    mean_degC: float | None
    slope_degC_min: float | None
    spread_degC: float | None
    chance: float | None

    def _words(self) -> str:
        chance = "not known" if self.chance is None else f"{100.0 * self.chance:.1f} %"
        found = "stable" if self.stable else "NOT stable"
        return f"{found} at {self.target_degC:g} degC; chance that it leaves its band: {chance}"


@event("reentry")
class Reentry(Event):
    """The temperature is back at what a step needs; ``soaked``: by a soak of its whole slot."""

    step: int
    target_degC: float | None
    soaked: bool
    unit_degC: float | None
    seconds: float

    def _words(self) -> str:
        unit = "none" if self.unit_degC is None else number(self.unit_degC, ".2f")
        return f"back at {unit} degC{', soaked' if self.soaked else ''}"


@event("error", severity="warning")
class Error(Event):
    """A reading that failed, a fault of the recorder, or the error that ends the run (an ``End`` follows then).

    ``text`` is all of it; ``where``: what it belongs to; ``segment``, ``errno``: of a fault of the recorder.
    """

    code: str
    text: str
    step: int | None = left_out()
    where: str | None = left_out()
    segment: int | None = left_out()
    errno: int | None = left_out()

    @classmethod
    def of(cls, error: BenchError, step: int | None = None) -> Error:
        """Return an error as an event; ``step``: the one that it came in."""
        return cls(code=error.code, text=str(error), where=error.where, step=step)

    @property
    def topic(self) -> str:
        return f"error {self.code} {self.where}"

    @property
    def error_code(self) -> str | None:
        return self.code

    def _words(self) -> str:
        return self.text or self.code


@event("safe")
class Safe(Event):
    """The bench was made safe; ``failures``: what could not be confirmed, ``roles``: the instruments of these."""

    failures: Sequence[str]
    roles: Sequence[str] = left_out(())

    @property
    def unconfirmed(self) -> Sequence[str]:
        """Instruments that are not confirmed safe; the sentences of a session that names none."""
        return self.roles or self.failures

    @property
    def severity(self) -> Severity:
        return "fault" if self.failures else "none"

    def _words(self) -> str:
        return "; ".join(map(str, self.failures)) or "what drives, heats or moves was confirmed off, or on hold"


@event("end")
class End(Event):
    """The run is over; ``error``: code of what ended it, None if every step was done."""

    steps: int
    records: int
    slip_s: float
    overruns: int
    retaken: int
    lateness_ms: Sequence[float]  # median, 99th percentile, maximum
    error: str | None

    @property
    def severity(self) -> Severity:
        return "none" if self.error is None else "fault"

    @property
    def error_code(self) -> str | None:
        return self.error

    def _words(self) -> str:
        return "the run is done" if self.error is None else f"the run ended: {self.error}"


@event("closed")
class Closed(Event):
    """The recorder has closed the session: "done", or the code of the error."""

    reason: str


@event("config", at_terminal=True)
class Config(Event):
    """A file that the run was made from has changed while it went on."""

    file: str
    change: str

    def _words(self) -> str:
        return f"{self.file} is {self.change} on the disk; the run used its own copy"
