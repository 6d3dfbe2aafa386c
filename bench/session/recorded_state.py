"""A finished session as a replay needs it: its messages in the order of time, and its state at any moment."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.model.clock import NS
from bench.model.errors import BenchError
from bench.model.events import event_of
from bench.model.yamlio import parse_yaml
from bench.plan import InterlockRule, Station, StationFile, Step, graphs_of, recorded_rules, shown_signals, steps_of
from bench.record import Message, SessionReader, layout
from bench.replay import frames_of
from bench.run.feed.bench_state import UNHEARD, guarded_bench
from bench.run.feed.run_state import RunState
from bench.run.feed.scenery import graph_rows, limit_rows, signal_rows
from bench.run.guard.diary import guard_word

_TOPICS = frozenset({layout.EVENT, layout.INSTRUMENT, layout.CLOCK})
_PLAN, _STATIONS, _SEQUENCES = "plan.json", "stations/", "sequences/"


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
    """Place a part by its UTC; where that went back, right behind the part before."""
    if part and times:
        offset_ns = max(offset_ns or 0, round(times[-1] * NS) - part[0].t_ns)
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
    limits: list[dict[str, Any]]
    boot_id: str


def scenery_of(recording: Recording) -> Scenery:
    """Read a session's own copies of its plan, frames and station."""
    manifest, station = recording.manifest, _station(recording.texts)
    instruments = {} if station is None else station.instruments
    return Scenery(
        steps=_steps(recording),
        places={role: (entry.driver, entry.resource) for role, entry in instruments.items()},
        **_drawn(manifest, recording.texts, station),
        limits=[] if station is None else limit_rows(_rules(recording, station), station.guard_limits_degC),
        boot_id=hashlib.sha256(recording.folder.name.encode()).hexdigest()[:16],
    )


def outline_of(folder: Path) -> dict[str, Any]:
    """Return ``signals`` and ``graphs`` of a session from its first segment. Raises: InputError, SessionDamaged."""
    reader = SessionReader(folder)
    return _drawn(reader.manifest, reader.texts, _station(reader.texts))


def _drawn(
    manifest: dict[str, Any], texts: Mapping[str, str], station: Station | None
) -> dict[str, list[dict[str, Any]]]:
    frames = frames_of(manifest, texts)
    entries = [] if station is None else station.file.graphs
    graphs = graphs_of(entries, frames, str(manifest.get("measurement_link", "")))
    signals = shown_signals(graphs, frames)
    return {"signals": signal_rows(signals, manifest), "graphs": graph_rows(graphs, signals, manifest)}


class RecordedState:
    """State of one recording; forward it goes on from where it was, backward it starts anew. For one user at a time.

    Args: end: the document at the end of the recording, where it is known already: many messages need not be taken.
    """

    def __init__(self, recording: Recording, scenery: Scenery, end: dict[str, Any] | None = None) -> None:
        self.recording = recording
        self.scenery = scenery
        self._end = end
        self._builder = self._anew()
        self._taken = 0

    def at(self, t_utc_s: float) -> dict[str, Any]:
        """Return the state document at a time of the recording."""
        if self._end is not None and t_utc_s == self.recording.last_utc_s:
            return dict(self._end)
        count = self.recording.until(t_utc_s)
        if count < self._taken:
            self._builder = self._anew()
            self._taken = 0
        for index in range(self._taken, count):
            _tell(self._builder, self.recording.messages[index], self.recording.t_utc_s[index])
        self._taken = count
        document = self._builder.document(t_utc_s)
        if count == len(self.recording.messages) and document["outcome"] is None:
            document |= {"state": "stopped", "bench": dict(UNHEARD)}  # nothing follows, and it did not end
        return document

    def _anew(self) -> RunState:
        scenery = self.scenery
        state = RunState(
            scenery.steps, self.recording.manifest, source="replay", boot_id=scenery.boot_id,
            run=self.recording.folder.name, places=scenery.places, signals=scenery.signals, graphs=scenery.graphs,
            limits=scenery.limits,
        )  # fmt: skip
        state.on_start(self.recording.first_utc_s)
        return state


def state_at_the_end(recording: Recording, scenery: Scenery) -> dict[str, Any]:
    """Return the state document as a recording ends; what its guard did behind that replaces what was recorded."""
    state = RecordedState(recording, scenery).at(recording.last_utc_s)
    told = unheard(recording.folder)
    return {**state, **told} if told["guard"] else state


def unheard(folder: Path) -> dict[str, Any]:
    """Return ``guard`` and ``bench`` of the state document of a run that says nothing: known is what its guard did."""
    guard = guard_word(folder)
    return {"guard": guard, "bench": dict(UNHEARD) if guard is None else guarded_bench(guard)}


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


def _station(texts: Mapping[str, str]) -> Station | None:
    name = next((name for name in texts if name.startswith(_STATIONS)), None)
    try:
        return None if name is None else Station(parse_yaml(texts[name], name, StationFile), {}, Path(name))
    except BenchError:
        return None


def _rules(recording: Recording, station: Station) -> tuple[InterlockRule, ...]:
    texts, links = recording.texts, recording.manifest.get("links", {})
    name = next((name for name in texts if name.startswith(_SEQUENCES)), None)
    try:
        return () if name is None else recorded_rules(texts[name], name, station, links)
    except BenchError:
        return ()
