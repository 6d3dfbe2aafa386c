"""Events of what a run takes: records, readings, answers and temperatures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.model.events.event import Event, event, left_out, number

Conditions = Mapping[str, Any]
_RATIO = "1"  # unit of a ratio or a count


@event("record")
class Record(Event):
    """A record was taken: a window of frames of one link. ``samples``, ``pulse_timing`` and ``signals``: what
    is kept of it.

    A record of readings has no link and no frames; ``readings`` of it have a value, ``unread`` have none.
    """

    number: int
    link: str
    first_counter: int
    frames: int
    t_start_ns: int
    t_end_ns: int
    conditions: Conditions
    step: int = -1
    pulse_timing: bool = left_out(False)
    samples: bool = left_out(False)
    signals: Sequence[str] = left_out(())
    readings: int | None = left_out()
    unread: int | None = left_out()


@event("reading")
class Reading(Event):
    """An action of an instrument gave a value; None with ``quality`` and an error if it should have given one."""

    step: int
    role: str
    name: str
    value: Any
    conditions: Conditions
    quality: int | None = left_out()
    code: str | None = left_out()
    text: str | None = left_out()
    arguments: Mapping[str, Any] | None = left_out()


@event("decision", at_terminal=True)
class Decision(Event):
    """A step has decided by what was read last: ``word`` if, while or choose; ``outcome``: the branch that is done.

    ``readings``: each with name, value (None if it has none), unit, the step that took it and the arguments that were
    asked for; empty if none was taken.
    """

    step: int
    word: str
    readings: Sequence[Mapping[str, Any]]
    outcome: str

    @property
    def by(self) -> str:
        """Return its readings, for a person."""
        return ", ".join(map(_read, self.readings)) or "not read"

    def _words(self) -> str:
        return f"step {self.step}: {self.word} {self.by}: {self.outcome}"


@event("thermal_lag", at_terminal=True)
class ThermalLag(Event):
    """How the unit came to rest in a soak that its lag may end: ``share`` is the standard uncertainty over the lag.

    ``residual_degC``: where the unit was minus where it went; ``bound_degC``: how far from there at most, by three
    standard uncertainties.   ``saved_s``: rest of the slot that was left out, 0 for a whole one.
    """

    step: int
    lag_s: float
    share: float
    residual_degC: float
    bound_degC: float
    saved_s: float

    def _words(self) -> str:
        lag, left = number(self.lag_s / 60.0, ".1f"), number(self.residual_degC, "+.3f")
        known = f"lag {lag} min known to {number(100.0 * self.share, '.2g')} %"
        near = f"{left} degC from its end, {number(self.bound_degC, '.3f')} degC at most"
        saved = f"the last {number(self.saved_s / 60.0, '.0f')} min of the slot are left out" if self.saved_s else ""
        return f"step {self.step}: {', '.join(filter(None, (known, near, saved)))}"


@event("answer")
class Answer(Event):
    """The unit answered a command that carries no number; ``payload`` in hex."""

    step: int
    role: str
    name: str
    status: int
    payload: str


@event("exchange")
class Exchange(Event):
    """A numbered command and what came back; ``status`` is None if nobody answered, payloads are in hex."""

    step: int
    item: str
    name: str
    role: str
    sequence: int
    attempts: int
    begin_ns: int
    end_ns: int
    status: int | None
    refused: bool
    sent: str
    received: str
    ignored: int
    conditions: Conditions


@event("prompt")
class Prompt(Event):
    """A person has answered a question; ``value`` is None if it was a confirmation.

    ``quantity``: what of the unit under test the value is, under which ``conditions``; None for what is no measurement.
    """

    step: int
    text: str
    confirm: str
    by: str
    value: float | None
    unit: str
    low: float | None
    high: float | None
    sets: Mapping[str, Any] | None = left_out()
    quantity: str | None = left_out()
    conditions: Mapping[str, Any] | None = left_out()

    def _words(self) -> str:
        value = "done" if self.value is None else f"{self.value:g} {self.unit}"
        value = f"{100.0 * self.value:g} %" if self.value is not None and self.unit == _RATIO else value
        return f"{self.text} {value} ({self.by})"


def _read(reading: Mapping[str, Any]) -> str:
    value = reading.get("value")
    unit = "" if reading.get("unit") == _RATIO else f" {reading.get('unit')}"
    shown = f"{value:.6g}{unit}" if isinstance(value, int | float) else "without a value"
    return f"{reading.get('name')} {shown}"


@event("environment")
class Environment(Event):
    """True temperatures of the chamber's air and of the unit, once a minute.

    Where several units share a campaign there is one without ``uut``, of the hottest of them, and one of each unit.
    """

    air_degC: float | None
    unit_degC: float | None


@event("surroundings")
class Surroundings(Event):
    """Temperatures that a logger scanned, by channel."""

    role: str
    degC: Mapping[str, float]


@event("preflight")
class Preflight(Event):
    """Findings of the pre-flight before a run; each has name, status, value, limit and text."""

    ok: int
    warn: int
    fail: int
    skipped: int
    findings: Sequence[Mapping[str, str]]
