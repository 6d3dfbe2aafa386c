"""The state document of a run (docs/live-protocol.md), made of events, so that a recording gives it too.

A living run says more than its events do: which step is under way (``on_step``), where its timeline is
(``on_timeline``), how its links are. For a recording the step under way is found by planned time: from the start of its
phase and from every event that names its step.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from bench.model.events import (
    Armed,
    Control,
    Deviation,
    End,
    Environment,
    Error,
    Event,
    Hold,
    Interlock,
    Link,
    Overrun,
    Prompt,
    PromptAlarm,
    Release,
    Resume,
    Severity,
    StimulusAlarm,
    by_instrument,
)
from bench.model.quantities import Values
from bench.plan import Step
from bench.run.feed.bench_state import (
    GOOD_FOR,
    LOOK_VIRTUAL_S,
    LOOK_WALL_S,
    BenchState,
    InstrumentPanel,
    bench_in_words,
)
from bench.run.feed.place import (
    Place,
    PlannedRun,
    Remaining,
    Temperature,
    corners,
    early_s,
    end_of_run,
    in_words,
    soak_to_come_s,
    wait_document,
    wait_of,
)
from bench.run.feed.points import Records

PROTO = 1
LONGEST_LOG = 200
LONGEST_TEXT = 500
MOST = 200
TRIFLE_S = 0.05  # a step that begins so little late is not worth a line


@dataclass
class Alarm:
    """One alarm; ``key`` is the trouble it tells of, ``of`` its sort; ``active``: it lasts."""

    id: str
    key: str
    of: type[Event]
    severity: Severity
    code: str | None
    t_utc_s: float
    text: str
    active: bool
    acknowledged: dict[str, Any] | None = None

    def document(self, shelved: Shelf | None) -> dict[str, Any]:
        """Return the entry of the state document."""
        entry = {name: value for name, value in vars(self).items() if name not in ("key", "of")}
        return {**entry, "shelved": None if shelved is None else asdict(shelved)}


@dataclass(frozen=True)
class Shelf:
    """Who has shelved a trouble, why and until when: it is shown, and nobody is called because of it."""

    by: str
    reason: str
    until_utc_s: float


class Alarms:
    """What is wrong now, and what was and nobody has seen yet; at most ``MOST``, of which those that are over go first.

    Ended by an event, or by a reply that confirms what one doubts. The same again is the same until acknowledged.
    """

    def __init__(self) -> None:
        self._alarms: list[Alarm] = []  # oldest first
        self._count = 0
        self._shelves: dict[str, Shelf] = {}  # by key of the trouble: the same again is shelved too

    def on_event(self, event: Event, t_utc_s: float) -> None:
        """Take an event; those that are no trouble change nothing."""
        match event:
            case Release():
                self.over(Hold.kind, *self._unsafe)
            case Prompt() | Armed():
                self.over("prompt")
            case Interlock(state="released") | Link(state="back") | Deviation(state="over"):
                self.over(event.topic)
            case End():
                self._end(event, t_utc_s)
            case Control(what="acknowledge") if event.ok is not False:
                self.acknowledge(str(event.alarm), event.by, t_utc_s)
            case Control(what="shelve", until_utc_s=float(until_utc_s)) if event.ok is not False:
                if (alarm := self.known(str(event.alarm))) is not None:
                    self._shelves[alarm.key] = Shelf(event.by, event.reason, until_utc_s)
            case _ if event.severity != "none":
                self._raise(event, t_utc_s)

    def acknowledge(self, alarm: str, by: str, t_utc_s: float) -> bool:
        """Note who has seen an alarm, and forget it if it is over; False if there is none that waits for it."""
        known = self.known(alarm)
        if known is None or known.acknowledged is not None:
            return False
        known.acknowledged = {"by": by, "t_utc_s": t_utc_s}
        self._forget()
        return True

    def waits(self, alarm: str) -> bool:
        """Return whether there is such an alarm and nobody has acknowledged it."""
        known = self.known(alarm)
        return known is not None and known.acknowledged is None

    def known(self, alarm: str) -> Alarm | None:
        """Return the alarm of this id, None if there is none."""
        return next((known for known in self._alarms if known.id == alarm), None)

    def shelf(self, key: str, t_utc_s: float) -> Shelf | None:
        """Return how a trouble is shelved at a moment, None if it is not or not any more."""
        shelf = self._shelves.get(key)
        return shelf if shelf is not None and t_utc_s < shelf.until_utc_s else None

    def documents(self, t_utc_s: float) -> list[dict[str, Any]]:
        """Return all alarms at a moment, newest first."""
        return [
            alarm.document(self.shelf(alarm.key, t_utc_s))
            for alarm in sorted(self._alarms, key=lambda alarm: -alarm.t_utc_s)
        ]

    def over(self, *keys: str) -> None:
        """Take that troubles, by their topics, do not last any more."""
        for alarm in self._alarms:
            if alarm.key in keys:
                alarm.active = False
        self._forget()

    def _end(self, event: End, t_utc_s: float) -> None:
        for alarm in self._alarms:
            alarm.active = False
        if event.error is not None:
            last = next((alarm for alarm in reversed(self._alarms) if alarm.code == event.error), None)
            if last is None:
                self._raise(event, t_utc_s)
            else:
                last.severity = "fault"
        self._forget()

    @property
    def _unsafe(self) -> list[str]:
        return [alarm.key for alarm in self._alarms if alarm.of is StimulusAlarm]

    def _raise(self, event: Event, t_utc_s: float) -> None:
        key, text, active = event.topic, event.sentence[:LONGEST_TEXT], event.lasts
        severity, code = event.severity, event.error_code
        for alarm in self._alarms:
            if alarm.key == key and alarm.acknowledged is None:
                alarm.severity, alarm.code, alarm.t_utc_s = severity, code, t_utc_s
                alarm.text, alarm.active = text, active
                return
        self._count += 1
        self.over(key)  # an alarm that was acknowledged while it lasted; this one has taken its place
        self._alarms.append(Alarm(str(self._count), key, type(event), severity, code, t_utc_s, text, active))
        self._forget()

    def _forget(self) -> None:
        self._alarms = [alarm for alarm in self._alarms if alarm.active or alarm.acknowledged is None]
        while len(self._alarms) > MOST:
            over = next((alarm for alarm in self._alarms if not alarm.active), self._alarms[0])
            self._alarms.remove(over)


class RunState:
    """One run, living or recorded. Thread-safe; nothing here waits or touches the run.

    Args: steps: of the plan (``steps_of`` reads them from a session).   manifest: of the session.
          source: "live" or "replay".   boot_id: of the process that answers.   run: name of the session's folder.
          places: driver and resource by role.   signals, graphs, limits: as in the document.   left_out: of steps that
          decisions before its events have left out.   unwatched: what no interlock watches, in sentences.
    All times are seconds since 1970 UTC. ``head``: the part of the document that never changes.
    """

    def __init__(
        self,
        steps: Sequence[Step],
        manifest: Values,
        *,
        source: str = "live",
        boot_id: str = "",
        run: str = "",
        places: Mapping[str, tuple[str, str]] | None = None,
        signals: Sequence[Values] = (),
        graphs: Sequence[Values] = (),
        limits: Sequence[Values] = (),
        left_out: Iterable[int] = (),
        unwatched: Sequence[str] = (),
    ) -> None:
        self._lock = threading.RLock()
        self._plan = PlannedRun(steps, left_out)
        self._place = Place(self._plan)
        self._manifest = manifest
        self.head = _head(manifest, source, boot_id, run)
        self._signals, self._graphs, self._unwatched = list(signals), list(graphs), list(unwatched)
        self._limits = list(limits)
        self.alarms = Alarms()
        self._records = Records(self._plan)
        self._panel = InstrumentPanel(manifest.get("identities") or {}, places or {})
        look_s = LOOK_VIRTUAL_S if manifest.get("clock") == "virtual" else LOOK_WALL_S
        self.bench = BenchState(places or {}, GOOD_FOR * look_s)
        self._temperature = Temperature()
        self._log: deque[dict[str, Any]] = deque(maxlen=LONGEST_LOG)
        self._links: dict[str, dict[str, Any]] = {}
        self._holds: dict[str, str] = {}
        self._hold_since: float | None = None
        self._prompt: dict[str, Any] | None = None
        self._stopping = False
        self._started: float | None = None
        self._outcome: dict[str, Any] | None = None
        self._last_error: Error | None = None

    # --- what comes in -----------------------------------------------------------------------------------------

    def on_event(self, event: Event, t_utc_s: float) -> None:
        """Something happened, as the session says it."""
        with self._lock:
            self._started = t_utc_s if self._started is None else self._started
            self._take(event, t_utc_s)
            self.bench.on_event(event, t_utc_s)
            self._place.on_event(event, t_utc_s)
            self._records.on_event(event, t_utc_s)
            self.alarms.on_event(event, t_utc_s)
            is_trifle = isinstance(event, Overrun) and event.seconds < TRIFLE_S
            if (text := event.sentence) and not is_trifle:
                line = {"t_utc_s": t_utc_s, "kind": event.kind, "severity": event.severity, "text": text[:LONGEST_TEXT]}
                self._log.appendleft(line)

    def on_start(self, t_utc_s: float) -> None:
        """The session begins (its first message)."""
        with self._lock:
            self._started = t_utc_s

    def on_step(self, number: int, t_utc_s: float) -> None:
        """A step of the plan begins; only a living run knows."""
        with self._lock:
            self._place.begin(number, t_utc_s)
            self._records.at_step(number)

    def on_timeline(self, origin_utc_s: float) -> None:
        """Take when second 0 of the phase under way was, or would have been, with slip; only a living run knows."""
        with self._lock:
            self._place.on_timeline(origin_utc_s)

    def at_planned(self, phase: str, seconds: float) -> None:
        """A recording: the step under way is the one that the plan has at a moment of a phase."""
        with self._lock:
            self._place.at_planned(phase, seconds)

    def on_record(self, number: int, t_utc_s: float, conditions: Values, counts: Values) -> None:
        """A record is complete: ``counts`` has frames, lost, bad and flags (bits of bench.model.quantities)."""
        with self._lock:
            self._records.on_record(number, t_utc_s, conditions, counts)

    def on_traffic(self, role: str, direction: str, text: str, t_utc_s: float) -> None:
        """A command to ("tx") or reply of ("rx") an instrument."""
        with self._lock:
            self._panel.on_traffic(role, direction, text, t_utc_s)
            if (event := self.bench.on_traffic(role, direction, text, t_utc_s)) is not None:
                self.alarms.over(event.topic)

    def on_links(self, links: Mapping[str, Values]) -> None:
        """Take the states of the links, by name, as in the document."""
        with self._lock:
            self._links = {name: dict(link) for name, link in links.items()}

    def on_holds(self, reasons: Mapping[str, str], away: frozenset[str] = frozenset()) -> None:
        """Why the run stands still now, and the instruments it waits for."""
        with self._lock:
            self._holds = dict(reasons)
            self._panel.away(away)

    def on_prompt(self, prompt: Values | None) -> None:
        """The question that is asked now, as in the document; None: none."""
        with self._lock:
            self._prompt = None if prompt is None else dict(prompt)

    def on_temperature(self, t_utc_s: float, unit_degC: float) -> None:
        """Newest temperature of the unit."""
        with self._lock:
            self._temperature.add(t_utc_s, unit_degC)

    def on_stopping(self) -> None:
        """The run is about to end."""
        with self._lock:
            self._stopping = True

    def waits(self, alarm: str) -> bool:
        """Return whether there is an alarm of this id that nobody has acknowledged."""
        with self._lock:
            return self.alarms.waits(alarm)

    def alarm_documents(self, t_utc_s: float) -> list[dict[str, Any]]:
        """Return the alarms at a moment, as in the document."""
        with self._lock:
            return self.alarms.documents(t_utc_s)

    def is_shelved(self, event: Event, t_utc_s: float) -> bool:
        """Return whether somebody has shelved the trouble that an event tells of."""
        with self._lock:
            return self.alarms.shelf(event.topic, t_utc_s) is not None

    def _take(self, event: Event, t: float) -> None:
        match event:
            case Resume():
                self._stopping, self._outcome, self._holds, self._hold_since = False, None, {}, None
                self._last_error = None
            case Hold():
                self._hold_since = t if self._hold_since is None else self._hold_since
                self._holds = {**self._holds, event.by: event.reason}
                if away := frozenset(role for role in self._panel.roles if by_instrument(role) == event.by):
                    self._panel.away(away)
            case Release():
                self._holds, self._hold_since = {}, None
                self._panel.away(frozenset())
            case StimulusAlarm():
                self._panel.trouble(event.role, f"{event.code} {event.text}")
            case PromptAlarm() if self._prompt is None:
                keys = ("id", "text", "confirm", "unit", "low", "high", "presence", "arms")
                self._prompt = {**{key: getattr(event, key) for key in keys}, "since_utc_s": t}
            case Prompt() | Armed():
                self._prompt = None
            case Environment(uut=None):
                self._on_environment(event, t)
            case Control(what="abort") if event.ok is not False:
                self._stopping = True
            case Error():
                self._last_error = event
            case End():
                self._on_end(event)

    def _on_environment(self, event: Environment, t: float) -> None:
        if event.unit_degC is not None:
            self._temperature.add(t, event.unit_degC)
        if event.air_degC is not None:
            self._place.first_air(event.air_degC)

    def _on_end(self, event: End) -> None:
        error = self._last_error
        text = error.text if error is not None and error.code == event.error else ""
        self._outcome = {"error": event.error, "text": text if event.error else "done"}
        self._holds, self._hold_since, self._prompt = {}, None, None

    # --- the document ------------------------------------------------------------------------------------------

    def document(self, t_utc_s: float) -> dict[str, Any]:
        """Return the state document at a moment of the bench."""
        with self._lock:
            if self._outcome is None and not self._holds and self._prompt is None:
                self._place.follow(t_utc_s)
            step = self._place.step
            return {
                **self.head,
                "state": self._state(),
                "attention": self._attention(t_utc_s),
                "outcome": self._outcome,
                "bench": self.bench.document(t_utc_s),
                "t_utc_s": t_utc_s,
                "started_utc_s": self._started,
                "step": self._step_document(step),
                "wait": self._wait(t_utc_s, step),
                "progress": self._progress(t_utc_s),
                "eta": None if self._holds or self._prompt is not None else self._eta(t_utc_s),
                "holds": dict(self._holds),
                "prompt": self._prompt,
                "records": self._records.document(),
                "links": self._links,
                "instruments": self._panel.documents(),
                "alarms": self.alarms.documents(t_utc_s),
                "unwatched": self._unwatched,
                "log": list(self._log),
                "signals": self._signals,
                "graphs": self._graphs,
                "limits": self._limits,
                "timetable": self._timetable(t_utc_s),
            }

    def bench_line(self, t_utc_s: float) -> str:
        """Return what is on at a moment of the bench, in one line."""
        with self._lock:
            return bench_in_words(self.bench.document(t_utc_s))

    def _state(self) -> str:
        if self._outcome is not None:
            return "ended"
        if self._stopping:
            return "ending"
        if self._holds:
            return "holding"
        if self._prompt is not None:
            return "waiting"
        return "starting" if self._place.step is None else "running"

    def _attention(self, t: float) -> str:
        """Return how much somebody is needed: none, some (asked, held, warned), much (alarm, fault, not all off)."""
        lasting = (alarm for alarm in self.alarms.documents(t) if alarm["active"] and not alarm["shelved"])
        active = {alarm["severity"] for alarm in lasting}
        failed = self._outcome is not None and self._outcome["error"] is not None
        if active & {"alarm", "fault"} or self.bench.unconfirmed:
            return "much"
        return "some" if active or failed or self._holds or self._prompt is not None else "none"

    def _step_document(self, step: Step | None) -> dict[str, Any] | None:
        if step is None:
            return None
        until = self._place.end_of(step) if step.duration_s else None
        return {
            "number": step.number + 1, "of": len(self._plan.steps), "phase": step.phase, "kind": step.kind,
            "what": in_words(step), "conditions": dict(step.conditions), "where": step.where,
            "since_utc_s": self._place.since_utc_s, "until_utc_s": until,
        }  # fmt: skip

    def _wait(self, t: float, step: Step | None) -> dict[str, Any] | None:
        if self._outcome is not None:
            return None
        if self._prompt is not None:
            reason = self._prompt["text"] if self._prompt.get("arms") else f"answer: {self._prompt['text']}"
            return wait_document(reason, self._prompt["since_utc_s"])
        if self._holds:
            return wait_document("; ".join(self._holds.values()), self._hold_since)
        return None if step is None else wait_of(t, step, self._place, self._temperature)

    def _progress(self, t: float) -> float:
        if self._outcome is not None and self._outcome["error"] is None:
            return 1.0
        done_s = self._place.position_s(t if self._hold_since is None else self._hold_since)
        return 0.0 if done_s is None or not self._plan.total_s else min(1.0, done_s / self._plan.total_s)

    def _eta(self, t: float) -> dict[str, float] | None:
        step = self._place.step
        if step is None or self._outcome is not None or self._stopping:
            return None
        stood_s = t if self._hold_since is None else self._hold_since  # nothing passes while the run stands still
        position_s = self._place.position_s(stood_s)
        assert position_s is not None
        inside_s = position_s - self._plan.before_s(step.phase)
        left = Remaining(
            likely_s=self._plan.total_s - position_s,
            soak_s=soak_to_come_s(self._plan.soaks, step, inside_s),
            grace_s=self._place.grace_s(t),
            early_s=early_s(self._plan.soaks, step, inside_s),
        )
        return end_of_run(t, left, self._place.late_shares)

    def _timetable(self, t: float) -> dict[str, list[Any]]:
        eta = self._eta(t)
        end = t if eta is None else eta["likely_utc_s"]
        thermal = () if self._place.step is None else self._plan.thermal
        return corners(thermal, self._place.start_of, end, self._place.first_degC)


def _head(manifest: Values, source: str, boot_id: str, run: str) -> dict[str, Any]:
    uut = (manifest.get("campaign") or {}).get("uut") or {}
    return {
        "proto": PROTO, "run": run or str(manifest.get("session", "")), "boot_id": boot_id,
        "title": manifest.get("title"), "sequence": manifest.get("sequence"), "station": manifest.get("station"),
        "uut": {"model": uut.get("model"), "serial": uut.get("serial")},
        "simulated": bool(manifest.get("simulated")), "clock": manifest.get("clock"), "source": source,
    }  # fmt: skip
