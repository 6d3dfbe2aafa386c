"""The state of the bench for the people beside it: what is on, by whose word, how old that is, what stays dangerous.

Folded from events, commands and replies, by what each driver declares of its replies (``Tells``): one fold for page,
terminal, messages, metrics and recordings. A command never switches anything off here: only a reply does, and only for
as long as it is good; of an instrument the newest counts, over all of them the worst. Behind the run its guard has the
last word. Software cannot say that a bench may be touched, so no word here means that.

Behind it the instrument panel: last command and reply of every instrument, how long it took, and its error queue.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import lru_cache
from typing import Any, Literal

from bench.model.drivers import driver_class, manual_of
from bench.model.errors import BenchError
from bench.model.events import End, Event, Release, Resume, Safe, StimulusAlarm
from bench.model.ports import Effect, Tells, effects_of
from bench.model.units import format_quantity
from bench.run.guard.last_words import roles_in_words

Kind = Literal["source", "switch", "supply", "chamber", "table", "signal", "unknown"]
LOOK_WALL_S, LOOK_VIRTUAL_S = 60.0, 1800.0  # between two looks; nobody stands beside a rehearsal
GOOD_FOR = 2.5  # looks; a look waits for a quiet moment for as long as one more period
LAST_LOOK_S = 30.0  # before the end: three attempts to make safe and the look behind them fit into it
HOT_degC, COLD_degC = 50.0, 0.0  # nobody is burnt by a touch of metal below (ISO 13732-1), no skin freezes above
ALL = "all"  # in the place of a role: a guard that is at it has not said yet which instruments are safe
_DIGITS = 5
_PLAIN = frozenset({"current", "voltage", "frequency", "amplitude", "mode"})  # their unit says what they are
_KINDS: tuple[tuple[Effect, Kind], ...] = (
    (Effect.MOTION_ON, "table"), (Effect.THERMAL, "chamber"), (Effect.STIMULUS_ON, "source"),
    (Effect.POWER, "supply"), (Effect.ROUTE, "switch"),
)  # fmt: skip


@dataclass
class _Part:
    """One instrument that can hold energy. ``said``: by question, whether it says on, and when (UTC second)."""

    role: str
    kind: Kind
    driver: str
    tells: Tells | None
    asked: str = ""
    said: dict[str, tuple[bool, float]] = field(default_factory=dict)
    figures: dict[str, tuple[str, str | tuple[str, ...], float, float]] = field(default_factory=dict)
    answers_on: bool = False  # by its newest reply
    switched_on_s: float = -math.inf  # the last command that switches something on
    disturbed_s: float = -math.inf  # the last command that may have done anything

    def on_command(self, text: str, t: float) -> None:
        self.asked = text
        touch = _touch(self.driver, text)
        if touch in ("energises", "moves"):
            self.switched_on_s = t
            self.said = {question: said for question, said in self.said.items() if said[0]}  # off was before it
        elif touch is None and "?" not in text:
            self.disturbed_s = t

    def on_reply(self, text: str, t: float) -> None:
        self.answers_on = False
        if self.tells is None:
            return
        try:
            if (reads := self.tells.on.get(self.asked)) is not None:
                self.answers_on = reads(text)
                self.said[self.asked] = (self.answers_on, t)
            if (figure := self.tells.figures.get(self.asked)) is not None:
                value = figure.read(text)
                number = math.nan if isinstance(value, tuple) else value
                shown = value if isinstance(value, tuple) else format_quantity(value, figure.unit, _DIGITS)
                self.figures[self.asked] = (figure.name, shown, number, t)
        except ValueError:  # a reply that is not understood says nothing; the driver has told the run
            self.said.pop(self.asked, None)

    def known(self) -> tuple[bool | None, float | None]:
        """Return whether it is on, None if that is not known, and when it was confirmed last."""
        if self.tells is None:
            return None, None
        on = [t for is_on, t in self.said.values() if is_on]
        if on:
            return True, max(on)
        if len(self.said) < len(self.tells.on):
            return (True, self.switched_on_s) if self.switched_on_s > -math.inf else (None, None)
        oldest = min((t for _, t in self.said.values()), default=-math.inf)
        return (None, None) if self.disturbed_s > oldest else (False, oldest)

    def number(self, name: str) -> float:
        """Return the newest figure of a name, NaN without one."""
        return next((number for label, _, number, _ in self.figures.values() if label == name), math.nan)


class BenchState:
    """What of a bench is on. Args: places: driver and resource by role. good_for_s: longest age of a reply, second."""

    def __init__(self, places: Mapping[str, tuple[str, str]], good_for_s: float) -> None:
        self._good_for_s = good_for_s
        parts = {role: _part(role, driver) for role, (driver, _) in places.items()}
        self._parts = {role: part for role, part in parts.items() if part is not None}
        self._unconfirmed: dict[str, tuple[Event, float]] = {}  # by instrument: what told it, and when
        self._ended_utc_s: float | None = None

    def on_event(self, event: Event, t_utc_s: float) -> None:
        """Take what the run says of its instruments: which are to be made safe and have not confirmed it."""
        match event:
            case Resume():
                self._unconfirmed, self._ended_utc_s = {}, None
            case Release():
                self._unconfirmed = {}
            case StimulusAlarm():
                self._unconfirmed[event.role] = event, t_utc_s
            case Safe():
                self._unconfirmed = dict.fromkeys(event.unconfirmed, (event, t_utc_s))
            case End():
                self._ended_utc_s = t_utc_s

    def on_traffic(self, role: str, direction: str, text: str, t_utc_s: float) -> Event | None:
        """Take a command to ("tx") or a reply of ("rx") an instrument; returns the event whose trouble is over by it.

        What a driver notes between them, when a command is in doubt, is in no table: nothing is known until it answers.
        """
        part = self._parts.get(role)
        if part is None:
            return None
        (part.on_command if direction == "tx" else part.on_reply)(text.strip(), t_utc_s)
        told = self._unconfirmed.get(role)
        if told is None or not self.off_since(role, told[1]):
            return None
        return self._unconfirmed.pop(role)[0]

    @property
    def on(self) -> set[str]:
        """Roles that are on, by what they answered and were told since."""
        return {role for role, part in self._parts.items() if part.known()[0]}

    def answers_on(self, role: str) -> bool:
        """Return whether the newest reply of an instrument says that it is on, whatever it was told."""
        return role in self._parts and self._parts[role].answers_on

    def off_since(self, role: str, t_utc_s: float) -> bool:
        """Return whether an instrument has answered that it is off, to every question, later than ``t_utc_s``."""
        on, confirmed = self._parts[role].known() if role in self._parts else (None, None)
        return on is False and confirmed is not None and confirmed > t_utc_s

    @property
    def unconfirmed(self) -> dict[str, str]:
        """Instruments that were to be made safe and have not confirmed it, each with the code of why."""
        return {role: event.error_code or "" for role, (event, _) in self._unconfirmed.items()}

    def document(self, now_utc_s: float) -> dict[str, Any]:
        """Return the entry ``bench`` of the state document; what is unconfirmed is not off, whatever it has said.

        Of a run that has ended the last look counts, and nobody looks any more.
        """
        unconfirmed, ended_utc_s = self.unconfirmed, self._ended_utc_s
        oldest = now_utc_s - self._good_for_s if ended_utc_s is None else ended_utc_s - LAST_LOOK_S
        parts = [
            _part_document(part, math.inf if role in unconfirmed and not part.known()[0] else oldest)
            for role, part in self._parts.items()
        ]
        held = [part for part in parts if part["kind"] != "switch"]  # a closed route holds no energy of its own
        states = {part["state"] for part in held}
        if any(part["state"] == "on" and part["kind"] == "table" for part in held):
            word = "moving"
        elif "on" in states:
            word = "energised"
        else:
            word = "unknown" if "unknown" in states or not held or unconfirmed else "off"
        decisive = [part for part in held if part["state"] == ("off" if word == "off" else "on")]
        times = [part["confirmed_utc_s"] for part in decisive if part["confirmed_utc_s"] is not None]
        return {
            "state": word,
            "confirmed_utc_s": min(times, default=None),
            "good_for_s": self._good_for_s,
            "ended_utc_s": ended_utc_s,
            "unconfirmed": unconfirmed,
            "parts": parts,
            "remains": self._remains(),
        }

    def _remains(self) -> list[str]:
        """Return what stays dangerous when all is off, as words of a catalogue: mains, hot, cold."""
        air = [part.number("air") for part in self._parts.values() if part.kind == "chamber"]
        hot, cold = any(degC > HOT_degC for degC in air), any(degC < COLD_degC for degC in air)
        return ["mains", *(["hot"] if hot else []), *(["cold"] if cold else [])]


UNHEARD: Mapping[str, Any] = {
    "state": "unknown", "confirmed_utc_s": None, "good_for_s": None, "ended_utc_s": None, "unconfirmed": None,
    "parts": [], "remains": ["mains"],
}  # fmt: skip
"""Entry ``bench`` of a run that nobody hears of any more."""


def guarded_bench(guard: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry ``bench`` behind a guard (``guard_word``): off only where it has confirmed all of it."""
    if not guard["safe"]:
        return {**UNHEARD, "unconfirmed": guard["unsafe"] or {ALL: ""}}
    utc_s = None
    with suppress(ValueError):
        utc_s = datetime.fromisoformat(str(guard["utc"])).timestamp()
    return {**UNHEARD, "state": "off", "confirmed_utc_s": utc_s, "ended_utc_s": utc_s, "unconfirmed": {}}


WORDS: Mapping[str, str] = {
    "off": "OUTPUTS OFF", "energised": "ENERGISED", "moving": "MOVING", "unknown": "UNKNOWN what is on",
}  # fmt: skip


def bench_in_words(bench: Mapping[str, Any]) -> str:
    """Return the state of the bench in one line for a message: ``ENERGISED: supply 18 V, 1.25 A; chamber running``."""
    unconfirmed = bench["unconfirmed"]
    unsafe = [f"NOT confirmed off: {roles_in_words(unconfirmed)}"] if unconfirmed else []
    on = [f"{part['role']} {figures_of(part)}".strip() for part in bench["parts"] if part["state"] == "on"]
    silent = [part["role"] for part in bench["parts"] if part["state"] == "unknown"]
    unknown = [f"{role} not known" for role in silent if role not in unconfirmed]
    said = "; ".join(unsafe + on + unknown)
    word = WORDS[bench["state"]]
    return f"{word}: {said}" if said else word


def figures_of(part: Mapping[str, Any]) -> str:
    """Return the figures of an instrument, those that need it with their name."""
    shown = (
        figure["text"] if figure["name"] in _PLAIN else f"{figure['name']} {figure['text']}"
        for figure in part["figures"]
    )
    return ", ".join(shown)


def _part_document(part: _Part, oldest: float) -> dict[str, Any]:
    """Return one instrument; what was confirmed before ``oldest`` (UTC second) is not known any more."""
    on, confirmed = part.known()
    state = "unknown" if on is None or confirmed is None or confirmed < oldest else "on" if on else "off"
    figures = [
        {"name": name, "text": ", ".join(shown) or "none" if isinstance(shown, tuple) else shown, "t_utc_s": t}
        for name, shown, _, t in part.figures.values()
    ]
    return {"role": part.role, "kind": part.kind, "state": state, "confirmed_utc_s": confirmed, "figures": figures}


def _part(role: str, driver: str) -> _Part | None:
    """Return an instrument that can hold energy; None for one that only reads."""
    try:
        found = driver_class(driver)
    except BenchError:  # a recording of a bench whose driver is not here: nothing can be told of it
        return _Part(role, "unknown", driver, None)
    effects = effects_of(found)
    kind = next((kind for effect, kind in _KINDS if effect in effects), None)
    tells: Tells | None = getattr(found, "tells", None)
    if kind is None and tells is None:
        return None
    return _Part(role, kind or "signal", driver, tells)


@lru_cache(maxsize=4096)
def _touch(driver: str, text: str) -> str | None:
    """Return what a command does by the table of its model; None if it stands in none."""
    manual = manual_of(driver)
    form = None if manual is None else manual.find(text)
    return None if manual is None or form is None else manual.commands[form].touch


LONGEST_TEXT = 200
_NUMBER = re.compile(r"\s*([+-]?\d+)")
# Questions for the error queue or the standing faults, as the drivers ask them; a reply of 0 says that all is well.
QUEUE_QUESTIONS = frozenset({"SYST:ERR?", "FAULT?", "ERRSTR?", "ALRM1?"})


@dataclass
class _Line:
    driver: str | None = None
    resource: str | None = None
    identity: str | None = None
    command: str | None = None
    reply: str | None = None
    t_utc_s: float | None = None
    sent_utc_s: float | None = None
    answer_ms: float | None = None
    error: str | None = None
    errors: int = 0
    state: Literal["ok", "away", "error"] = "ok"


class InstrumentPanel:
    """One line for each instrument, by role; fed with every command and reply.

    ``errors`` counts the entries of the error queue that were not "no error". ``state``: "error" from such an entry (or
    an event ``error`` of the role) until the queue is found empty again, "away" while the run waits for the instrument.
    """

    def __init__(self, identities: Mapping[str, Any], places: Mapping[str, tuple[str, str]]) -> None:
        self._lines: dict[str, _Line] = {}
        for role in [*places, *(role for role in identities if role not in places)]:
            driver, resource = places.get(role, (None, None))
            self._lines[role] = _Line(driver, resource, _identity(identities.get(role)))

    def on_traffic(self, role: str, direction: str, text: str, t_utc_s: float) -> None:
        """A command to ("tx") or a reply of ("rx") an instrument."""
        line = self._lines.setdefault(role, _Line())
        line.t_utc_s = t_utc_s
        text = text.strip()
        if direction == "tx":
            line.command, line.reply, line.sent_utc_s, line.answer_ms = text[:LONGEST_TEXT], None, t_utc_s, None
            return
        line.reply = text[:LONGEST_TEXT]
        if line.sent_utc_s is not None:
            line.answer_ms, line.sent_utc_s = round(max(0.0, t_utc_s - line.sent_utc_s) * 1e3, 3), None
        if line.command is not None and line.command.lstrip(":") in QUEUE_QUESTIONS:
            _judge(line)

    def trouble(self, role: str, text: str) -> None:
        """An instrument did not do what it was asked to."""
        if role in self._lines:
            self._lines[role].error, self._lines[role].state = text[:LONGEST_TEXT], "error"

    def away(self, roles: frozenset[str]) -> None:
        """The instruments that the run waits for; the others are there."""
        for role, line in self._lines.items():
            if role in roles:
                line.state = "away"
            elif line.state == "away":
                line.state = "ok"

    @property
    def roles(self) -> tuple[str, ...]:
        """Every instrument that is known."""
        return tuple(self._lines)

    def documents(self) -> dict[str, dict[str, Any]]:
        """Return all lines, as part of the state document."""
        lines = {role: vars(line).items() for role, line in self._lines.items()}
        return {role: {name: value for name, value in line if name != "sent_utc_s"} for role, line in lines.items()}


def _judge(line: _Line) -> None:
    match = _NUMBER.match(line.reply or "")
    if match is None:
        return
    if int(match[1]) == 0:
        line.state = "ok" if line.state == "error" else line.state
    else:
        line.errors += 1
        line.error, line.state = line.reply, "error"


def _identity(identity: Any) -> str | None:
    if not isinstance(identity, Mapping):
        return None if identity is None else str(identity)
    words = (identity.get("manufacturer"), identity.get("model"), identity.get("serial"), identity.get("firmware"))
    return " ".join(str(word) for word in words if word) or None
