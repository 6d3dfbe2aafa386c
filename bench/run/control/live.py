"""A living run as its feed shows it: what it does goes into the state, its frames into points.

Nothing comes back but that somebody looks, so that the links are decoded more often. They are described without asking
them anything: nothing is read, decoded or locked.

The feed of a run: a Unix socket that answers what the run does and its newest points (docs/live-protocol.md).

One thread answers all, out of memory of fixed size. Nothing that goes wrong here reaches the run.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bench.frame import LinkBatch
from bench.model.clock import NS, WallClock, to_ns, utc_of_stamp
from bench.model.events import Environment, Event, Reentry
from bench.model.quantities import Quality
from bench.model.units import finite
from bench.plan import Step, unwatched
from bench.record import RecordRow, canonical_json
from bench.run.bus.reader import LinkReader, age_s, state_of
from bench.run.context import RunContext
from bench.run.control.asking import WaitingOperator
from bench.run.control.client import LENGTHS
from bench.run.control.local_socket import LIVE, LocalServer, forget_socket, socket_path
from bench.run.feed.points import PATIENCE_NS, PATIENCE_VIRTUAL_NS, PointBatch, Points
from bench.run.feed.run_state import PROTO, RunState
from bench.run.feed.scenery import graph_rows, limit_rows, signal_rows, signals_of
from bench.run.observers import Observer
from bench.run.stop import UNIT

LONGEST_LINE = 4096
STATE_S = 0.1  # a state document serves everybody for that long


class FeedServer(LocalServer):
    """Answers from the moment it is made until ``close``. Real time counts here, whatever the clock of the run.

    Args: head: what every reply says (proto, boot_id, signals).   state: the state document.
          points: complete points from a number on. Both are called on the thread of the server and must not wait.
    Raises: OSError if the socket cannot be made.
    """

    longest = LONGEST_LINE
    idle_s = 10.0
    gap_s = 0.05

    def __init__(
        self,
        path: Path,
        head: dict[str, Any],
        state: Callable[[], dict[str, Any]],
        points: Callable[[int], PointBatch],
    ) -> None:
        self._head, self._state, self._points = head, state, points
        self._newest_state: tuple[int, bytes] = (-1, b"")
        super().__init__(path, WallClock(), "feed")

    def _reply(self, line: bytearray, by: str) -> bytes | None:
        """Return the reply to one request; None for one that is not understood, or that cannot be answered."""
        try:
            request = json.loads(line)
            since, with_state = request.get("since", 0), request.get("state", False)
            if type(since) is not int or type(with_state) is not bool:
                return None
            points = self._points(since)
            header = canonical_json({**self._head, "seq": points.seq, "first": points.first, "n": points.n})
            if with_state:
                header = header[:-1] + b',"state":' + self._state_bytes() + b"}"
        except Exception:  # whatever a client asks and whatever state the run is in: the run goes on
            return None
        return LENGTHS.pack(len(header), len(points.packed)) + header + points.packed

    def _state_bytes(self) -> bytes:
        now_ns, (made_ns, state) = self._clock.now_ns(), self._newest_state
        if made_ns < 0 or now_ns - made_ns > to_ns(STATE_S):
            state = canonical_json(self._state())
            self._newest_state = (now_ns, state)
        return state


FRESH_S = 10.0  # a temperature of the unit that was noted longer ago does not count


class LiveFeed(Observer):
    """State and points of a run. Everything here is called by the run and costs it no more than a note."""

    loss = "nobody can watch this run any more"
    broken = False

    def __init__(self, context: RunContext, asking: WaitingOperator | None) -> None:
        self._context, self._asking = context, asking
        clock, station = context.clock, context.plan.station
        self._offset_ns = clock.utc_ns() - clock.now_ns()
        _, graphs, signals = signals_of(context)
        periods_ns = {name: to_ns(reader.period_s) for name, reader in context.acquisition.readers.items()}
        patience_ns = PATIENCE_VIRTUAL_NS if clock.virtual else PATIENCE_NS
        self.points = Points(signals, periods_ns, clock.now_ns(), self._utc_s(clock.now_ns()), patience_ns)
        self.state = RunState(
            context.plan.steps,
            context.manifest,
            run=context.folder.name,
            boot_id=_boot_id(),
            places={role: (entry.driver, entry.resource) for role, entry in station.instruments.items()},
            signals=signal_rows(signals, context.manifest),
            graphs=graph_rows(graphs, signals, context.manifest),
            limits=limit_rows(context.plan.interlocks, station.guard_limits_degC),
            left_out=context.decided.left_out,
            unwatched=unwatched(context.plan),
        )
        self.state.on_start(_began(context.manifest, self._utc_s(clock.now_ns())))
        for line in context.earlier:
            self.traffic(*line)

    @property
    def head(self) -> dict[str, Any]:
        """Entries of every reply of the feed."""
        document = self.state.head
        return {"proto": PROTO, "boot_id": document["boot_id"], "signals": len(self.points.signals)}

    def event(self, event: Event, t_mono_ns: int) -> None:
        self.state.on_event(event, self._utc_s(t_mono_ns))
        if isinstance(event, Environment) and event.uut is None:
            readings = {"air": event.air_degC, "unit": event.unit_degC}
            self.points.on_reading(t_mono_ns, {name: value for name, value in readings.items() if value is not None})
        elif isinstance(event, Reentry) and event.target_degC is not None:
            self.points.on_reading(t_mono_ns, {"setpoint": event.target_degC})

    def step(self, step: Step, at_s: float) -> None:
        now_ns = self._context.clock.now_ns()
        self.state.on_timeline(self._utc_s(self._context.timeline.target_ns(0.0)))
        self.state.on_step(step.number, self._utc_s(now_ns))
        if step.set_point is not None:
            self.points.on_reading(now_ns, {"setpoint": step.set_point.temperature_degC})

    def record(self, row: RecordRow) -> None:
        flags = [str(flag.name).lower().replace("_", " ") for flag in Quality if flag & row.quality]
        counts: dict[str, Any] = {"frames": row.frames, "lost": row.lost, "bad": row.bad, "flags": flags}
        if not row.window.link:
            counts |= {"frames": None, "readings": row.readings, "lost": row.unread, "bad": None}
        now_s = self._utc_s(self._context.clock.now_ns())
        self.state.on_record(row.window.number, now_s, row.window.conditions, counts)

    def traffic(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        self.state.on_traffic(role, direction, text, self._utc_s(t_mono_ns))

    def batch(self, link: str, batch: LinkBatch) -> None:
        self.points.on_batch(link, batch)

    def failed(self) -> None:
        """Whatever went wrong here ends the feed, and never the run."""
        self.broken = True

    def document(self) -> dict[str, Any]:
        """Return the state document of now; on the thread of the feed. Raises: RuntimeError if the feed is broken."""
        if self.broken:
            raise RuntimeError("the feed of this run is broken")
        context, stop = self._context, self._context.stop
        now_ns = context.clock.now_ns()
        self.state.on_timeline(self._utc_s(context.timeline.target_ns(0.0)))
        self.state.on_links(links_of(context, now_ns))
        self.state.on_holds(stop.holds.reasons if stop.interruptible else {}, frozenset(context.away))
        self.state.on_prompt(None if self._asking is None else self._asking.document(self._utc_s))
        if stop.over or stop.requested or stop.fault is not None:
            self.state.on_stopping()
        age_s = context.health.age_s(UNIT)
        if age_s is not None and age_s < FRESH_S:
            self.state.on_temperature(self._utc_s(now_ns), context.health.values()[UNIT])
        return self.state.document(self._utc_s(now_ns))

    def bench_line(self) -> str:
        """Return what is on, in a line for people who are told something."""
        return "" if self.broken else self.state.bench_line(self._utc_s(self._context.clock.now_ns()))

    def points_since(self, since: int) -> PointBatch:
        """Return complete points from a number on; on the thread of the feed."""
        self._context.acquisition.looked_at()
        return self.points.since(since, self._context.clock.now_ns())

    def _utc_s(self, t_mono_ns: int) -> float:
        return (t_mono_ns + self._offset_ns) / NS


@contextmanager
def live_feed(context: RunContext, asking: WaitingOperator | None = None) -> Iterator[LiveFeed]:
    """Let others watch the run, under either clock; a socket that cannot be made keeps no run back."""
    feed = LiveFeed(context, asking)
    context.observers.add(feed)
    try:
        path = socket_path(context.folder, LIVE)
        server = FeedServer(path, feed.head, feed.document, feed.points_since)
    except OSError as error:
        context.message(f"nobody can watch this run: {error}")
        yield feed
        return
    try:
        yield feed
    finally:
        server.close()
        forget_socket(context.folder, path, LIVE)


def _boot_id() -> str:
    """Another one for every process that answers, without chance: process and moment."""
    clock = WallClock()
    return hashlib.sha256(f"{os.getpid()} {clock.now_ns()} {clock.utc_ns()}".encode()).hexdigest()[:16]


def _began(manifest: Mapping[str, Any], now_utc_s: float) -> float:
    """Start of the session, which its name says; a run that was gone on with began earlier than now."""
    began_ns = utc_of_stamp(str(manifest.get("session", "")))
    return now_utc_s if began_ns is None else began_ns / NS


def links_of(context: RunContext, now_ns: int) -> dict[str, dict[str, Any]]:
    """Return all links by name, as in docs/live-protocol.md."""
    stale = context.health.values()
    return {
        name: _link(reader, now_ns, bool(stale.get(f"{name}_stale")), virtual=context.clock.virtual)
        for name, reader in context.acquisition.readers.items()
    }


def _link(reader: LinkReader, now_ns: int, stale: bool, *, virtual: bool) -> dict[str, Any]:
    counts = reader.decoder.counts
    return {
        "state": state_of(reader, now_ns, stale=stale and not virtual),
        "reason": reader.lost,
        "frames": counts.frames,
        "bad": counts.bad,
        "lost": counts.lost,
        "jumps": counts.jumps,
        "duplicate": counts.duplicate,
        "rate_Hz": finite(round(reader.rate_Hz, 3)),
        "age_s": finite(round(age_s(reader, now_ns), 3)),
    }
