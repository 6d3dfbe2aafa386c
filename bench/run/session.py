"""One run from the opened station to the closed session folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from bench.frame import FrameDefinition, LinkCounts
from bench.model.clock import Clock, utc_stamp
from bench.model.errors import BenchError, InputError, RunError
from bench.model.events import Config, Error, Preflight, Retake, UnitLeftOut
from bench.model.installed import unforeseen
from bench.model.lab import code_texts, recorded_code
from bench.model.quantities import Values
from bench.plan import Plan, plan_json
from bench.record import Journal, RecordCutter, RecordError, SessionWriter, resume_session
from bench.run.bus.acquisition import Acquisition
from bench.run.bus.beginning import begin_safely, check_space, identities_of
from bench.run.bus.opener import OpenBench, World, open_bench
from bench.run.bus.reader import LinkReader
from bench.run.context import RunContext, Timeline
from bench.run.guard.guarding import station_lock
from bench.run.links.keeper import keep_links
from bench.run.observers import (
    AtTerminal,
    HeldTranscript,
    Listener,
    Observers,
    Recorder,
    StoredEvent,
    new_folder,
    patient,
)
from bench.run.operator import Operator
from bench.run.position import Resumption
from bench.run.provenance import lab_of, software
from bench.run.resume import changed_files, same_instruments
from bench.run.sequencer import Outcome, Sequencer
from bench.run.setpoints import differences, read_back
from bench.run.steps.reentry import enter
from bench.run.stop import StopSwitch, repeated
from bench.run.watch.disk import disk_watch
from bench.run.watch.environment import PERIOD_S, note_temperatures
from bench.run.watch.interlocks import InterlockWatch

CLOCK_PAIR_S = 600.0

Beside = Callable[[RunContext], AbstractContextManager[object]]
Judge = Callable[..., Preflight | None]  # plan, bench, clock, folder; prepared: whether the bench is


@dataclass(frozen=True)
class Conducted:
    """A run that has ended: where its session is, how it ended, what simulated truth says (empty on a real bench).

    ``counts``: frames, frames_bad, frames_lost over all links; ``events``: the kinds asked for, in order.
    ``utc_offset_ns``: UTC minus the bench clock at the start of the run.
    """

    folder: Path
    manifest: Values
    outcome: Outcome
    session_sha256: str
    counts: Mapping[str, int]
    events: list[StoredEvent]
    truth: list[dict[str, Any]]
    utc_offset_ns: int | None = None


def session_name(plan: Plan, clock: Clock) -> str:
    """Return ``<UTC start>_<sequence>_<serial number of the unit>``."""
    serial = re.sub(r"[^A-Za-z0-9.-]", "-", str(plan.campaign.get("uut", {}).get("serial", "none")))
    return f"{utc_stamp(clock.utc_ns())}_{plan.name}_{serial}"


def manifest_of(
    plan: Plan, name: str, seed: int, clock: Clock, identities: Values, frames: Mapping[str, str]
) -> dict[str, Any]:
    """Return everything a reader needs to know before the first stimulus (docs/session-format.md)."""
    station, analysis = plan.station, str(plan.campaign["analysis"])
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
        "software": software(analysis, {entry.driver for entry in station.instruments.values()}),
        **lab_of(station, analysis),
        **({"units": [asdict(unit) for unit in plan.units]} if plan.units else {}),
    }


def texts_of(plan: Plan, manifest: Values) -> dict[str, str]:
    """Return the texts a run is made of: every YAML file, and the lab's code, which nobody executes from a session."""
    return {**plan.texts, **code_texts(recorded_code(manifest)[0])}


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
    preflight: Judge | None = None,
    resumed: Resumption | None = None,
) -> Conducted:
    """Run a plan on its station and close the session, or go on with one that was interrupted.

    Args:   beside: what goes on beside the sequencer, entered before the first step and left after the last one.
            preflight: looks at the bench as it was left, then judges it before a session exists; what it returns then
            becomes an event.
    The bench is always left safe; how the run ended is in the outcome. Only what happens before the session exists
    (a bench that does not open, a wrong identity) is raised.
    """
    _check_links(plan)
    check_space(plan, out)
    with StopSwitch() as stop, station_lock(plan.station, "run", clock) as lock:
        transcript = HeldTranscript()
        try:
            bench = open_bench(plan.station, clock, transcript, seed=seed, links=_links_of(plan, resumed))
        except Exception as error:
            if not isinstance(error, BenchError):
                error.add_note("Nothing was sent to the bench, and no session was begun.")
            raise
        try:
            judge = partial(preflight or (lambda *_, **__: None), plan, bench, clock, out)
            resumed, identities = _identified(bench, clock, resumed, partial(judge, prepared=False))
            judged = judge(prepared=True)
            writer, manifest = _begin(plan, clock, seed, out, identities, resumed)
            lock.name_session(writer.folder.name)
            recorder = Recorder(writer, keep_events)
            observers = Observers(clock, recorder, AtTerminal(listener))
            transcript.attach(observers)
            transcript.on_traffic = stop.is_alive
            if judged is not None:
                observers.event(judged)
            frames, earlier = plan.definitions(), transcript.earlier
            run = _Run(plan, bench, frames, writer, observers, clock, stop, beside, resumed, manifest, earlier)
            outcome = _closed(writer, run.outcome_of(operator))
            # a world begun anew does not know what was before
            outcome, truth = _told(outcome, bench.world) if bench.world and resumed is None else (outcome, [])
        finally:
            bench.close()
    counts, offset_ns = run.counts(), run.utc_offset_ns
    return Conducted(writer.folder, manifest, outcome, writer.chain, counts, recorder.events, truth, offset_ns)


def _identified(
    bench: OpenBench, clock: Clock, resumed: Resumption | None, look: Callable[[], object]
) -> tuple[Resumption | None, dict[str, dict[str, str]]]:
    """Return the identities, the bench safe; a resumption learns what is set otherwise than the session left it."""
    readings = {} if resumed is None else read_back(bench.instruments, clock)
    identities = identities_of(begin_safely(bench, clock, look))
    if resumed is None:
        return None, identities
    same_instruments(resumed.manifest, identities)
    return resumed.found(identities, differences(resumed.expected, readings)), identities


def _begin(
    plan: Plan,
    clock: Clock,
    seed: int,
    out: Path,
    identities: Values,
    resumed: Resumption | None,
) -> tuple[SessionWriter, Values]:
    """Return a new session, or one that is gone on with; and its manifest."""
    if resumed is not None:
        return resume_session(resumed.folder, resumed.event, t_mono_ns=clock.now_ns()), resumed.manifest
    name = session_name(plan, clock)
    manifest = manifest_of(plan, name, seed, clock, identities, {k: f.sha256 for k, f in plan.definitions().items()})
    texts = {**texts_of(plan, manifest), "plan.json": plan_json(plan.steps)}
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


def _told(outcome: Outcome, world: World) -> tuple[Outcome, list[Any]]:
    """Return the truth of a world; one that cannot tell it is the error of a run that had none."""
    try:
        return outcome, world.truth([row.window for row in outcome.rows])
    except Exception as error:
        return replace(outcome, error=outcome.error or unforeseen(error)), []


def _links_of(plan: Plan, resumed: Resumption | None) -> bool | list[str]:
    """Return the links of the units that share a campaign and are not left out; all where there is one."""
    read = () if resumed is None else resumed.read
    out = {event.uut for event in read if isinstance(event, UnitLeftOut)}
    kept = [unit for unit in plan.units if unit.serial not in out]
    return [link for unit in kept for link in unit.links.values()] if plan.units else True


def _counted_by(plan: Plan) -> dict[str, str]:
    """Return of each link the one whose frames are cut into records: the measurement link of its unit."""
    of_units = {link: next(iter(unit.links.values())) for unit in plan.units for link in unit.links.values()}
    return {link: of_units.get(link, plan.measurement_link) for link in plan.frames}


def _check_links(plan: Plan) -> None:
    for link in plan.frames:
        if link not in plan.station.links:
            message = f"station {plan.station.name!r} has no link {link!r}"
            raise InputError("B-RUN-004", message, where=link, next_step="add it to the station file")


@dataclass
class _Run:
    plan: Plan
    bench: OpenBench
    frames: Mapping[str, FrameDefinition]
    writer: SessionWriter
    observers: Observers
    clock: Clock
    stop: StopSwitch
    beside: Sequence[Beside]
    resumed: Resumption | None
    manifest: Values
    earlier: tuple[tuple[str, str, str, int], ...]

    def __post_init__(self) -> None:
        self.utc_offset_ns: int | None = None
        self._outcome = Outcome(rows=(), slip_s=0.0, overruns=0, retaken=0, lateness_ms=(0.0, 0.0, 0.0))
        links = _counted_by(self.plan)
        self.cutters = {counted: RecordCutter(self.frames[counted]) for counted in dict.fromkeys(links.values())}
        self.readers = self._readers()

    def outcome_of(self, operator: Operator) -> Outcome:
        """Run the plan; whatever goes wrong beside its steps is the error of the run, whose session is closed."""
        try:
            return self._sequence(operator)
        except (Exception, SystemExit) as problem:
            return replace(self._outcome, error=unforeseen(problem))

    def _sequence(self, operator: Operator) -> Outcome:
        """Run the plan with everything that goes on beside it."""
        self._pair()
        with closing(Journal(self.writer.folder)) as journal, ExitStack() as beside:
            context = self._context(operator)
            duties = (PERIOD_S, partial(note_temperatures, context)), (CLOCK_PAIR_S, self._pair)
            beside.enter_context(repeated(self.clock, self.stop, *duties))
            if not self.clock.virtual:
                beside.enter_context(disk_watch(context, {"session": self.writer.sync, "step journal": journal.sync}))
            beside.enter_context(keep_links(context))
            try:
                for start in self.beside:
                    beside.enter_context(start(context))
            except BenchError as error:  # before the first step: the bench is as safe as it was made at the start
                context.event(Error.of(error, step=0))
                context.health.over({})
                return replace(self._outcome, error=error)
            sequencer = Sequencer(context, journal, self.plan.station.safe_order)
            if self.resumed is None:
                outcome = self._outcome = sequencer.run()
            else:
                outcome = self._outcome = sequencer.run(self.resumed.start, partial(enter, context, self.resumed.start))
            self._compare_files()
        with suppress(RecordError):  # a disk that is full to the end must not hide how the run ended
            self._pair()
        if outcome.error is None:
            with suppress(OSError):  # a disk that takes nothing any more: what was measured counts
                journal.path.unlink()
        return outcome

    def _context(self, operator: Operator) -> RunContext:
        clock, stop = self.clock, self.stop
        acquisition = Acquisition(self.readers, clock, patient(self.writer.tick, self.observers.event), stop)
        acquisition.on_passed = self.writer.close_chunk
        timeline = Timeline(clock, stop, clock.now_ns())
        context = RunContext(
            self.plan, self.bench.instruments, acquisition, self.cutters, clock, self.observers, operator, stop,
            timeline, self.plan.measurement_link, partial(InterlockWatch, self.plan.interlocks),
            folder=self.writer.folder, manifest=self.manifest, earlier=self.earlier, operate=self.bench.operate,
        )  # fmt: skip
        if self.resumed is not None:
            context.record_count = self.resumed.records
            context.unit_answer, context.settled = self.resumed.unit_answer, self.resumed.settled
            for event in self.resumed.read:
                context.decided.take(event)
            for number in self.resumed.withdrawn:
                reason = "its point was not finished when the run stopped"
                context.event(Retake(record=number, reason=reason))
        return context

    def _compare_files(self) -> None:
        """Say which files have changed while the run went on from its frozen copy."""
        for name, change in changed_files(self.plan.files, self.plan.texts).items():
            self.observers.note(Config(file=name, change=change))

    def _pair(self) -> None:
        t_mono_ns, t_utc_ns = self.clock.now_ns(), self.clock.utc_ns()
        if self.utc_offset_ns is None:
            self.utc_offset_ns = t_utc_ns - t_mono_ns
        self.writer.clock_pair(t_mono_ns, t_utc_ns)

    def counts(self) -> dict[str, int]:
        """Return frames of all links: good, bad, lost; and jumps of unknown size of their counters."""
        return sum((reader.decoder.counts for reader in self.readers.values()), LinkCounts()).totals

    def _readers(self) -> dict[str, LinkReader]:
        readers: dict[str, LinkReader] = {}
        counted = {link: of for link, of in _counted_by(self.plan).items() if link in self.bench.links}
        for link in sorted(counted, key=lambda name: name == counted[name]):
            cutter = self.cutters[counted[link]]
            feed = cutter.feed if link == counted[link] else partial(cutter.feed_context, link=link)
            readers[link] = LinkReader(
                link, self.bench.links[link], self.frames[link], self.clock, self.writer, [feed],
                poll_s=self.plan.station.links[link].poll,
            )  # fmt: skip
        return readers
