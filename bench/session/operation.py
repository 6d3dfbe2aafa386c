"""What people and the surroundings did to a run, for the report: commands, alarms, temperatures around the unit."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from bench.model import events
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.model.events import Control, End, Phase
from bench.model.units import hours
from bench.model.yamlio import parse_yaml
from bench.plan import StationFile
from bench.report import Surrounding
from bench.session.happenings import Events, happening_tables

_ALARMS = ("alarm", "interlock")
_OF_COMMAND = ("what", "by", "reason")
_LABORATORY = "lab_air"
_PLAN = "plan.json"


def commands_given(view: Events) -> list[dict[str, Any]]:
    """Return every command a person gave: when since the run began, what, who, why, and what else was said with it."""
    start_ns = _start_ns(view)
    found = []
    for t_ns, command in view.events_of(Control):
        fields = command.document()
        more = {name: value for name, value in fields.items() if name not in _OF_COMMAND and value not in (None, "")}
        known = {name: fields.get(name) or "–" for name in _OF_COMMAND}
        found.append({"time": hours((t_ns - start_ns) / NS), **known, **more})
    return found


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
    found = []
    for place, readings in sorted(scans.items()):
        t_s, degC = np.array(readings).T
        found.append(Surrounding(" ".join(place), t_s, degC, laboratory=place in rooms))
    return found


def _laboratory(texts: Mapping[str, str]) -> set[tuple[str, str]]:
    """Role and channel of what measures the air of the room, by the interlocks of the station."""
    found: set[tuple[str, str]] = set()
    for name, text in texts.items():
        if name.startswith("stations/"):
            try:
                interlocks = parse_yaml(text, name, StationFile).model.interlocks.values()
            except InputError:  # a station of another version: its channels keep their numbers
                continue
            found |= {(str(one.of), str(one.channel)) for one in interlocks if one.signal == _LABORATORY}
    return found


def hashes_of(texts: Mapping[str, str]) -> dict[str, str]:
    """SHA-256 of the YAML texts of a session by name; the compiled plan has its own hash in results.json."""
    return {name: _sha256(texts[name]) for name in _yaml(texts)}


def _yaml(texts: Iterable[str]) -> list[str]:
    return sorted(name for name in texts if name != _PLAN)


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _start_ns(view: Events) -> int:
    return min((t_ns for t_ns, _ in view.events_of(Phase)), default=0)
