"""A finished session, in the form that analysis and report need; from a run or from the folder alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bench import __version__
from bench.analysis import (
    INCOMPLETE,
    Accepted,
    Analysis,
    Document,
    Estimate,
    Estimates,
    Exchange,
    GivenValue,
    Material,
    Reading,
    Table,
    Trace,
    analyse,
    build_results,
    by_foreseen_name,
    expected_at_end,
    joined,
    weigh,
)
from bench.frame import CommandLayout, parse_frame
from bench.model import events
from bench.model.clock import NS
from bench.model.errors import BenchError, FitError, InputError
from bench.model.events import (
    Decision,
    Environment,
    Event,
    Phase,
    Preflight,
    Prompt,
    Retake,
    UnitLeftOut,
    kinds_of_events,
)
from bench.model.lab import sha256_of
from bench.model.quantities import key_of_value
from bench.model.systems import assumptions_of, declared_by
from bench.model.yamlio import parse_yaml
from bench.plan import Plan, StationFile, Step, plan_of_texts, unmet_loops, values_not_due
from bench.record import Damage, RecordRow
from bench.replay import Splice
from bench.report import Laboratory, Report, ReportModel, RunStory, TemperatureTrace, report_model
from bench.session.away import LONGER_S, doubted, placed_later
from bench.session.happenings import (
    alarms_raised,
    commands_given,
    decision_tables,
    happening_tables,
    hashes_of,
    lag_tables,
    length_s,
    preflight_table,
    punctuality,
    settling_tables,
    splice_documents,
    splice_tables,
    surroundings,
)
from bench.session.predicted import predicted
from bench.session.wording import say

E = TypeVar("E", bound=Event)
Name = tuple[str, str, int]  # of an estimate, as it is foreseen
SOFTWARE = f"inertial-bench {__version__}"
# All but those that a view never asks for, so that a new kind is kept.
KEPT_EVENTS = kinds_of_events() - {"answer", "closed", "disk", "gap", "inhibit", "notify", "record", "safe"}
BITS_PER_BYTE = 10  # start bit, eight bits, stop bit


def happened(recorded: Iterable[tuple[int, Event]]) -> list[tuple[int, Event]]:
    """Return the events that a view keeps, with their times, of those that a session holds."""
    return [(t_ns, event) for t_ns, event in recorded if event.kind in KEPT_EVENTS]


@dataclass
class SessionView:
    """One session: manifest, records, counts and the few events that a report shows.

    ``counts``: frames, frames_bad, frames_lost over all links; ``events``: (t_mono_ns, event) in order.
    ``splices``: where the run was gone on with; ``incomplete``: the run has not ended. ``utc_offset_ns``: UTC minus
    monotonic time, None if unknown; ``make_up``: hashes of the sessions that complete this one. ``texts``: the YAML
    texts the run was made from, by name; ``acceptances``: of doubtful values, made after the run.
    """

    manifest: Document
    rows: Sequence[RecordRow]
    counts: Mapping[str, int]
    session_sha256: str
    plan_steps: Sequence[Step] = ()
    events: list[tuple[int, Event]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    damage: Sequence[Damage] = ()
    splices: Sequence[Splice] = ()
    incomplete: bool = False
    utc_offset_ns: int | None = None
    make_up: tuple[str, ...] = ()
    series: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    acceptances: Sequence[Accepted] = ()

    @property
    def damaged(self) -> bool:
        """Return whether anything of the session cannot be read as it was written."""
        return bool(self.damage)

    @property
    def remarks(self) -> list[str]:
        """Return everything a reader should know about the session, a sentence each."""
        return [*(f"damaged: {place}" for place in self.damage), *self.notes]

    def events_of(self, model: type[E]) -> list[tuple[int, E]]:
        """Return times and events of one kind."""
        return [(t_ns, event) for t_ns, event in self.events if isinstance(event, model)]

    @property
    def has_analysis(self) -> bool:
        """False for a sequence that only records."""
        return str(self.manifest.get("campaign", {}).get("analysis", "none")) != "none"


def analyse_view(view: SessionView, method: str | None = None) -> tuple[dict[str, Any], Analysis]:
    """Return estimates of a session and the document results.json."""
    manifest = view.manifest
    analysis = _analysed(view, method)
    counts = {
        **view.counts,
        "records": len(view.rows),
        "retaken": len(view.events_of(Retake)),
        "splices": len(view.splices),
    }
    provenance = {
        "simulated": manifest["simulated"],
        "plan_sha256": manifest["plan_sha256"],
        "frame_sha256": manifest.get("frame_sha256", {}).get(manifest["measurement_link"], ""),
        "session_sha256": view.session_sha256,
        "software": SOFTWARE,
    }
    if code := sha256_of("analyses", str(manifest["campaign"]["analysis"])):
        provenance["analysis_sha256"] = code
    if view.make_up:
        provenance["make_up_sha256"] = list(view.make_up)
    decision = manifest["campaign"].get("decision")
    document = build_results(
        manifest["session"], analysis, counts, provenance, decision,
        assumptions=assumptions_of(manifest["campaign"]),
        splices=splice_documents(view.splices), incomplete=view.incomplete, acceptances=view.acceptances,
    )  # fmt: skip
    return document, analysis


def _analysed(view: SessionView, method: str | None) -> Analysis:
    """Return the analysis; a unit that was left out before anything was determined has one without estimates."""
    try:
        analysis = analysis_of(view, method)
        return replace(analysis, missing=[*analysis.missing, *_unmet(view)])
    except FitError as error:
        if not view.events_of(UnitLeftOut):
            raise
        campaign = view.manifest["campaign"]
        return Analysis(
            str(campaign["analysis"]), "none", campaign["uut"], [], notes=[error.message], missing=[error.message]
        )


def analysis_of(view: SessionView, method: str | None = None) -> Analysis:
    """Return the analysis of a session's records, with doubt at what a time away that nobody knows would change.

    Raises: BenchError of the analysis.
    """
    analysis = analyse(material_of(view), method)
    if all(splice.placed for splice in view.splices):
        return analysis
    others: list[Analysis | None] = []
    for longer_s in LONGER_S:
        rows, happened_later = placed_later(view.rows, view.events, view.splices, longer_s)
        try:
            others.append(analyse(material_of(replace(view, rows=rows, events=happened_later)), method))
        except BenchError:
            others.append(None)
    return doubted(analysis, others, view.splices)


def _unmet(view: SessionView) -> list[str]:
    """Return a sentence for each loop that went on without what it waits for: a result that the sequence promises."""
    loops = unmet_loops(view.plan_steps, (event for _, event in view.events_of(Decision)))
    return [
        say("loop.unread", reading=step.reading) if value is None else say("loop.unmet", **step.still(value))
        for step, value in loops
    ]


def material_of(view: SessionView) -> Material:
    """Return what the analysis may see of a session."""
    return Material(
        rows=joined(view.rows),
        campaign=view.manifest["campaign"],
        standards=view.manifest["standards"],
        trace=_trace(view),
        readings=[_reading(t_ns, event) for t_ns, event in view.events_of(events.Reading)],
        series=view.series,
        exchanges=_last_of_each([_exchange(event) for _, event in view.events_of(events.Exchange)]),
        given=_given(view.events_of(Prompt)),
        layouts=_layouts(view),
        utc_offset_s=None if view.utc_offset_ns is None else view.utc_offset_ns / NS,
        line_s=line_times_s(view.manifest, view.texts),
        not_due=values_not_due(view.plan_steps, (event for _, event in view.events_of(Decision))),
    )


def _last_of_each(exchanges: Sequence[Exchange]) -> list[Exchange]:
    """A test that was done again, because the run was stopped within its item, counts as it was done last."""
    last = {exchange.step: number for number, exchange in enumerate(exchanges)}
    return [exchange for number, exchange in enumerate(exchanges) if not exchange.item or last[exchange.step] == number]


def _given(prompts: Sequence[tuple[int, Prompt]]) -> list[GivenValue]:
    """Return the values that a person measured; one that was asked for again, after a stop, counts as given last."""
    values = {
        event.step: GivenValue(
            t_s=t_ns / NS,
            step=event.step,
            quantity=event.quantity,
            value=event.value,
            unit=event.unit,
            low=event.low,
            high=event.high,
            conditions=dict(event.conditions or {}),
        )
        for t_ns, event in prompts
        if event.quantity
    }
    return list(values.values())


def _exchange(event: events.Exchange) -> Exchange:
    return Exchange(
        step=event.step,
        item=event.item,
        name=event.name,
        sequence=event.sequence,
        attempts=event.attempts,
        begin_s=event.begin_ns / NS,
        end_s=event.end_ns / NS,
        status=event.status,
        refused=event.refused,
        sent=bytes.fromhex(event.sent),
        received=bytes.fromhex(event.received),
        conditions=dict(event.conditions),
    )


def _layouts(view: SessionView) -> Mapping[str, CommandLayout]:
    """Return payloads of the measurement link's commands, from the frame definition the session holds."""
    name = view.manifest.get("links", {}).get(view.manifest.get("measurement_link"))
    return parse_frame(view.texts[name], name).commands if name in view.texts else {}


def _reading(t_ns: int, event: events.Reading) -> Reading:
    return Reading(
        t_s=t_ns / NS,
        step=event.step,
        role=event.role,
        name=event.name,
        value=event.value,
        conditions=dict(event.conditions),
        arguments=dict(event.arguments or {}),
    )


def report_of(view: SessionView, results: Document, analysis: Analysis, laboratory: Laboratory | None = None) -> Report:
    """Return the report, drawn; it can be written as a page and on paper."""
    return Report(model_of(view, results, analysis), laboratory=laboratory)


def model_of(view: SessionView, results: Document, analysis: Analysis) -> ReportModel:
    """Return everything that the report shows, before any drawing."""
    noted = [seen.sentence for seen in weigh(analysis.evidence).noted]
    prepare_s = float(view.manifest["planned"]["prepare_s"])
    return replace(
        report_model(results, view.rows, view.plan_steps, view.manifest, prepare_s, analysis.residuals),
        trace=temperature_trace(view),
        components=tuple(analysis.components),
        prompts=tuple(prompt.document() for _, prompt in view.events_of(Prompt)),
        figures=tuple(analysis.figures),
        tables=tuple(analysis.tables),
        notes=(*([INCOMPLETE] if view.incomplete else []), *noted, *analysis.notes, *punctuality(view), *view.remarks),
        run=_story(view),
        main=main_quantities(view),
        predicted=tuple(predicted_of(view, analysis.method)),
    )


def main_quantities(view: SessionView) -> tuple[str, ...]:
    """Return the quantities that the analysis of a session declares as its main ones."""
    declared = declared_by(view.manifest["campaign"])
    return () if declared is None else declared.main


def _story(view: SessionView) -> RunStory:
    logged_s = np.asarray(view.series.get("t_s", ()), dtype=np.float64)
    return RunStory(
        tables=tuple(_about_the_run(view)),
        commands=tuple(commands_given(view)),
        alarms=tuple(alarms_raised(view)),
        surroundings=tuple(surroundings(view, view.texts, _campaign_ns(view))),
        length_s=length_s(view),
        log_s=float(np.ptp(logged_s)) if logged_s.size else math.nan,
        hashes=hashes_of(view.texts),
        damage=len(view.damage),
        left_out=bool(view.events_of(UnitLeftOut)),
    )


def _about_the_run(view: SessionView) -> list[Table]:
    looked_at = [preflight_table(event) for _, event in view.events_of(Preflight)]
    return [
        *happening_tables(view),
        *decision_tables(view),
        *settling_tables(view),
        *lag_tables(view),
        *splice_tables(view.splices),
        *looked_at,
    ]


def temperature_trace(view: SessionView) -> TemperatureTrace:
    """Return temperatures against seconds from the start of the campaign phase."""
    start_ns = _campaign_ns(view)
    trace = _trace(view)
    gaps_s = [splice.at_ns / NS for splice in view.splices]  # the lines are broken where nothing was recorded
    at = np.searchsorted(trace.t_s, gaps_s)
    return TemperatureTrace(
        t_s=np.insert(trace.t_s, at, gaps_s) - start_ns / NS,
        air_degC=np.insert(trace.air_degC, at, np.nan),
        unit_degC=np.insert(trace.unit_degC, at, np.nan),
    )


def _campaign_ns(view: SessionView) -> int:
    return next((t for t, phase in view.events_of(Phase) if phase.name == "campaign"), 0)


def _trace(view: SessionView) -> Trace:
    temperatures = view.events_of(Environment)
    return Trace(
        t_s=np.array([t_ns / NS for t_ns, _ in temperatures]),
        air_degC=np.array([_number(event.air_degC) for _, event in temperatures]),
        unit_degC=np.array([_number(event.unit_degC) for _, event in temperatures]),
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def line_times_s(manifest: Document, texts: Mapping[str, str]) -> dict[str, float]:
    """Return seconds of a frame by link; links that are no serial port or whose frames vary in length are left out."""
    station = next((name for name in texts if name.startswith("stations/")), None)
    if station is None:
        return {}
    try:
        ports = parse_yaml(texts[station], station, StationFile).model.links
    except InputError:  # a station of another version
        return {}
    times_s = {}
    for link, frame in manifest.get("links", {}).items():
        baud = ports[link].baud if link in ports else None
        if baud is None or frame not in texts:
            continue
        layout = parse_frame(texts[frame], frame).layout
        lengths = {message.length for message in layout.messages}
        if len(lengths) == 1 and 0 not in lengths:
            times_s[link] = BITS_PER_BYTE * lengths.pop() / baud
    return times_s


@dataclass(frozen=True)
class Expected:
    """An estimate as the whole plan predicts it. ``at_end_U``: expanded uncertainty it will have, None if unknown."""

    predicted: Estimate
    at_end_U: float | None


def predicted_of(session: SessionView, method: str) -> Estimates:
    """Return estimates as the plan of a session predicts them, to hold those of a method against.

    None where the run has not ended, by another method than the first, which predictions are by, and where the session
    has no plan or nothing is predicted.
    """
    declared = declared_by(session.manifest["campaign"])
    if session.incomplete or declared is None or method != declared.methods[0]:
        return []
    plan = _plan_of(session)
    return [] if plan is None else predicted(plan, _begin_utc_s(session)).estimates


def expectations(session: SessionView, known: Mapping[Name, Estimate]) -> dict[Name, Expected]:
    """Return what each estimate will come to, by its name, for a session that is still being recorded.

    Args: known: estimates of the records so far, as they are stated, by their names.
    """
    plan = _plan_of(session)
    whole = [] if plan is None else predicted(plan, _begin_utc_s(session)).estimates
    if plan is None or not whole:
        return {}
    not_due = values_not_due(plan.steps, (event for _, event in session.events))
    last = max((row.window.step for row in session.rows), default=-1)
    until_now = replace(plan, steps=plan.steps[: last + 1])
    part = predicted(until_now, _begin_utc_s(session)).estimates if session.rows else []
    so_far = by_foreseen_name(part)
    return {
        name: Expected(entry, _at_end_U(known.get(name), so_far.get(name), entry))
        for name, entry in by_foreseen_name(whole).items()
        if key_of_value(entry.quantity, entry.conditions) not in not_due
    }


def _begin_utc_s(session: SessionView) -> float | None:
    """Return UTC at the begin of the preparation, the first event of a run, by the clock of the bench; None if unknown.

    That clock counts from anywhere, as from the start of the computer.
    """
    if session.utc_offset_ns is None or not session.events:
        return None
    return (session.utc_offset_ns + session.events[0][0]) / NS


def _at_end_U(known: Estimate | None, so_far: Estimate | None, whole: Estimate) -> float | None:
    """Return the expanded uncertainty at the end: as predicted for what the records so far do not determine."""
    known_U = None if known is None else known.expanded_uncertainty
    if known is not None and known_U is None:
        return None  # it is doubtful: nobody knows what it will come to
    if not known_U or so_far is None or not so_far.expanded_uncertainty:
        return whole.expanded_uncertainty
    return expected_at_end(known_U, so_far.expanded_uncertainty, whole.expanded_uncertainty)


def _plan_of(session: SessionView) -> Plan | None:
    """Return the plan of a session whose analysis predicts soon; None if the session does not hold it whole."""
    declared = declared_by(session.manifest.get("campaign", {}))
    if declared is None or not declared.predicted or declared.predicts_long or not session.plan_steps:
        return None
    try:
        return plan_of_texts(Path(session.manifest["session"]), session.manifest, session.texts, session.plan_steps)
    except BenchError:  # imported, of other software, or damaged: its results are the same without a prediction
        return None
