"""One run from the opened station to the closed session folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from bench.frame import FrameDefinition, parse_frame
from bench.model.clock import NS, Clock
from bench.model.errors import BenchError, InputError, RunError
from bench.plan import Plan, plan_json
from bench.record import Journal, PackedList, RecordCutter, RecordError, SessionWriter
from bench.record.recover import resume_session
from bench.run.bench.beginning import begin_safely, check_space, identities_of
from bench.run.bench.opener import OpenBench, open_bench
from bench.run.bench.transcript import HeldTranscript, new_folder
from bench.run.context import Listener, RunContext
from bench.run.control.operator import Operator
from bench.run.frozen import changed_files
from bench.run.guard.guarding import station_lock
from bench.run.guard.health import WRITER
from bench.run.hold.patience import patient
from bench.run.links.acquisition import Acquisition, LinkReader
from bench.run.links.keeper import keep_links
from bench.run.provenance import software
from bench.run.resume import same_instruments
from bench.run.sequencer import Outcome, Sequencer
from bench.run.steps.position import Resumption
from bench.run.steps.reentry import enter
from bench.run.steps.setpoints import differences, read_back
from bench.run.steps.timing import Timeline
from bench.run.stop import StopSwitch, guarded
from bench.run.watch.environment import EnvironmentLog
from bench.run.watch.listening import SafeListener

CLOCK_PAIR_S = 600.0
SYNC_S = 1.0

Event = tuple[str, int, Mapping[str, Any]]
Beside = Callable[[RunContext], AbstractContextManager[object]]
Preflight = Callable[[Plan, OpenBench, Clock, Path], Mapping[str, Any]]


@dataclass(frozen=True)
class Conducted:
    """A run that has ended: where its session is, how it ended, what simulated truth says (empty on a real bench).

    ``counts``: frames, frames_bad, frames_lost over all links; ``events``: the kinds asked for, in order.
    ``utc_offset_ns``: UTC minus the bench clock at the start of the run.
    """

    folder: Path
    manifest: Mapping[str, Any]
    outcome: Outcome
    session_sha256: str
    counts: Mapping[str, int]
    events: list[Event]
    truth: list[dict[str, Any]]
    utc_offset_ns: int | None = None


def session_name(plan: Plan, clock: Clock) -> str:
    """``<UTC start>_<sequence>_<serial number of the unit>``."""
    start = datetime.fromtimestamp(clock.utc_ns() // NS, UTC).strftime("%Y%m%dT%H%M%SZ")
    serial = re.sub(r"[^A-Za-z0-9.-]", "-", str(plan.campaign.get("uut", {}).get("serial", "none")))
    return f"{start}_{plan.name}_{serial}"


def manifest_of(
    plan: Plan, name: str, seed: int, clock: Clock, identities: Mapping[str, Any], frames: Mapping[str, str]
) -> dict[str, Any]:
    """Everything a reader needs to know before the first stimulus (docs/session-format.md)."""
    station = plan.station
    return {
        "schema": 1,
        "session": name,
        "sequence": plan.name,
        "title": plan.title,
        "simulated": station.simulated,
        "seed": seed if station.in_process else None,
        "clock": "virtual" if clock.virtual else "wall",
        "station": station.name,
        "campaign": dict(plan.campaign),
        "settings": dict(plan.settings),
        "standards": station.standards(),
        "identities": dict(identities),
        "links": {link: f"frames/{frame}.yaml" for link, frame in plan.frames.items()},
        "measurement_link": plan.measurement_link,
        "plan_sha256": plan.sha256,
        "frame_sha256": dict(frames),
        "planned": {
            "prepare_s": plan.prepare_s,
            "duration_s": plan.duration_s,
            "finally_s": plan.finally_s,
            "records": plan.record_count,
            "steps": len(plan.steps),
        },
        "software": software(str(plan.campaign["analysis"]), {entry.driver for entry in station.instruments.values()}),
    }


def conduct(
    plan: Plan,
    *,
    clock: Clock,
    seed: int,
    out: Path,
    operator: Operator,
    listener: Listener,
    keep_events: Collection[str] = (),
    beside: Sequence[Beside] = (),
    preflight: Preflight | None = None,
    resumed: Resumption | None = None,
) -> Conducted:
    """Run a plan on its station and close the session, or go on with one that was interrupted.

    Args:   beside: what goes on beside the sequencer, entered before the first step and left after the last one.
            preflight: judges the opened bench before a session exists; what it returns becomes an event.
    The bench is always left safe; how the run ended is in the outcome. Only what happens before the session exists
    (a bench that does not open, a wrong identity) is raised.
    """
    _check_links(plan)
    check_space(plan, out)
    with StopSwitch() as stop, station_lock(plan.station, "run", clock) as lock:
        transcript = HeldTranscript()
        bench = open_bench(plan.station, clock, transcript, seed=seed)
        try:
            resumed, identities = _identified(bench, clock, resumed)
            judged = {} if preflight is None else preflight(plan, bench, clock, out)
            writer, manifest = _begin(plan, clock, seed, out, identities, resumed)
            lock.name_session(writer.folder.name)
            transcript.attach(writer)
            transcript.on_traffic = stop.on_traffic
            sink = KeepingSink(writer, keep_events)
            if judged:
                sink.event("preflight", clock.now_ns(), judged)
            run = _Run(plan, bench, _frames(plan), writer, sink, clock, stop, beside, resumed, manifest, transcript)
            outcome = _closed(writer, run.sequence(operator, SafeListener(listener)))
            has_past = bench.world is not None and resumed is None  # a world begun anew does not know what was before
            truth = bench.world.truth([row.window for row in outcome.rows]) if bench.world and has_past else []
        finally:
            bench.close()
    counts, offset_ns = run.counts(), run.utc_offset_ns
    return Conducted(writer.folder, manifest, outcome, writer.chain, counts, sink.events, truth, offset_ns)


def _frames(plan: Plan) -> dict[str, FrameDefinition]:
    names = {link: f"frames/{frame}.yaml" for link, frame in plan.frames.items()}
    return {link: parse_frame(plan.texts[name], name) for link, name in names.items()}


def _identified(
    bench: OpenBench, clock: Clock, resumed: Resumption | None
) -> tuple[Resumption | None, dict[str, dict[str, str]]]:
    """Who answers, the bench safe; a resumption learns what is set otherwise than the session left it."""
    found = {} if resumed is None else read_back(bench.instruments, clock)
    identities = identities_of(begin_safely(bench, clock))
    if resumed is None:
        return None, identities
    same_instruments(resumed.manifest, identities)
    return resumed.with_fields(identities=identities, differences=differences(resumed.expected, found)), identities


def _begin(
    plan: Plan,
    clock: Clock,
    seed: int,
    out: Path,
    identities: Mapping[str, Any],
    resumed: Resumption | None,
) -> tuple[SessionWriter, Mapping[str, Any]]:
    """A new session, or one that is gone on with; and its manifest."""
    if resumed is not None:
        fields = {**resumed.fields, "start": resumed.start}
        return resume_session(resumed.folder, t_mono_ns=clock.now_ns(), fields=fields), resumed.manifest
    name = session_name(plan, clock)
    manifest = manifest_of(plan, name, seed, clock, identities, {k: f.sha256 for k, f in _frames(plan).items()})
    texts = {**plan.texts, "plan.json": plan_json(plan.steps)}
    return SessionWriter.create(new_folder(out, name), manifest, texts, t_mono_ns=clock.now_ns()), manifest


def _closed(writer: SessionWriter, outcome: Outcome) -> Outcome:
    """Close the session; one that cannot be closed is the error of a run that had none."""
    try:
        writer.close("done" if outcome.error is None else outcome.error.code)
    except RecordError as error:
        problem = RunError(
            "B-RUN-061",
            f"the session could not be closed: {error.message}; what was not written is lost",
            where=error.where,
            next_step="free space; 'bench recover' lists what the session holds",
        )
        return replace(outcome, error=outcome.error or problem)
    return outcome


def _check_links(plan: Plan) -> None:
    for link in plan.frames:
        if link not in plan.station.links:
            message = f"station {plan.station.name!r} has no link {link!r}"
            raise InputError("B-RUN-004", message, where=link, next_step="add it to the station file")


class KeepingSink:
    """Passes everything to the session writer and keeps events of some kinds for the end of the run."""

    def __init__(self, writer: SessionWriter, kinds: Collection[str]) -> None:
        self.raw = writer.raw
        self.command = writer.command
        self._kept: PackedList[Event] = PackedList()
        self._writer = writer
        self._kinds = frozenset(kinds)

    def event(self, kind: str, t_mono_ns: int, fields: Mapping[str, Any]) -> None:
        """Write an event."""
        self._writer.event(kind, t_mono_ns, fields)
        if kind in self._kinds:
            self._kept.append((kind, t_mono_ns, fields))

    @property
    def events(self) -> list[Event]:
        """The events that were kept, in order."""
        return list(self._kept)


@dataclass
class _Run:
    plan: Plan
    bench: OpenBench
    frames: Mapping[str, FrameDefinition]
    writer: SessionWriter
    sink: KeepingSink
    clock: Clock
    stop: StopSwitch
    beside: Sequence[Beside]
    resumed: Resumption | None
    manifest: Mapping[str, Any]
    transcript: HeldTranscript

    def __post_init__(self) -> None:
        self.utc_offset_ns: int | None = None
        link = self.plan.measurement_link
        self.cutter = RecordCutter(self.frames[link]) if link else None
        self.readers = self._readers()

    def sequence(self, operator: Operator, listener: SafeListener) -> Outcome:
        """Run the plan with everything that goes on beside it."""
        self._pair()
        with closing(Journal(self.writer.folder)) as journal, ExitStack() as beside:
            context = self._context(operator, listener)
            beside.callback(EnvironmentLog(context).stop)
            beside.callback(self.clock.every(CLOCK_PAIR_S, guarded(self._pair, self.stop)).cancel)
            if not self.clock.virtual:
                self._sync_beside(context, journal, beside)
            beside.enter_context(keep_links(context))
            try:
                for start in self.beside:
                    beside.enter_context(start(context))
            except BenchError as error:  # before the first step: the bench is as safe as it was made at the start
                context.event("error", code=error.code, text=str(error), step=0)
                context.health.over()
                return Outcome(rows=(), slip_s=0.0, overruns=0, retaken=0, lateness_ms=(0.0, 0.0, 0.0), error=error)
            sequencer = Sequencer(context, journal, self.plan.station.safe_order)
            if self.resumed is None:
                outcome = sequencer.run()
            else:
                outcome = sequencer.run(self.resumed.start, partial(enter, context, self.resumed.start))
            self._compare_files(listener)
        with suppress(RecordError):  # a disk that is full to the end must not hide how the run ended
            self._pair()
        if outcome.error is None:
            with suppress(OSError):  # a disk that takes nothing any more: what was measured counts
                journal.path.unlink()
        return outcome

    def _context(self, operator: Operator, listener: SafeListener) -> RunContext:
        clock, stop = self.clock, self.stop
        acquisition = Acquisition(self.readers, clock, patient(self.writer.tick, listener), stop)
        timeline = Timeline(clock, stop, clock.now_ns())
        context = RunContext(
            self.plan, self.bench.instruments, acquisition, self.cutter, clock, self.sink, operator, listener, stop,
            timeline, self.plan.measurement_link, folder=self.writer.folder, manifest=self.manifest,
            traffic=self.transcript.heard, told=listener.heard, earlier=self.transcript.earlier,
        )  # fmt: skip
        context.operate = self.bench.operate
        if self.resumed is not None:
            context.record_count = self.resumed.records
            context.unit_answer, context.settled = self.resumed.unit_answer, self.resumed.settled
            for number in self.resumed.withdrawn:
                context.event("retake", record=number, reason="its point was not finished when the run stopped")
        return context

    def _compare_files(self, listener: Listener) -> None:
        """Say which files have changed while the run went on from its frozen copy."""
        for name, change in changed_files(self.plan.files, self.plan.texts).items():
            with suppress(RecordError):
                self.sink.event("config", self.clock.now_ns(), {"file": name, "change": change})
            listener.message(f"{name} is {change} on the disk; the run used its own copy")

    def _sync_beside(self, context: RunContext, journal: Journal, beside: ExitStack) -> None:
        """Bring session and journal to the disk each second, off the step thread."""
        sync = patient(self.writer.sync, context.listener)
        sync_journal = patient(journal.sync, context.listener)

        def to_disk() -> None:
            sync()
            sync_journal()
            context.health.alive(WRITER)

        beside.callback(self.clock.every(SYNC_S, guarded(to_disk, self.stop)).cancel)

    def _pair(self) -> None:
        t_mono_ns, t_utc_ns = self.clock.now_ns(), self.clock.utc_ns()
        if self.utc_offset_ns is None:
            self.utc_offset_ns = t_utc_ns - t_mono_ns
        self.writer.clock_pair(t_mono_ns, t_utc_ns)

    def counts(self) -> dict[str, int]:
        """Frames of all links: good, bad, lost."""
        totals = [reader.decoder.counts for reader in self.readers.values()]
        return {
            "frames": sum(link.frames for link in totals),
            "frames_bad": sum(link.bad for link in totals),
            "frames_lost": sum(link.lost for link in totals),
        }

    def _readers(self) -> dict[str, LinkReader]:
        readers: dict[str, LinkReader] = {}
        cutter, measured = self.cutter, self.plan.measurement_link
        if cutter is None:
            return readers
        for link in sorted(self.plan.frames, key=lambda name: name == measured):
            feed = cutter.feed if link == measured else partial(cutter.feed_context, link=link)
            readers[link] = LinkReader(
                link, self.bench.links[link], self.frames[link], self.clock, self.sink, [feed],
                poll_s=self.plan.station.links[link].poll,
            )  # fmt: skip
        return readers
