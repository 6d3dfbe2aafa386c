"""The state document of a recording at a moment: its messages, handed to the same builder that a living run uses."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from typing import Any

from bench.frame import FrameDefinition, all_signals, parse_frame
from bench.model.errors import BenchError
from bench.model.events import event_of
from bench.model.yamlio import parse_yaml
from bench.plan import StationFile, Step, graphs_of, names_in, steps_of
from bench.record import Message, layout
from bench.run.feed.state import RunState
from bench.web.recorded.recording import Recording

_PLAN, _STATIONS = "plan.json", "stations/"


@dataclass(frozen=True)
class Scenery:
    """What of a session's plan and YAML files the state document shows; empty where a file is not there."""

    steps: tuple[Step, ...]
    places: dict[str, tuple[str, str]]
    signals: list[dict[str, Any]]
    graphs: list[dict[str, Any]]
    boot_id: str


def scenery_of(recording: Recording) -> Scenery:
    """Read a session's own copies of its plan, frames and station."""
    manifest, station = recording.manifest, _station(recording)
    frames = _frames(recording)
    entries = [] if station is None else station.graphs
    graphs = graphs_of(entries, frames, str(manifest.get("measurement_link", "")))
    signals = all_signals(frames, [*names_in(entries, frames), *(name for one in graphs for name in one.signals)])
    instruments = {} if station is None else station.instruments
    return Scenery(
        steps=_steps(recording),
        places={role: (entry.driver, entry.resource) for role, entry in instruments.items()},
        signals=[{"name": one.name, "unit": one.unit, "decimals": one.decimals} for one in signals],
        graphs=[asdict(one) for one in graphs],
        boot_id=hashlib.sha256(recording.folder.name.encode()).hexdigest()[:16],
    )


class RecordedState:
    """State of one recording; forward it goes on from where it was, backward it starts anew. For one user at a time."""

    def __init__(self, recording: Recording, scenery: Scenery) -> None:
        self.recording = recording
        self.scenery = scenery
        self._builder = self._anew()
        self._taken = 0

    def at(self, t_utc_s: float) -> dict[str, Any]:
        """Return the state document at a time of the recording."""
        count = self.recording.until(t_utc_s)
        if count < self._taken:
            self._builder = self._anew()
            self._taken = 0
        for index in range(self._taken, count):
            _tell(self._builder, self.recording.messages[index], self.recording.t_utc_s[index])
        self._taken = count
        document = self._builder.document(t_utc_s)
        if count == len(self.recording.messages) and document["outcome"] is None:
            document["state"] = "stopped"  # nothing follows, and it did not end
        return document

    def _anew(self) -> RunState:
        scenery = self.scenery
        state = RunState(
            scenery.steps, self.recording.manifest, source="replay", boot_id=scenery.boot_id,
            run=self.recording.folder.name, places=scenery.places, signals=scenery.signals, graphs=scenery.graphs,
        )  # fmt: skip
        state.on_start(self.recording.first_utc_s)
        return state


def _tell(state: RunState, message: Message, t_utc_s: float) -> None:
    try:
        if message.topic == layout.EVENT:
            kind, fields = message.event()
            state.on_event(event_of(kind, fields), t_utc_s)
        else:
            line = message.document()
            role = message.topic.removeprefix(layout.INSTRUMENT)
            state.on_traffic(role, str(line["direction"]), str(line["text"]), t_utc_s)
    except (BenchError, AttributeError, KeyError, TypeError, ValueError):  # somebody else's software wrote it
        return


def _steps(recording: Recording) -> tuple[Step, ...]:
    try:
        return steps_of(recording.texts[_PLAN])
    except (BenchError, KeyError):
        return ()


def _frames(recording: Recording) -> dict[str, FrameDefinition]:
    try:
        links = dict(recording.manifest.get("links") or {})
        return {link: parse_frame(recording.texts[file], file) for link, file in links.items()}
    except (BenchError, KeyError, ValueError):
        return {}


def _station(recording: Recording) -> StationFile | None:
    texts = recording.texts
    name = next((name for name in texts if name.startswith(_STATIONS)), None)
    try:
        return None if name is None else parse_yaml(texts[name], name, StationFile).model
    except BenchError:
        return None
