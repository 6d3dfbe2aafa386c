"""Happenings of a run, for the terminal and the report: what did not go to plan, what people and surroundings did."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np

from bench.analysis import Table, worded_table
from bench.model import events
from bench.model.clock import NS, utc_text
from bench.model.errors import InputError
from bench.model.events import (
    DECISION,
    LEFT_OUT,
    Control,
    Decision,
    End,
    Event,
    Guard,
    Link,
    Phase,
    Preflight,
    Settled,
    Skip,
    ThermalLag,
)
from bench.model.units import hours
from bench.model.yamlio import parse_yaml
from bench.plan import StationFile
from bench.replay import Splice
from bench.report import Surrounding
from bench.session.wording import say

E = TypeVar("E", bound=Event)
KINDS = (
    "late", "slip", "overrun", "retake", "hold", "release", "armed", "skip", "control", "interlock", "alarm",
    "verdict", "link", "guard", "suspend", "clock_step", "config", "error", "unit_left_out",
)  # fmt: skip
_ALARMS = ("alarm", "interlock")
_OF_COMMAND = ("what", "by", "reason")
_LABORATORY = "lab_air"
_PLAN = "plan.json"
_SPLICE = ("stopped", "started", "away", "step", "reason", "drift", "then")
_SETTLING = ("time", "set", "samples", "mean", "slope", "spread", "chance", "found")
_LAG = ("time", "step", "lag", "share", "residual", "bound", "saved")


class Events(Protocol):
    """A session, as far as its events are asked for."""

    @property
    def events(self) -> Sequence[tuple[int, Event]]:
        """Return all that is kept, with its time."""

    def events_of(self, model: type[E]) -> list[tuple[int, E]]:
        """Return times and events of one kind."""


def happenings(view: Events) -> list[str]:
    """Return one line for each thing that did not go to plan, by kind, and how punctual the run was."""
    start_ns = _start_ns(view)
    troubles = sorted(_troubles(view), key=lambda trouble: KINDS.index(trouble[1].kind))
    said = [f"{event.kind} at {_since(t_ns, start_ns)}: {event.sentence}" for t_ns, event in troubles]
    return [*said, *punctuality(view)]


def happening_tables(view: Events) -> list[Table]:
    """Return the same as a table of the report, in order of time; none for a run to which nothing happened."""
    start_ns = _start_ns(view)
    troubles = sorted((t_ns, event.kind, event.sentence) for t_ns, event in _troubles(view))
    rows = [[_since(t_ns, start_ns), kind, text] for t_ns, kind, text in troubles]
    return _tables("happening", ("time", "what", "text"), rows, prose=True)


def settling_tables(view: Events) -> list[Table]:
    """Return how settled the temperature was at the end of each soak; none for a run without a soak."""
    start_ns = _start_ns(view)
    rows = [[_since(t_ns, start_ns), *_settled_cells(event)] for t_ns, event in view.events_of(Settled)]
    return _tables("settling", _SETTLING, rows)


def lag_tables(view: Events) -> list[Table]:
    """Return how near its end each soak came that the lag of a unit may end; none for a run without such a soak."""
    found, start_ns = view.events_of(ThermalLag), _start_ns(view)
    rows = [
        [
            _since(t_ns, start_ns), event.step, *([event.uut] if event.uut else []), f"{event.lag_s / 60.0:.2f}",
            f"{100.0 * event.share:.2g} %", f"{event.residual_degC:+.3f}", f"{event.bound_degC:.3f}",
            f"{event.saved_s / 60.0:.0f}",
        ]
        for t_ns, event in found
    ]  # fmt: skip
    of_unit = ["unit"] if found and found[0][1].uut else []
    return _tables("lag", (*_LAG[:2], *of_unit, *_LAG[2:]), rows)


def decision_tables(view: Events) -> list[Table]:
    """Return what the sequence has decided, and by what; none for a run without a decision."""
    heads, start_ns = ("step", "word", "by", "outcome"), _start_ns(view)
    rows = [
        [_since(t_ns, start_ns), *(getattr(event, head) for head in heads)] for t_ns, event in view.events_of(Decision)
    ]
    return _tables("decision", ("time", *heads), rows)


def _tables(name: str, heads: Sequence[str], rows: list[list[Any]], *, prose: bool = False) -> list[Table]:
    """Return the table of this name with its words from the catalogue; none without rows."""
    return [worded_table(say, name, heads, rows, prose=prose)] if rows else []


def _settled_cells(event: Settled) -> list[Any]:
    numbers = (
        "–" if value is None else format(value, form)
        for value, form in ((event.mean_degC, ".3f"), (event.slope_degC_min, "+.4f"), (event.spread_degC, ".3f"))
    )
    chance = say("settling.unknown") if event.chance is None else f"{100.0 * event.chance:.1f} %"
    set_to = say("settling.target", target=event.target_degC, within=event.within_degC, seconds=event.for_s)
    found = say("settling.stable" if event.stable else "settling.not_stable")
    return [set_to, event.samples, *numbers, chance, found]


def preflight_table(event: Preflight) -> Table:
    """Return the event "preflight" of a session as a table of its report."""
    keys = ("name", "status", "value", "limit", "text")
    rows = [[str(row[key]) for key in keys] for row in event.findings]
    return worded_table(say, "preflight", keys, rows)


def punctuality(view: Events) -> Iterator[str]:
    """Return how late the timed waits ended."""
    for _, end in view.events_of(End):
        median, p99, worst = (_length(1e-3 * late_ms) for late_ms in end.lateness_ms)
        late = {"median": median, "p99": p99, "worst": worst}
        yield say("timer", steps=end.steps, slip=_length(end.slip_s), overruns=end.overruns, **late)


def _length(seconds: float) -> str:
    """Return a time with three digits, in the unit that needs no power of ten; they stay on one line."""
    if abs(seconds) < 0.9995:
        return f"{1e3 * seconds:.3g}\u00a0ms"
    return f"{seconds:.3g}\u00a0s" if abs(seconds) < 999.5 else f"{seconds / 3600:.3g}\u00a0h"


def _start_ns(view: Events) -> int:
    """Return when the run began, as the lines of its progress count; the bench clock may begin with the machine."""
    return min((t_ns for t_ns, _ in view.events_of(Phase)), default=0)


def _since(t_ns: int, start_ns: int) -> str:
    return hours(max(0, t_ns - start_ns) / NS)


def _troubles(view: Events) -> Iterator[tuple[int, Event]]:
    for t_ns, event in view.events:
        as_it_should_be = isinstance(event, Link | Guard) and event.state in ("open", "ready")
        as_it_should_be |= isinstance(event, Skip) and event.by in (DECISION, LEFT_OUT)
        if event.kind in KINDS and not as_it_should_be:
            yield t_ns, event


def commands_given(view: Events) -> list[dict[str, Any]]:
    """Return every command a person gave: when since the run began, what, who, why, and what else was said with it."""
    start_ns = _start_ns(view)
    commands = []
    for t_ns, command in view.events_of(Control):
        said = {name: value for name, value in command.document().items() if value not in (None, "")}
        commands.append({"time": hours((t_ns - start_ns) / NS), **dict.fromkeys(_OF_COMMAND, "–"), **said})
    return commands


def alarms_raised(view: Events) -> list[dict[str, Any]]:
    """Return every alarm and what the interlocks did, in order of time."""
    rows = (row for table in happening_tables(view) for row in table.rows)
    return [{"time": time, "what": kind, "text": text} for time, kind, text in rows if kind in _ALARMS]


def length_s(view: Events) -> float:
    """From the first phase to the end of the run; NaN for one that has not ended or a log of another system."""
    ends = [t_ns for t_ns, _ in view.events_of(End)]
    return (ends[-1] - _start_ns(view)) / NS if ends and view.events_of(Phase) else math.nan


def surroundings(view: Events, texts: Mapping[str, str], campaign_ns: int) -> list[Surrounding]:
    """Return temperatures that a logger scanned, by channel, against the start of the campaign phase."""
    scans: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for t_ns, scan in view.events_of(events.Surroundings):
        for channel, degC in scan.degC.items():
            scans.setdefault((scan.role, str(channel)), []).append(((t_ns - campaign_ns) / NS, float(degC)))
    rooms = _laboratory(texts)
    places = []
    for place, readings in sorted(scans.items()):
        t_s, degC = np.array(readings).T
        places.append(Surrounding(" ".join(place), t_s, degC, laboratory=place in rooms))
    return places


def _laboratory(texts: Mapping[str, str]) -> set[tuple[str, str]]:
    """Return role and channel of what measures the air of the room, by the interlocks of the station."""
    rooms: set[tuple[str, str]] = set()
    for name, text in texts.items():
        if name.startswith("stations/"):
            try:
                interlocks = parse_yaml(text, name, StationFile).model.interlocks.values()
            except InputError:  # a station of another version: its channels keep their numbers
                continue
            rooms |= {
                (str(interlock.of), str(interlock.channel))
                for interlock in interlocks
                if interlock.signal == _LABORATORY
            }
    return rooms


def hashes_of(texts: Mapping[str, str]) -> dict[str, str]:
    """Return SHA-256 of the YAML texts of a session by name; the compiled plan has its own hash in results.json."""
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in sorted(texts.items()) if name != _PLAN}


def splice_documents(splices: Sequence[Splice]) -> list[dict[str, Any]]:
    """Return entries of "splices" in results.json."""
    return [
        {
            "stopped": _utc(splice.stopped_utc_ns),
            "started": _utc(splice.started_utc_ns),
            "away_s": splice.away_s,
            "step": splice.step,
            "reason": splice.reason,
            "drift_degC": splice.drift_degC,
            "soaked": splice.soaked,
        }
        for splice in splices
    ]


def splice_tables(splices: Sequence[Splice]) -> list[Table]:
    """Return the table "Splices" of the report; none for a run that was never stopped."""
    unknown = say("splice.unknown")
    rows = [
        [
            _utc(splice.stopped_utc_ns) or unknown,
            _utc(splice.started_utc_ns) or unknown,
            unknown if splice.away_s is None else f"{splice.away_s:.0f} s",
            str(splice.step),
            splice.reason,
            unknown if splice.drift_degC is None else f"{splice.drift_degC:+.2f} degC",
            say("splice.soaked" if splice.soaked else "splice.at_once"),
        ]
        for splice in splices
    ]
    behind = [] if all(splice.placed for splice in splices) else [say("splice.behind")]
    tables = _tables("splice", _SPLICE, rows, prose=True)
    return [replace(table, caption=" ".join([table.caption, *behind])) for table in tables]


def _utc(t_ns: int | None) -> str | None:
    return None if t_ns is None else utc_text(t_ns)
