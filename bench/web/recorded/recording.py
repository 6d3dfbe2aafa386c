"""A finished session as a replay needs it: its messages in the order of time, and its state at any moment."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bench.frame import FrameDefinition, all_signals, parse_frame
from bench.model.clock import NS
from bench.model.errors import BenchError
from bench.model.events import event_of
from bench.model.yamlio import parse_yaml
from bench.plan import StationFile, Step, graphs_of, names_in, steps_of
from bench.record import Message, SessionReader, layout
from bench.run.feed.state import RunState

_TOPICS = frozenset({layout.EVENT, layout.INSTRUMENT, layout.CLOCK})
_PLAN, _STATIONS = "plan.json", "stations/"


@dataclass(frozen=True)
class Recording:
    """A session as it is shown again, without the bytes of its links.

    ``t_utc_s``: time of each message, never going backwards; UTC of the start of its part plus bench time elapsed.
    ``last_utc_s``: of the last message.
    """

    folder: Path
    manifest: dict[str, Any]
    texts: dict[str, str]
    t_utc_s: list[float]
    messages: list[Message]

    @property
    def first_utc_s(self) -> float:
        """Time of the first message; 0 if there is none."""
        return self.t_utc_s[0] if self.t_utc_s else 0.0

    @property
    def last_utc_s(self) -> float:
        """Time of the last message; 0 if there is none."""
        return self.t_utc_s[-1] if self.t_utc_s else 0.0

    def until(self, t_utc_s: float) -> int:
        """Return how many messages are not later than a time."""
        return bisect_right(self.t_utc_s, t_utc_s)


def read_recording(folder: Path) -> Recording:
    """Read the events and the traffic of the instruments of a session, and nothing else.

    Raises: InputError B-REC-010, SessionDamaged B-REC-012, B-REC-014.
    """
    reader = SessionReader(folder)
    manifest, texts = reader.manifest, reader.texts
    times: list[float] = []
    messages: list[Message] = []
    part: list[Message] = []
    offset_ns: int | None = None
    for message in reader.select(_TOPICS):
        if message.topic == layout.CLOCK:
            if offset_ns is None:
                pair = message.document()
                offset_ns = int(pair["t_utc_ns"]) - int(pair["t_mono_ns"])
            continue
        if message.topic == layout.EVENT and message.event()[0] == "resume":
            _place(part, offset_ns, times, messages)
            part, offset_ns = [], None
        part.append(message)
    _place(part, offset_ns, times, messages)
    return Recording(folder, manifest, texts, times, messages)


def _place(part: list[Message], offset_ns: int | None, times: list[float], messages: list[Message]) -> None:
    for message in part:
        t_utc_s = (message.t_ns + (offset_ns or 0)) / NS
        times.append(max(t_utc_s, times[-1]) if times else t_utc_s)
        messages.append(message)


@dataclass(frozen=True)
class Scenery:
    """The parts of a session's plan and YAML files in the state document; empty where a file is not there."""

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
    signals = all_signals(frames, [*names_in(entries, frames), *(name for graph in graphs for name in graph.signals)])
    instruments = {} if station is None else station.instruments
    return Scenery(
        steps=_steps(recording),
        places={role: (entry.driver, entry.resource) for role, entry in instruments.items()},
        signals=[{"name": signal.name, "unit": signal.unit, "decimals": signal.decimals} for signal in signals],
        graphs=[asdict(graph) for graph in graphs],
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
